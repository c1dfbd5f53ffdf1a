# ruff: noqa: E501
"""Whatever a file holds, its parser reads it or refuses it in a sentence, and raises nothing else.

``HYPOTHESIS_PROFILE=nightly`` tries 10,000 cases of every parser, different ones each time (see ``conftest``). A failure
names its seed.
"""

import os
import random
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from faults.damaged_recordings import CASES, attempt
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_calibrations import foreign_calibrations
from toy_stereo import toy_rig
from toy_tracks import positions_table

from calib.errors import InputError
from calib.formats import WRITTEN, load_rig, write_rig
from calib.formats.one_camera import load_tsai
from calib.formats.rgbd import load_rgbd
from calib.ground_camera import GroundCamera, load_ground_camera, save_ground_camera
from calib.people.samples import read_image_size, read_samples
from calib.pose import SE3
from calib.rig import MAX_BASELINE_M, MIN_BASELINE_M, Floor
from calib.world import load_rigs, load_world, save_world
from planview.counting.events import read_events
from planview.counting.rules import load_rules
from planview.engine.config import load_config
from planview.maps.recording import MapsRecording
from planview.output.finished import TRACKS_BEFORE, read_steps
from planview.output.folder import read_run_info
from planview.output.report.snapshots import read_decision_log
from planview.output.run_folder import read_object
from planview.studies.study import load_study
from planview.synthetic.scene import load_scene
from planview.trajectories.detections import load_detections
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.formats import FORMATS as EXPORTS
from planview.trajectories.formats import load_file
from stereo.readers.times import load_timestamps

ROOT = Path(__file__).resolve().parents[2]
SIZE = (320, 240)
NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"
COUNT = settings.default.max_examples
FIRST = random.randrange(2**32) if NIGHTLY else 0
"""Seed of the first case."""
EXTREMES = (
    b"-1", b"0", b"1e308", b"1e-308", b"-1e400", b"nan", b"inf", b"9" * 400, b"9" * 5000, b"99999999999999999999",
    b"2147483648", b"true", b"null", b'""', b"[]", b"{}", b"[[]]", b"'", b'"', b",", b"=", b":", b"\n", b"\r\n", b"\x00",
    b"\xff\xfe", b"\xef\xbb\xbf", b"\xc3\xa4", b"#", b"[", b"]" * 3, b"{" * 40, b"a.b.c", b"<x>", b"<!DOCTYPE x>", b"&a",
    b"*a", b"<<: *a", b"!!python/object:os.system", b"%YAML:1.0\n", b"1970-01-01", b"\xed\xb3\xbf", b" ", b"\t",
)  # fmt: skip
"""What stands instead of parts of a good file: extremes of numbers, marks of the formats, bytes that are no text."""


pytestmark = pytest.mark.fuzz


def try_all(case: Callable[[int], None], count: int = COUNT) -> None:
    """So many cases of a parser."""
    for seed in range(FIRST, FIRST + count):
        try:
            case(seed)
        except BaseException as error:
            error.add_note(f"seed {seed}")
            raise


def damaged(good: bytes, seed: int) -> bytes:
    """A good file after some random edits: parts removed, doubled, moved, replaced by extremes or by noise."""
    rng, data = random.Random(seed), bytearray(good)
    for _ in range(rng.randint(1, 6)):
        start = rng.randrange(len(data) + 1)
        stop = min(len(data), start + rng.choice((0, 1, 1, 3, 8, 40)))
        part = bytes(data[start:stop])
        kind = rng.randrange(6)
        if kind == 0:
            data[start:stop] = b""
        elif kind == 1:
            data[start:start] = part * rng.choice((1, 2, 20))
        elif kind == 2:
            place = rng.randrange(len(data) + 1)
            data[place:place] = part
        elif kind == 3:
            data[start:stop] = rng.randbytes(stop - start)
        elif kind == 4:
            del data[start + rng.randrange(200) :]
        else:
            data[start:stop] = rng.choice(EXTREMES)
    return bytes(data)


def refusal(read: Callable[[Path], object], path: Path, data: bytes) -> str:
    """The message of a parser that refuses a file; "" where it reads it."""
    path.write_bytes(data)
    return message_of(lambda: read(path))


def message_of(act: Callable[[], object]) -> str:
    try:
        act()
    except InputError as refused:
        return str(refused) or "refused without a word"
    return ""


def is_clear(sentence: str, name: str) -> bool:
    """A refusal is one line that names what is refused and does not print the whole of it; "" is none."""
    return not sentence or (name in sentence and sentence.isprintable() and len(sentence) < 600)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@cache
def calibrations() -> tuple[tuple[str, bytes], ...]:
    """A good file of every format, by its name."""
    import tempfile

    found = [(Path(name).name, text.encode()) for name, text in foreign_calibrations().items()]
    with tempfile.TemporaryDirectory() as place:
        for form in WRITTEN:
            files = write_rig(toy_rig(), Path(place) / f"{form.key}{form.suffix}", form.key)
            found += [(file.name, file.read_bytes()) for file in files]
    return tuple(found)


@cache
def trajectories() -> tuple[tuple[str, bytes], ...]:
    """Good trajectories in every format."""
    import tempfile

    frame = np.repeat(np.arange(6), 2)
    ids, xy = np.tile([1, 2], 6), np.column_stack([frame * 0.1, frame * -0.2])
    table = positions_table(frame, ids, xy, np.full(12, 1.7), frame / 15.0, np.full((12, 4), 9.0))
    file = TrajectoryFile(table, 15.0, "POLYGON ((-5 -5, 5 -5, 5 5, -5 5, -5 -5))")
    found = []
    with tempfile.TemporaryDirectory() as place:
        for name in EXPORTS:
            path = Path(place) / f"a{EXPORTS[name].suffix}"
            EXPORTS[name].write(path, file)
            found.append((name, path.read_bytes()))
            path.unlink()
    return (*found, ("laboratory", b"1 1 10.0 20.0 170.0\n1 2 11.0 21.0 170.0\n"), ("gt", b"1,1,9,9,9,9,1,1,0.5\n" * 2))


@cache
def simple() -> dict[str, tuple[Callable[[Path], object], bytes]]:
    """Parsers of one format each, with a good file."""
    import tempfile

    world = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.5]))
    with tempfile.TemporaryDirectory() as place:
        save_world(Floor(world), Path(place) / "w")
        save_ground_camera(GroundCamera(640, 480, 500.0, 3.5, 0.9, "pinhole"), Path(place) / "c")
        written = {name: (Path(place) / name).read_bytes() for name in ("w", "c")}
    tripwire = '[[tripwire]]\nname = "a"\nfrom_m = [0.0, 1.0]\nto_m = [1.0, 1.0]\nhysteresis_m = 0.2\n'
    zone = '[[zone]]\nname = "z"\npolygon_m = [[0, 0], [4, 0], [4, 3]]\n[[queue]]\nname = "q"\nzone = "z"\n'
    config = "seed = 3\n[maps]\ncell_m = 0.04\n[joint]\nreport = 0.8\n[floor]\nmax_tilt_deg = 80.0\n"
    events = "frame,timestamp_s,rule,kind,id,direction\n3,0.2,a,crossing,1,left_to_right\n"
    run = (
        '{"input": "a", "finished": true, "frames_read": 3, "skipped": [{"index": 1, "why": "x"}], "config": {"a": 1}}'
    )
    coco = '[{"image_id": 1, "category_id": 1, "bbox": [9.5, 8, 30, 90], "score": 0.9}, {"image_id": 2, "bbox": [1, 2, 3, 4]}]'
    study = 'recordings = ["."]\nseeds = [3, 4]\n[parameters]\nmaps.cell_m = [0.03, 0.04]\njoint.stay_s = {min = 1, max = 9, step = 2}\n'
    pose = "rotation = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]\ntranslation_m = [0.0, 0.0, 2.5]\n"
    rigs = f'[[sensor]]\nname = "a"\nfolder = "a"\nstart_s = 0.5\n[sensor.world_SE3_left]\n{pose}'
    decisions = "frame,timestamp_s,id,kind,value,reason\n3,0.2,1,matched,0.7,\n4,0.3,1,lost,0.1,left the view\n"
    return {
        "det.txt": (load_detections, b"1,-1,20,30,20,60,0.9,-1,-1,-1\n2,-1,22,30,20,60,0.8\n"),
        "coco.json": (load_detections, coco.encode()),
        "study.toml": (load_study, study.encode()),
        "rigs.toml": (load_rigs, rigs.encode()),
        "rgbd.json": (lambda path: load_rgbd(path, SIZE, SIZE), b'{"fx": 300.0, "fy": 300.0, "cx": 160, "cy": 120, "k1": 0.1}'),
        "decisions.csv": (lambda path: read_decision_log(path, {1}), decisions.encode()),
        "edits.json": (lambda path: (path.with_name(TRACKS_BEFORE).touch(), read_steps(path.parent)), b'{"steps": [{"at": "2026-01-01T00:00:00+00:00", "edits": ["join 1 2"]}]}'),
        "counts.json": (read_object, b'{"rules": {"a": {"plane": "floor", "points": [[0, 1]]}}}'),
        "world.toml": (load_world, written["w"]),
        "camera.toml": (load_ground_camera, written["c"]),
        "rules.toml": (load_rules, (tripwire + zone).encode()),
        "config.toml": (load_config, config.encode()),
        "scene.toml": (load_scene, (ROOT / "data/synthetic/crossing.toml").read_bytes()),
        "samples.json": (read_samples, (ROOT / "tests/data/pavement_people.json").read_bytes()[:900]),
        "image size": (read_image_size, b'{"image_size": [640, 480], "samples": []}'),
        "samples.csv": (read_samples, b"left,top,width,height,head_x,head_y,foot_x,foot_y\n1,2,30,90,15,4,16,90\n" * 2),
        "timestamps.csv": (lambda path: load_timestamps(path, range(4), range(4)), b"frame,timestamp_s\n0,0.0\n1,0.066667\n2,0.133333\n3,0.2\n"),
        "events.csv": (read_events, events.encode()),
        "run.json": (read_run_info, run.encode()),
        "tsai.xml": (load_tsai, b'<Camera name="c"><Geometry width="768" height="576"/><Intrinsic focal="5.5"/></Camera>'),
    }  # fmt: skip


def test_calibration_of_any_format_is_read_or_refused(folder):
    def read(path):
        assert MIN_BASELINE_M <= load_rig(path, SIZE).baseline_m <= MAX_BASELINE_M

    def case(seed):
        name, good = calibrations()[seed % len(calibrations())]
        assert is_clear(refusal(read, folder / name, damaged(good, seed)), name)

    try_all(case)


@pytest.mark.parametrize("truth", [False, True])
def test_trajectories_of_any_format_are_read_or_refused(folder, truth):
    def case(seed):
        name, good = trajectories()[seed % len(trajectories())]
        read = partial(load_file, truth=truth)
        assert is_clear(refusal(read, folder / name, damaged(good, seed)), name)

    try_all(case)


@pytest.mark.parametrize("name", sorted(simple()))
def test_file_is_read_or_refused(folder, name):
    read, good = simple()[name]

    def case(seed):
        assert is_clear(refusal(read, folder / name, damaged(good, seed)), name)

    try_all(case)


@pytest.mark.parametrize("kind", sorted(CASES))
def test_damaged_recording_is_read_or_refused(kind):
    def case(seed):
        sentence = attempt(kind, seed)
        assert sentence.isprintable()
        assert len(sentence) < 900

    case(3269)  # a bag whose images' topic holds no message
    try_all(case, COUNT if NIGHTLY else COUNT // 4)  # they open recordings and resume runs


def test_maps_that_are_damaged_are_refused(folder):
    good = b"\x89HDF\r\n\x1a\n" + dict(trajectories())["ped-data-archive"][8:]

    def case(seed):
        sentence = refusal(MapsRecording, folder / "maps.h5", damaged(good, seed))
        assert sentence
        assert is_clear(sentence, "maps.h5")

    try_all(case)


@given(text=st.text(max_size=60))
def test_setting_of_any_text_is_taken_or_refused(text):
    for override in (text, f"maps.cell_m={text}", f"{text}=1"):
        assert is_clear(message_of(lambda override=override: load_config(None, [override])), "")


def test_every_export_format_is_fuzzed():
    names = list(EXPORTS)
    assert set(names) <= {name for name, _ in trajectories()}
