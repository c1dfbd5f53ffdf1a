#!/usr/bin/env bash
# Build a wheel, install it in an environment of its own, with the dependencies of the given python, and run
# planview demo from an empty folder, without a display.
set -euo pipefail
unset PYTHONPATH  # another copy of planview there would count as installed
python=$(realpath -s "$1")
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$place" .
"$python" -m venv "$place/env"
"$place/env/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps "$place"/planview-*.whl
site=$("$place/env/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
# Read after the environment's own folder, so that planview comes from the wheel.
"$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))' > "$site/dependencies.pth"
cd "$place"
"$place/env/bin/planview" --version
"$place/env/bin/python" - "$site" <<'PROGRAM'
import sys
from pathlib import Path

import planview
from planview.synthetic.assets import DEMO

for place in (Path(planview.__file__), DEMO):
    if Path(sys.argv[1]).resolve() not in place.resolve().parents:
        raise SystemExit(f"{place}: expected it in the wheel")
PROGRAM
env -u DISPLAY "$place/env/bin/planview" demo > demo.txt
grep "MOTA" demo.txt
ls out/demo/{tracks.csv,run.json,report.html,scene.png,run.rrd}
