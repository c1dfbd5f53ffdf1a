"""Ways to damage a good recording, and what a run must report of each."""

import os
import shutil
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from calib.types import U8

FRAMES = 30
MIDDLE = "000015.png"

Damage = Callable[[Path], object]


@dataclass(frozen=True)
class Fault:
    """One way.

    Attributes:
        name: of the test.
        damage: does it to the recording folder.
        status: exit status asked for.
        message: pattern of the sentence on stderr.
        skipped: frames that run.json counts as skipped.
        warns: name of the check of which run.json warns.
        words: options of the run; ``{}`` is the recording folder.
    """

    name: str
    damage: Damage
    status: int = 0
    message: str = ""
    skipped: int = 0
    warns: str = ""
    words: tuple[str, ...] = ()


def replaced(file: str, content: str | bytes) -> Damage:
    """The file holds something else."""
    return lambda folder: (folder / file).write_bytes(content.encode() if isinstance(content, str) else content)


def edited(file: str, before: str, after: str) -> Damage:
    """A part of the text is another one."""

    def damage(folder):
        text = (folder / file).read_text()
        assert before in text
        (folder / file).write_text(text.replace(before, after, 1))

    return damage


def removed(*files: str) -> Damage:
    """The files or folders are gone."""

    def damage(folder):
        for file in files:
            path = folder / file
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return damage


def cut(file: str, share: float) -> Damage:
    """The end of the file is missing."""

    def damage(folder):
        data = (folder / file).read_bytes()
        (folder / file).write_bytes(data[: int(len(data) * share)])

    return damage


def instead(file: str, make: Callable[[Path], object]) -> Damage:
    """Something that is no regular file stands in the file's place."""

    def damage(folder):
        (folder / file).unlink()
        make(folder / file)

    return damage


def images(change: Callable[[U8, int], U8], sides: Sequence[str] = ("left", "right")) -> Damage:
    """Every image of some sides is changed; ``change`` takes it and its frame."""

    def damage(folder):
        for side in sides:
            for index, file in enumerate(sorted((folder / side).iterdir())):
                cv2.imwrite(str(file), change(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), index))

    return damage


def right_shows(frame_of: Callable[[int], int], sides: Sequence[str] = ("right",)) -> Damage:
    """The right image of frame i is that of frame ``frame_of(i)``."""

    def damage(folder):
        for side in sides:
            files = sorted((folder / side).iterdir())
            data = [file.read_bytes() for file in files]
            for index, file in enumerate(files):
                file.write_bytes(data[frame_of(index)])

    return damage


def sparse(file: str, size: int) -> Damage:
    """The file claims a size that the disk does not hold."""

    def damage(folder):
        with (folder / file).open("r+b") as opened:
            opened.truncate(size)

    return damage


def swapped(folder: Path) -> None:
    """Left and right change places."""
    (folder / "left").rename(folder / "l")
    (folder / "right").rename(folder / "left")
    (folder / "l").rename(folder / "right")


def nothing(folder: Path) -> None:
    """The options are the fault."""


def both(*damages: Damage) -> Damage:
    """One after the other."""

    def damage(folder):
        for one in damages:
            one(folder)

    return damage


def blocks(image: U8, frame: int) -> U8:
    """As a codec leaves it at a very low bit rate."""
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 4])[1], 0)


def videos(left: Callable[[bytes], bytes] = bytes, right: Callable[[bytes], bytes] = bytes) -> Damage:
    """Videos instead of folders, whose bytes are then changed."""

    def damage(folder):
        for side, change in (("left", left), ("right", right)):
            files = sorted((folder / side).iterdir())
            first = cv2.imread(str(files[0]), 0)
            path = folder / f"{side}.avi"
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 15.0, first.shape[::-1], False)
            for file in files:
                writer.write(cv2.imread(str(file), 0))
            writer.release()
            shutil.rmtree(folder / side)
            path.write_bytes(change(path.read_bytes()))

    return damage


def png_claiming(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its few bytes do not hold."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = zlib.compress(bytes(100_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def rows(times: Sequence[object], first: object = 0) -> str:
    """timestamps.csv of these times."""
    frames = [first, *range(1, len(times))]
    return "\n".join(["frame,timestamp_s", *(f"{f},{t}" for f, t in zip(frames, times, strict=True))]) + "\n"


def claims_frames(data: bytes, count: int = 2_000_000_000) -> bytes:
    """An AVI whose headers claim ``count`` frames."""
    for place in (data.find(b"avih") + 8 + 16, data.find(b"strh") + 8 + 32):
        data = data[:place] + struct.pack("<I", count) + data[place + 4 :]
    return data


def bomb() -> str:
    """A YAML of 2 kB that stands for gigabytes."""
    levels = [f"b{i}: &b{i}\n  <<: [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9)]
    return "%YAML:1.0\n" + "\n".join(["M1: 1", "R: 1", "b0: &b0 {x: 1}", *levels])


def pipe(path: Path) -> None:
    """Reading it would wait for ever."""
    os.mkfifo(path)
