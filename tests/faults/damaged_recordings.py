# ruff: noqa: E501
"""Files damaged at random: bags, plan-view maps and the text files of images."""

import atexit
import os
import random
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import h5py
import numpy as np
from toy_bags import COUNT, stereo_bag
from toy_maps import write_toy_maps
from toy_stereo import ToyWorld, toy_rig, walking, write_toy_recording

from calib.errors import InputError, WorkError
from calib.rig import Floor
from calib.world import RigEntry, load_rigs, save_rigs, save_world
from planview.engine.open import engine_of, open_engine
from stereo.readers import open_any, open_recording

NUMBERS = (
    "0", "-1", "1e-9", "-1e6", "1e9", "5e8", "1e308", "1e999999", "nan", "inf", "-2147483648", "99999999999999999999",
)  # fmt: skip
WORDS = (*NUMBERS, '"x"', "[]", "{}", "", "0001-01-01 00:00:00", "9999-12-31 23:59:59", "true", "a.b", "\0", "\xff")
EXTREMES = (0, 1, -1, 255, 1e-9, 1e9, -1e9, 5e8, 2**31 - 1, 2**62, np.nan, np.inf, -np.inf, 1e300)


def damaged_text(text: str, rng: random.Random) -> str:
    """One to three words of a text are others, moved, doubled or gone."""
    for _ in range(rng.randint(1, 3)):
        words = [at for at in range(len(text)) if text[at].isalnum() and (at == 0 or not text[at - 1].isalnum())] or [0]
        start = rng.choice(words)
        stop = start + next((n for n, c in enumerate(text[start:]) if not (c.isalnum() or c in ".-+_")), 1)
        others = (rng.choice(WORDS), text[start:stop] * 2, "", rng.choice(WORDS) + "\n", "." * rng.choice((1, 4000)))
        new = rng.choice(others)
        text = text[:start] + new + text[stop:]
    return text


def damaged_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes changed, cut or filled with zeros."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        start, length = rng.randrange(len(out) + 1), rng.choice((1, 2, 4, 8, 64, 2000))
        kind = rng.randrange(4)
        if kind == 0:
            out[start : start + length] = rng.randbytes(length)
        elif kind == 1:
            out[start : start + length] = b"\xff" * length
        elif kind == 2:
            out[start : start + length] = b""
        else:
            out[start : start + length] = bytes(length)
    return bytes(out) if rng.random() < 0.8 else bytes(out[: rng.randrange(len(out) + 1)])


@cache
def originals() -> Path:
    """A bag of every storage, plan-view maps, and a recording of images."""
    folder = Path(tempfile.mkdtemp(prefix="planview-originals-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    stereo_bag(folder / "ros1.bag")
    stereo_bag(folder / "bz2.bag", compressed=True, chunks="bz2")
    stereo_bag(folder / "sqlite", False)
    stereo_bag(folder / "mcap", False, "mcap")
    shutil.copy(next((folder / "mcap").glob("*.mcap")), folder / "alone.mcap")
    write_toy_maps(folder / "maps.h5", 16)
    world, rig = ToyWorld(), toy_rig((160, 120), 115.0, 0.12)
    pairs = [world.pair(rig, walking(i), i) for i in range(4)]
    write_toy_recording(folder / "images", rig, pairs)
    save_world(Floor(world.world_SE3_left, 0.8, 0.01), folder / "images" / "world.toml")
    save_rigs([RigEntry("a", world.world_SE3_left)], folder / "rigs.toml")
    (folder / "rules.toml").write_text('[[zone]]\nname = "z"\npolygon_m = [[-9, -9], [9, -9], [9, 9]]\n')
    (folder / "tum" / "rgb").mkdir(parents=True)
    (folder / "tum" / "depth").mkdir()
    stamps = [f"{1_650_000_000 + i / 30:.6f}" for i in range(4)]
    for name, pixels in (("rgb", np.full((48, 64, 3), 90, np.uint8)), ("depth", np.full((48, 64), 9000, np.uint16))):
        for stamp in stamps:
            cv2.imwrite(str(folder / "tum" / name / f"{stamp}.png"), pixels)
        lines = [f"{stamp} {name}/{stamp}.png" for stamp in stamps]
        (folder / "tum" / f"{name}.txt").write_text("# a list\n" + "\n".join(lines) + "\n")
    return folder


def damaged_message(path: Path, rng: random.Random) -> None:
    """One field of one message of a bag that is rewritten."""
    kind, value = rng.choice(("image", "info")), rng.choice((0, 1, 7, 255, 2**31, 2**32 - 1))
    fields = {
        "image": {"width": value, "height": value, "step": value, "encoding": rng.choice(("8UC-1", "", "16UC9", "rgb8", "x" * 9999))},
        "info": {"width": value, "height": value, "k": np.full(9, float(rng.choice((np.nan, 0.0, -1e6, 1e300)))),
                 "d": np.full(rng.choice((0, 1, 5, 7)), float(rng.choice((np.nan, -1e6, 1e300)))),
                 "p": np.full(12, float(rng.choice((np.nan, 0.0, 1e300)))), "distortion_model": "x"},
    }[kind]  # fmt: skip
    name = rng.choice(sorted(fields))
    stereo_bag(path, rng.random() < 0.5, change=(kind, rng.randrange(COUNT), {name: fields[name]}))


def try_bag(folder: Path, rng: random.Random) -> None:
    if rng.random() < 0.3:
        path = folder / "a.bag"
        damaged_message(path, rng)
    else:
        source = originals() / rng.choice(("ros1.bag", "bz2.bag", "sqlite", "mcap", "alone.mcap"))
        path = folder / source.name
        shutil.copytree(source, path) if source.is_dir() else shutil.copy(source, path)
        file = rng.choice(sorted(path.iterdir())) if path.is_dir() else path
        if file.suffix == ".yaml":
            file.write_text(damaged_text(file.read_text(), rng), errors="replace")
        else:
            file.write_bytes(damaged_bytes(file.read_bytes(), rng))
    frames = list(open_recording(path))
    assert len(frames) <= COUNT


def try_maps(folder: Path, rng: random.Random) -> None:
    path = Path(shutil.copy(originals() / "maps.h5", folder / "maps.h5"))
    if rng.random() < 0.2:
        path.write_bytes(damaged_bytes(path.read_bytes(), rng))
    else:
        with h5py.File(path, "r+") as file:
            for _ in range(rng.randint(1, 2)):
                damage_table(file, rng)
    for _ in open_engine(path):
        pass


def damage_table(file: Any, rng: random.Random) -> None:
    """An attribute or a dataset holds something else."""
    if rng.random() < 0.5:
        attributes = file[rng.choice(("rig", "floor", "grid", "/"))].attrs
        name = rng.choice(sorted(attributes))
        kind = rng.randrange(4)
        if kind == 0:
            del attributes[name]
        elif kind == 1 and np.ndim(attributes[name]):
            values = np.array(attributes[name], np.float64)
            values.flat[rng.randrange(values.size)] = rng.choice(EXTREMES)
            attributes[name] = values
        else:
            attributes[name] = rng.choice((rng.choice(EXTREMES), "x", [1.0, 2.0], np.float64(rng.choice(EXTREMES))))
        return
    names = []
    file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    name, kind = rng.choice(sorted(names)), rng.randrange(5)
    column = file[name]
    if kind == 0:
        del file[name]
    elif kind == 1 and column.maxshape[0] is None:
        column.resize(rng.choice((0, 1, len(column) + 7, 5 * 10**8)), axis=0)
    elif kind == 2 and column.dtype.kind in "iuf":
        values = column[:]
        del file[name]
        file[name] = rng.choice((values.astype(np.float64), values.astype(np.int8), values[..., None], values[:-1]))
    elif len(column) and column.dtype.kind in "iuf":
        limits = None if column.dtype.kind == "f" else np.iinfo(column.dtype)
        value = rng.choice([v for v in EXTREMES if limits is None or limits.min <= v <= limits.max])
        column[rng.randrange(len(column))] = value


def try_text(folder: Path, rng: random.Random) -> None:
    place, name = rng.choice((
        ("images", "timestamps.csv"), ("images", "rig.toml"), ("images", "world.toml"), ("tum", "rgb.txt"),
        ("tum", "depth.txt"), (".", "rigs.toml"),
    ))  # fmt: skip
    if place == ".":
        (folder / name).write_text(damaged_text((originals() / name).read_text(), rng), errors="replace")
        load_rigs(folder / name)
        return
    path = Path(shutil.copytree(originals() / place, folder / place))
    (path / name).write_text(damaged_text((path / name).read_text(), rng), errors="replace")
    recording = open_any(path)
    list(recording)
    if place == "images":
        engine_of(recording)


CASES: dict[str, Callable[[Path, random.Random], None]] = {
    "bag": try_bag, "maps": try_maps, "text": try_text,
}  # fmt: skip


def attempt(kind: str, seed: int) -> str:
    """``read``, or the sentence of a refusal; whatever else is raised goes on."""
    folder = Path(tempfile.mkdtemp(prefix="planview-case-"))
    try:
        # Nothing has to outlast the machine; a few frames are two blocks.
        with patch.object(os, "fsync"), patch("planview.maps.recording.BLOCK_FRAMES", 8):
            CASES[kind](folder, random.Random(f"{kind} {seed}"))
    except (InputError, WorkError) as refused:
        return str(refused) or "refused without a word"
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return "read"
