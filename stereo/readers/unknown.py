"""Explanations of a path that is no recording, with what makes one of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from calib.io import entries
from stereo.readers.images import SUFFIXES, image_files, strange_content
from stereo.readers.video import DEPTH_IN_VIDEO, is_depth, video_files

ONE_IMAGE = "a single image, in which nobody walks: give the folder of a camera's images"
_NAMES = (
    "give the two of a pair as two paths, left first, or name them left and right; name images rgb and their depth, "
    "images of 16 bits or of floating point, depth; one camera needs a tracker of one camera"
)
_READ = "give a video, a bag or a folder of images"
_WAYS = {
    "svo svo2": "only the ZED SDK reads it: export side-by-side video or images",
    "oni klg": "export its images and depth",
    "bag mcap db3": "its content is another, as of a download that failed",
    "zip tar gz tgz bz2 xz 7z rar zst zstd": "unpack it",
    "heic heif avif jxl exr dng cr2 nef gif jp2": "convert it to PNG or JPEG",
    "raw yuv bin y4m nv12 y16": "ffmpeg -f rawvideo -pix_fmt FORMAT -s WIDTHxHEIGHT -i IN OUT.mp4 makes a video of it",
    "npy npz h5 hdf5 mat pkl tfrecord": "write its arrays as images, into folders left and right, or rgb and depth",
}
"""Advice on files that are no recordings, by their endings."""


def what_is_there(path: Path, recordings: Sequence[str]) -> str:
    """Sentence on what was found, and what to do; ``recordings`` are the names of what a folder holds that can be
    opened."""
    if not path.is_dir():
        return _file_text(path)
    if recordings and not image_files(path):
        return f"a folder of recordings: give one of them, {list_text([str(path / name) for name in recordings])}"
    return inside_text(path)


def _file_text(path: Path) -> str:
    if not path.is_file():
        return "neither a file nor a folder"
    with path.open("rb") as file:
        head = file.read(256)
    if strange := strange_content(head):
        return strange
    return ONE_IMAGE if path.suffix.lower() in SUFFIXES else _kind_text([path])


def inside_text(path: Path) -> str:
    """Sentence on what a folder holds that is not the recording of one camera, and what to do."""
    videos = video_files(path)
    images = image_files(path)
    folders = [folder for folder in entries(path) if folder.is_dir() and image_files(folder)]
    if any(map(is_depth, videos)):
        return f"videos, {list_text([video.name for video in videos])}: {DEPTH_IN_VIDEO}"
    if len(images) == 1 and not folders:
        return f"{ONE_IMAGE} ({images[0].name})"
    for kind, found in (("videos", videos), ("folders of images", folders), ("images", images)):
        if found:
            return f"{kind}, {list_text([each.name for each in found])}: {_NAMES}"
    bags = [file.name for file in entries(path) if file.suffix in (".bag", ".mcap", ".db3")]
    if len(bags) > 1:
        return f"bags, {list_text(bags)}: give one of them; ros2 bag reindex makes one of the parts of one"
    places = [path, *filter(Path.is_dir, entries(path))]
    files = [file for place in places for file in entries(place) if file.is_file()]
    if not files:
        return "an empty folder"
    return f"no images, videos or bags but {list_text([file.name for file in files])}, {_kind_text(files)}"


def _kind_text(files: Sequence[Path]) -> str:
    """Name of the most frequent kind of some files."""
    suffix, _ = Counter(file.suffix.lower() for file in files).most_common(1)[0]
    way = next((way for endings, way in _WAYS.items() if suffix.removeprefix(".") in endings.split()), "")
    return f"a file of the kind {suffix}: {way}" if way else f"a file of another kind: {_READ}"


def list_text(names: Sequence[str]) -> str:
    """Names, of many the first three."""
    shown = list(names[:3])
    if len(names) > 3:
        shown.append(f"{len(names) - 3} more")
    last = shown.pop()
    return f"{', '.join(shown)} and {last}" if shown else last
