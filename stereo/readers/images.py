"""Frames from image files: announced sizes, decoding, and values of more than 8 bits."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from calib.errors import InputError, UnreadableError
from calib.images import as_colour, as_grey
from calib.io import entries, file_size, reason, size_text
from calib.types import F64, I64, U8, AnyArray
from stereo.depth import Depths
from stereo.recording import Decoded

Image.MAX_IMAGE_PIXELS = None  # ``MAX_PIXELS`` is checked
warnings.filterwarnings("ignore", module="PIL")  # of damaged headers: what cannot be decoded is reported as such

Size = tuple[int, int]
Stored = AnyArray | UnreadableError
"""The values of an image as stored, or why there are none."""

MAX_PIXELS = 100_000_000
"""Largest image that is decoded: larger than any camera's, and 0.6 GB at 16 bits in three channels."""
FRAMES = 5
"""Frames of each camera in which the largest value is searched."""


def true_bits(images: Iterable[AnyArray]) -> int | None:
    """Bits per value of several 16-bit images, of which some may be dark: the least usual number that holds their
    largest value; None when no image has more than 8.

    Values that fill the upper bits (a 12-bit sensor's times 16) count as 16: their scale is that of 16 bits.
    """
    largest = [int(image.max()) for image in images if image.dtype == np.uint16 and image.size]
    if not largest:
        return None
    return next(bits for bits in (8, 10, 12, 14, 16) if max(largest) < 1 << bits)


def to_8_bits(image: AnyArray, bits: int | None) -> U8:
    """The image with 8 bits per value: uint8 as it is, uint16 with values of ``bits`` bits, larger ones clipped."""
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    shifted = image >> max(0, (bits or 16) - 8)
    return np.asarray(np.minimum(shifted, 255), dtype=np.uint8)


def bits_note(bits: int | None) -> tuple[str, ...]:
    """A note on such images."""
    return () if bits is None else (f"images of 16 bits whose values use {bits}: their upper 8 bits are taken",)


SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
_END_MARKERS = {b"\xff\xd8\xff": b"\xff\xd9", b"\x89PNG": b"IEND"}
MAX_BYTES = 1 << 30
"""Size above which files are not read: no camera's image is as large."""


def is_grey(image: U8) -> bool:
    """True if an image holds no colour: one channel, or three nearly equal ones that are not all the same value.

    A uniform picture (a black first frame) decides nothing and counts as colour, which loses nothing.
    """
    if image.ndim == 2:
        return True
    green = image[..., 1]  # [grey levels]: codecs that store YUV round a little
    most = 4
    difference = max(int(cv2.absdiff(image[..., c], green).max()) for c in (0, 2))
    return int(np.ptp(green)) > 4 * most and difference <= most


@dataclass
class Colour:
    """Pixels of images with 8 bits per value, or 16 of which ``bits`` are used (``bits_of``), as uint8 grey or BGR."""

    bits: int | None = None
    is_grey: bool = False
    name = "images"

    @property
    def text(self) -> str:
        """Description of a pixel, for people."""
        kind = "grey" if self.is_grey else "colour"
        return kind if self.bits is None else f"{kind}, {self.bits} bits in 16"

    def fits(self, stored: AnyArray) -> bool:
        """True if stored values are those of an image."""
        return stored.dtype in (np.uint8, np.uint16) and (stored.ndim == 2 or stored.shape[2] == 3)

    def prepare(self, first: AnyArray) -> None:
        """Take the first image, which shows whether all are grey."""
        self.is_grey = is_grey(to_8_bits(first, self.bits))

    def __call__(self, stored: AnyArray) -> AnyArray:
        image = to_8_bits(stored, self.bits)
        return as_grey(image) if self.is_grey else as_colour(image)


@dataclass(frozen=True, eq=False)
class Stream:
    """One camera of a recording ("left", "right", "depth", or a topic), as it was stored.

    Attributes:
        n_frames: images that are there.
        times_s: (n_frames,) float64 [s] since the recording's first stamp, in order; None without stamps of its own.
        pixels: what a pixel is, e.g. "grey", "colour", "grey, 12 bits in 16".
        files: of its images, in order; none of live cameras.
    """

    name: str
    size: Size
    n_frames: int
    times_s: F64 | None = None
    pixels: str = ""
    files: Sequence[Path] = ()


class Images:
    """One camera's frames (a ``FrameSource``).

    Args:
        where: they are, for messages.
        places: of each frame in what ``read`` reads, -1 where the camera has none.
        read: gives the values at places in turn.
        name: what the image at a place is called in messages.
        sample: some of them, of which the first that fits gives their size.
        files: that hold them.
    """

    fps = math.nan
    raw = False

    def __init__(
        self,
        where: str,
        places: Sequence[int] | I64,
        pixels: Colour | Depths,
        read: Callable[[Iterable[int]], Iterator[Stored]],
        name: Callable[[int], str],
        sample: Iterable[Stored],
        files: Sequence[Path],
    ) -> None:
        first = None
        self.n_frames = len(places)
        why = ""
        for one in sample:
            if not (refused := _refusal(one, pixels)):
                first = one
                break
            why = why or f": {refused}"
        if first is None or isinstance(first, UnreadableError):
            raise InputError(f"{where}: expected {pixels.name}, found none of {self.n_frames} that can be read{why}")
        pixels.prepare(first)
        self.size = (first.shape[1], first.shape[0])
        self.pixels = pixels
        self._places = places
        self._read = read
        self._name = name
        self.files = files

    def stream(self, name: str, n_frames: int, times_s: F64 | None = None) -> Stream:
        """Stream of this camera."""
        return Stream(name, self.size, n_frames, times_s, self.pixels.text, self.files)

    def __iter__(self) -> Iterator[Decoded]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames."""
        each = [(index, int(self._places[index])) for index in indices]
        values = self._read(place for _, place in each if place >= 0)
        for index, place in each:
            if place < 0:
                yield Decoded(index, None, None, "image is missing")
                continue
            stored = next(values)
            why = ""
            if refused := _refusal(stored, self.pixels):
                why = f"{self._name(place)} cannot be decoded: {refused}"
            elif not isinstance(stored, UnreadableError) and (found := (stored.shape[1], stored.shape[0])) != self.size:
                why = f"{self._name(place)} is {size_text(found)}, not {size_text(self.size)}"
            yield Decoded(index, None, None if why or isinstance(stored, UnreadableError) else self.pixels(stored), why)


def _refusal(stored: Stored, pixels: Colour | Depths) -> str:
    """Why values are not what they should be; empty when they are."""
    if isinstance(stored, UnreadableError):
        return str(stored)
    channels = 1 if stored.ndim == 2 else stored.shape[2]
    return "" if pixels.fits(stored) else f"{stored.dtype} values in {channels} channel{'s' * (channels > 1)}"


def images_of(files: Sequence[Path | None], pixels: Colour | Depths) -> Images:
    """Frames as files; None stands for a file that is missing."""
    decoded = decode_image if isinstance(pixels, Colour) else partial(decode, flags=cv2.IMREAD_UNCHANGED)
    paths = [file or Path() for file in files]
    there = [file for file in files if file]
    return Images(
        str(there[0].parent if there else Path()),
        [i if file else -1 for i, file in enumerate(files)],
        pixels,
        lambda places: (read_stored(paths[place], decoded) for place in places),
        lambda place: f"{paths[place].parent.name}/{paths[place].name}",
        (read_stored(file, decoded) for file in there),
        there,
    )


def read_stored(file: Path, decoded: Callable[[bytes], AnyArray] | None = None) -> Stored:
    """The values of an image file: (H, W) or (H, W, 3) uint8 or uint16 BGR, or as ``decoded`` gives them."""
    try:
        return (decoded or decode_image)(_content(file))
    except UnreadableError as error:
        return error


def read_image(file: Path, bits: int | None = None) -> U8 | None:
    """(H, W) or (H, W, 3) uint8 BGR, None when it cannot be decoded or its end is cut off; values of a 16-bit image use
    ``bits``, or 16."""
    stored = read_stored(file)
    return None if isinstance(stored, UnreadableError) else to_8_bits(stored, bits)


def _content(file: Path) -> bytes:
    """Contents of a file. Raises UnreadableError: it cannot be opened, or is larger than any image."""
    if (size := file_size(file)) > MAX_BYTES:
        raise UnreadableError(f"a file of {size >> 20} MB")
    try:
        return file.read_bytes()
    except OSError as error:
        raise UnreadableError(reason(error)) from error


_STRANGE = (
    (re.compile(rb"\Aversion https://git-lfs\.github"), "a git-lfs pointer: git lfs pull fetches the file"),
    (re.compile(rb"\A\s*<(!doctype|html|\?xml)", re.IGNORECASE), "a web page or XML"),
    (re.compile(rb"\A....ftyp(heic|heix|hevc|mif1|avif|avis)", re.DOTALL), "HEIF or AVIF: convert it to PNG or JPEG"),
    (re.compile(rb"\A(\xff\x0a|\0\0\0\x0cJXL )"), "JPEG XL: convert it to PNG or JPEG"),
    (re.compile(rb"\A\0\0(\0\x01|\x01[\x40-\x7f\xb3])"), "a packet of H.264 or H.265 video: decode the video first"),
    (re.compile(rb"\A\Z"), "an empty file"),
)
"""First bytes of what stands under an image's name, and what that is."""


def strange_content(data: bytes) -> str:
    """Kind of data that begin like no image; empty for others."""
    return next((what for start, what in _STRANGE if start.match(data)), "")


def decode_image(data: bytes) -> AnyArray:
    """(H, W) or (H, W, 3) uint8 or uint16 BGR, turned by its EXIF orientation. Raises UnreadableError: no such
    image, or its end is cut off."""
    for start, end in _END_MARKERS.items():
        # Decoders fill the missing rest of a truncated file with grey and call it an image.
        if data.startswith(start) and end not in data[-1024:]:
            raise UnreadableError("its end is cut off")
    image = decode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if image.dtype not in (np.uint8, np.uint16):
        raise UnreadableError(f"{image.dtype} values, where an image has 8 or 16 bits")
    return image


def decode(data: bytes, flags: int) -> AnyArray:
    """The image as OpenCV decodes it, or UnreadableError; the size in its header is checked before memory is taken."""
    if strange := strange_content(data):
        raise UnreadableError(strange)
    image = None
    why = "no image that OpenCV reads"
    with suppress(Exception):  # libraries raise whatever a damaged file provokes
        with Image.open(BytesIO(data)) as header:
            size = header.size
            why = f"a damaged {header.format}, or an unusual kind of it"
            fits = size[0] * size[1] <= MAX_PIXELS
            pages = _pages(header) if fits else 1
        if not fits:
            why = f"an image of {size_text(size)} pixels"
        elif pages > 1:
            why = f"{pages} pages in one {header.format}: write each into an image of its own"
        else:
            image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    if image is None:
        raise UnreadableError(why)
    return np.asarray(image)


def _pages(header: Image.Image) -> int:
    """Pictures in an opened file (TIFF, GIF, PNG, WebP, a stereo pair in MPO); a smaller second one is a preview."""
    size = header.size
    with suppress(Exception):  # a damaged second one matters to nobody
        if (pages := int(getattr(header, "n_frames", 1))) > 1:
            header.seek(1)
            return pages if header.size == size else 1
    return 1


def bits_of(*cameras: Sequence[Path | None]) -> int | None:
    """Bits that the images of all cameras use, from some of each; None for 8-bit images."""
    images = []
    for there in ([file for file in files if file] for files in cameras):
        for at in sorted({round(i) for i in np.linspace(0, len(there) - 1, FRAMES)} if there else ()):
            image = read_stored(there[at])
            if isinstance(image, UnreadableError) or image.dtype != np.uint16:
                break
            images.append(image)
    return true_bits(images)


def image_files(folder: Path) -> list[Path]:
    """The images of a folder, readable or not, sorted by name with numbers in numeric order."""
    return sorted((f for f in entries(folder) if f.suffix.lower() in SUFFIXES and not f.is_dir()), key=_natural)


def frame_number(file: Path) -> int | None:
    """The last number in a file's name, None when it has none."""
    numbers = re.findall(r"\d+", file.stem)
    return int(numbers[-1]) if numbers else None


def _natural(file: Path) -> tuple[tuple[str, int], ...]:
    parts = re.findall(r"(\D*)(\d*)", file.stem)
    return tuple((text, int(digits) if digits else -1) for text, digits in parts)
