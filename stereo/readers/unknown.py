"""What a path holds that is no recording, and what makes one of it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from calib.io import entries
from stereo.readers.images import SUFFIXES, image_files
from stereo.readers.video import video_files

ONE_IMAGE = "a single image, in which nobody walks: give the folder of a camera's images"
_POINTER = re.compile(rb"\Aversion https://git-lfs\.github\.com/spec/v1\noid [^\n]+\nsize (\d+)")
_BAGS = (".bag", ".mcap", ".db3", ".db3.zstd", ".mcap.zstd")
_SVO = "a ZED recording, which only the ZED SDK reads: its SVO export gives side-by-side video or images"
_CONVERT = "a kind of image that is not read: convert it to PNG or JPEG"
_NAMED = {
    ".svo": _SVO, ".svo2": _SVO,
    ".oni": "an OpenNI recording, which only OpenNI reads: export its images and depth",
    ".klg": "a Kintinuous log: export its images and depth",
    ".bag": "a file of that name that is no ROS 1 bag", ".mcap": "a file of that name that is no MCAP file",
    ".db3": "a file of that name that is no SQLite database",
    **dict.fromkeys((".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar", ".zst", ".zstd"),
                    "an archive: unpack it"),
    **dict.fromkeys((".heic", ".heif", ".avif", ".jxl", ".exr", ".dng", ".cr2", ".nef", ".gif", ".jp2"), _CONVERT),
    **dict.fromkeys((".raw", ".yuv", ".bin", ".y4m", ".nv12", ".y16"),
                    "pixels without a container: ffmpeg -f rawvideo -pix_fmt FORMAT -s WIDTHxHEIGHT -i IN OUT.mp4"),
    **dict.fromkeys((".npy", ".npz", ".h5", ".hdf5", ".mat", ".pkl", ".tfrecord"),
                    "arrays: write them as images, into folders left and right, or rgb and depth"),
    **dict.fromkeys((".ply", ".pcd", ".las", ".xyz"), "a cloud of points: images, or images and depth, are read"),
}  # fmt: skip


def what_is_there(path: Path, recordings: Sequence[str]) -> str:
    """What was found, and what to do; ``recordings`` are the names of what a folder holds that can be opened."""
    if path.is_file():
        return _file_text(path)
    if not path.is_dir():
        return "neither a file nor a folder"
    return _bags_text(path) or _nearly_text(path, recordings) or inside_text(path)


def _file_text(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(256)
    if pointer := _POINTER.match(head):
        return f"a git-lfs pointer instead of the file of {int(pointer[1])} bytes: git lfs pull fetches it"
    suffix = path.suffix.lower()
    if not head:
        return "an empty file"
    found = ONE_IMAGE if suffix in SUFFIXES else _NAMED.get(suffix)
    return found or f"a file of another kind ({suffix or 'no ending'}): give a video, a bag or a folder of images"


def _bags_text(path: Path) -> str:
    bags = [file.name for file in entries(path) if file.name.endswith(_BAGS)]
    if len(bags) < 2:
        return ""
    way = "give one of them"
    if not bags[0].endswith(".bag"):
        way += ", or have ros2 bag reindex write the metadata.yaml where they are parts of one"
    return f"{len(bags)} bags ({', '.join(bags[:4])}): {way}"


def _nearly_text(path: Path, recordings: Sequence[str]) -> str:
    """What a folder that nearly fits a layout holds, and what makes it fit; empty for everything else."""
    videos, files = [f.name for f in video_files(path)], image_files(path)
    folders = [f.name for f in entries(path) if f.is_dir() and image_files(f)]
    depths = [name for name in folders if "depth" in name.lower()]
    others = [name for name in folders if name not in depths]
    found, way = "", ""
    if len(videos) == 2:
        left, right = "left" + Path(videos[0]).suffix, "right" + Path(videos[1]).suffix
        found = f"two videos without left and right in their names, {listed(videos)}"
        way = f"give both, that of the left camera first, or rename it {left}, the other {right}"
    elif videos:
        found = f"{len(videos)} videos, {listed(videos)}"
        way = f"give one of them, as {path / videos[0]}, or a folder with two of them named left and right"
    elif len(depths) > 1 and others:
        found = f"{len(depths)} folders of depth, {listed(depths)}"
        way = f"move all but the one in the pixels of {others[0]} away"
    elif depths and len(others) != 1:
        found = f"depth in {depths[0]} and {len(others)} folders of images ({listed(others)})"
        way = "name that of its image rgb"
    elif recordings and not files:
        found, way = "a folder of recordings", f"give one of them, {listed([str(path / name) for name in recordings])}"
    elif len(folders) == 2:
        found, way = f"two folders of images, {listed(folders)}", "rename that of the left camera left, the other right"
    elif len(folders) > 2:
        found = f"{len(folders)} folders of images, {listed(folders)}"
        way = "give those of the left and the right camera as two paths"
    elif len(folders) == 1 and (side := folders[0].lower()) in ("left", "right"):
        found = f"images of the {side} camera alone"
        way = f"put those of the other into {path / ('right' if side == 'left' else 'left')}"
    elif len(files) == 1:
        return f"{ONE_IMAGE} ({files[0].name})"
    elif files and not folders:
        found = f"images without two cameras in their names, {listed([file.name for file in files])}"
        way = (
            "put those of each camera into folders left and right, colour and depth into rgb and depth; images of one "
            "camera need a tracker of one camera"
        )
    return f"{found}: {way}" if found else ""


def inside_text(path: Path) -> str:
    """What a folder without images, videos and bags holds, and advice on the most frequent kind of files."""
    if folders := [f.name for f in entries(path) if f.is_dir() and image_files(f)]:
        return f"none in it, but in its folder {listed(folders)}: move them up"
    if videos := [f.name for f in video_files(path)]:
        way = "give the videos of both cameras as two paths"
        way = way if len(videos) == 1 else f"join the parts of one camera into one (ffmpeg -f concat), and {way}"
        return f"{'a video' if len(videos) == 1 else 'several videos'}, {listed(videos)}: {way}"
    files = [file for place in (path, *filter(Path.is_dir, entries(path))) for file in entries(place) if file.is_file()]
    kinds = Counter(file.suffix.lower() or file.name for file in files).most_common(4)
    if not kinds:
        return "an empty folder"
    known = next((f": {kind} is {_NAMED[kind]}" for kind, _ in kinds if kind in _NAMED), "")
    names = ", ".join(f.name for f in entries(path)[:4])
    return f"no images, videos or bags in it ({names}; {', '.join(f'{n} {kind}' for kind, n in kinds)}){known}"


def listed(names: Sequence[str]) -> str:
    """Names, of many the first three."""
    shown = [*names[:3], f"{len(names) - 3} more"] if len(names) > 3 else list(names)
    return " and ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else "".join(shown)
