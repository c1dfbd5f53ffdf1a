"""``planview calibrate floor``: where the floor is under the camera."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from calib.errors import InputError
from calib.floor.points import parse_points
from calib.floor.world_file import load_world, save_world
from calib.images import write_image
from calib.rig import Floor
from calib.text import reason
from planview.calibration.floor import FloorView, floor_from_tracks, given_floor, view_floor
from planview.calibration.pictures import AXIS, GRID
from planview.commands.options import Flag, JsonFlag
from planview.drawing.style import Entry, as_bgr, with_legend
from planview.engine.config import load_config
from planview.engine.setup import floor_search
from planview.output.progress import PlainConsole
from planview.trajectories.table import read_tracks
from stereo.floor import FloorSearch
from stereo.readers import OpenOptions, open_recording
from stereo.readers.pair import StereoRecording


@Parameter(name="*")
@dataclass(frozen=True)
class FloorOptions:
    """Where the floor is taken from, and where it is written."""

    out: Path | None = None
    """world.toml to write, with a picture of a metric grid on the floor beside it."""
    save: Flag = False
    """Write them into the recording (a video: beside it). Later runs and calibrations take that floor and search no
    more."""
    points: Annotated[Sequence[str], Parameter(consume_multiple=True)] = ()
    """Three or more floor points instead: u,v pixels of the rectified left image (their depth is looked up), or
    x,y,z metres in the rectified left camera (x right, y down, z forward)."""
    tracks: Path | None = None
    """tracks.csv of a run on this recording: refine its floor (run.json or world.toml) by where people's feet and
    heads are, for floors that are hidden or without texture."""
    calibration: Path | None = None
    """Calibration of the pair, when it does not lie in the recording."""
    frames: int | None = None
    """How many frames to look at, spread over the recording; analysis.setup_frames when not given."""
    picture: Path | None = None
    """Picture of a metric grid on the floor; beside world.toml, with .png, when not given."""
    config: Path | None = None
    """TOML file with the parameters of a run: analysis.setup_frames and tables rectify, sgbm, range, floor."""
    json_output: JsonFlag = False
    """Print one JSON object to standard output."""


def calibrate_floor(recording: Path, *, options: FloorOptions | None = None) -> None:
    """Find the floor in a stereo recording as a run does; print it, and write world.toml where told.

    Example: planview calibrate floor my_recording --out floor/world.toml

    Example, for every later run on the recording: planview calibrate floor my_recording --save

    Example, floor given by hand: planview calibrate floor my_recording --points 120,400 500,420 320,250

    Parameters
    ----------
    recording
        Folder with left/ and right/ images or videos and a calibration.
    """
    options = options or FloorOptions()
    if options.frames is not None and not 1 <= options.frames <= 1000:
        raise InputError(f"--frames: expected 1 to 1000, found {options.frames}")
    if options.points and options.tracks:
        raise InputError("expected either --points or --tracks, found both")
    if options.out and options.save:
        raise InputError("expected either --out or --save, found both")
    search = floor_search(load_config(options.config))
    if options.frames is not None:
        search = search.model_copy(update={"frames": options.frames})
    console = PlainConsole(stderr=True)
    view, floor = _find(recording, search, options, console)
    target = (recording if recording.is_dir() else recording.parent) / "world.toml" if options.save else options.out
    image = options.picture or (target and target.with_suffix(".png"))
    console.print(_sentence(floor))
    for written in _write(floor, view, target, image):
        console.print(f"wrote {written}", highlight=False)
    if target is None:
        console.print("no world.toml written: --save keeps this floor in the recording, --out FILE elsewhere")
    if options.json_output:
        print(json.dumps(_report(floor, target, image)))


def _find(recording: Path, search: FloorSearch, options: FloorOptions, console: Console) -> tuple[FloorView, Floor]:
    """The floor by the way that the options name."""
    parsed = parse_points(options.points) if options.points else None
    opened = open_recording(recording, OpenOptions(options.calibration))
    with console.status(f"Looking at {search.frames} frames"):
        view = view_floor(opened, search)
        if parsed is not None:
            return view, given_floor(view, *parsed)
        if options.tracks is not None:
            return view, _refined(opened, view, options.tracks)
        return view, view.find()


def _write(floor: Floor, view: FloorView, target: Path | None, image: Path | None) -> list[Path]:
    """Write the files that are asked for."""
    written = []
    for path, write in ((target, partial(save_world, floor)), (image, partial(_draw, view, floor))):
        if path is None:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
        except OSError as error:
            raise InputError(f"{path}: expected a place to write to, found {reason(error)}") from error
        written.append(path)
    return written


def _draw(view: FloorView, floor: Floor, path: Path) -> None:
    entries = (
        Entry(as_bgr(GRID), "a line per metre of floor"),
        Entry(as_bgr(AXIS), "x and y, 1 m from below the camera"),
    )
    write_image(path, with_legend(view.picture(floor), entries))


def _refined(recording: StereoRecording, view: FloorView, tracks: Path) -> Floor:
    file = tracks / "tracks.csv" if tracks.is_dir() else tracks
    return floor_from_tracks(recording, view, read_tracks(file), _floor_of_run(recording, file), file)


def _floor_of_run(recording: StereoRecording, tracks: Path) -> Floor:
    """The floor those tracks were made with: the recording's world.toml, else what run.json says was found."""
    if recording.world_SE3_left is not None:
        return Floor(recording.world_SE3_left)
    beside = tracks.with_name("world.toml")
    if beside.is_file():
        return load_world(beside)
    run = tracks.with_name("run.json")
    try:
        found = json.loads(run.read_text(encoding="utf-8"))["floor"]["world_SE3_left"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{run}: expected the floor of that run (run.json or world.toml), found {reason(error)}"
        ) from error
    from calib.pose import SE3

    try:
        return Floor(SE3.from_matrix(found))
    except ValueError as error:
        raise InputError(f"{run}: expected the floor of that run, {error}") from error


def _sentence(floor: Floor) -> str:
    text = (
        f"camera {floor.height_m:.3f} m above the floor, tilt {math.degrees(floor.tilt_rad):.2f} and roll "
        f"{math.degrees(floor.roll_rad):.2f} degrees"
    )
    if math.isfinite(floor.inlier_fraction):
        text += f"; {floor.inlier_fraction:.0%} of the depth lies on it"
    if math.isfinite(floor.residual_m):
        text += f", {1000 * floor.residual_m:.0f} mm rms from it"
    return text


def _report(floor: Floor, target: Path | None, image: Path | None) -> dict[str, Any]:
    values: dict[str, Any] = {
        "height_m": floor.height_m,
        "tilt_deg": math.degrees(floor.tilt_rad),
        "roll_deg": math.degrees(floor.roll_rad),
        "inlier_fraction": _known(floor.inlier_fraction),
        "residual_m": _known(floor.residual_m),
    }
    if floor.covariance is not None:
        height, tilt, roll = (math.sqrt(max(0.0, float(v))) for v in floor.covariance.diagonal())
        values["height_std_m"] = height
        values["tilt_std_deg"] = math.degrees(tilt)
        values["roll_std_deg"] = math.degrees(roll)
    return {**values, "extent_m": floor.extent_m, "world": _name(target), "picture": _name(image)}


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _name(path: Path | None) -> str | None:
    return None if path is None else str(path)
