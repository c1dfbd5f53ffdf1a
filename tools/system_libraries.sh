#!/usr/bin/env bash
# open3d needs a few system libraries: install them where that is allowed, else stop with the command to type.
set -euo pipefail
[ "$(uname -s)" = Linux ] || exit 0

missing=()
has() { { ldconfig -p 2>/dev/null || /sbin/ldconfig -p; } | grep -q "$1"; }
has 'libEGL\.so\.1' || missing+=(libegl1)
has 'libGL\.so\.1' || missing+=(libgl1)
has 'libusb-1\.0\.so\.0' || missing+=(libusb-1.0-0)
has 'libgomp\.so\.1' || missing+=(libgomp1)
[ ${#missing[@]} -eq 0 ] && exit 0

if ! command -v apt-get >/dev/null; then
    echo "planview: open3d needs libEGL, libGL, libusb-1.0 and libgomp; install them with your package manager, then run make again" >&2
    exit 1
fi
install="apt-get install -y --no-install-recommends ${missing[*]}"
if [ "$(id -u)" -eq 0 ]; then
    apt-get update -qq && DEBIAN_FRONTEND=noninteractive $install
elif sudo -n true 2>/dev/null; then
    sudo apt-get update -qq && sudo DEBIAN_FRONTEND=noninteractive $install
else
    echo "planview: open3d needs system libraries; type this, then run make again:" >&2
    echo "    sudo apt-get update && sudo $install" >&2
    exit 1
fi
