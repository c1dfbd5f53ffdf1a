"""``planview calibrate floor`` and ``human``: where a camera is above the floor."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich.progress import Progress

from calib.errors import InputError
from calib.floor.find import floor_from_points
from calib.floor_camera import FloorPinhole
from calib.ground_camera import LENS_K_320, save_ground_camera
from calib.images import as_colour, write_image
from calib.io import parse_size
from calib.people.calibration import HumanCalibration, calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import HumanSample, check_samples, read_image_size, read_samples, write_samples
from calib.rig import Floor
from calib.types import F64, U8
from calib.world import load_world, save_world
from planview.calibration.floor import AXIS_COLOUR, GRID_COLOUR, FloorDepths, draw_grid, floor_from_tracks
from planview.calibration.people import COMPUTED, collect_samples, crowd, draw_person, draw_samples, floor_around
from planview.commands.options import Flag, FrameRate, JsonFlag, in_range, say
from planview.drawing.style import Entry, as_bgr, with_legend
from planview.engine.config import load_config
from planview.engine.setup import floor_search
from planview.output.folder import writing
from planview.output.progress import PlainConsole
from planview.output.run_folder import RunFolder
from planview.trajectories.table import read_tracks
from stereo.readers import OpenOptions, open_any
from stereo.readers.open import open_video
from stereo.recording import DepthCamera, OneCamera, Pair, Recording


@Parameter(name="*")
@dataclass(frozen=True)
class FloorOptions:
    """Where the floor is taken from, and where it is written."""

    out: Path | None = None
    """world.toml to write, with a picture of a metric grid on the floor next to it."""
    save: Flag = False
    """Write them into the recording (a video: next to it). Later runs and calibrations then use that
    floor."""
    points: Annotated[Sequence[str], Parameter(consume_multiple=True)] = ()
    """Three or more floor points instead: u,v pixels of the rectified left image (their depth is looked up), or
    x,y,z metres in the rectified left camera (x right, y down, z forward)."""
    tracks: Path | None = None
    """tracks.csv of a run on this recording: refine its floor (run.json or world.toml) by where people's feet and
    heads are, for floors that are hidden or without texture."""
    calibration: Path | None = None
    """Calibration of the pair, if it is not in the recording."""
    frames: int | None = None
    """How many frames to look at, spread over the recording; analysis.setup_frames when not given."""
    picture: Path | None = None
    """Picture of a metric grid on the floor; next to world.toml, with .png, when not given."""
    config: Path | None = None
    """TOML file with the parameters of a run: analysis.setup_frames and tables rectify, sgbm, range, floor."""
    json_output: JsonFlag = False


def parse_points(texts: Sequence[str]) -> tuple[F64, bool]:
    """Points as typed: ``u,v`` in pixels of the rectified left image or ``x,y,z`` in metres. Raises InputError: not
    numbers, or of both kinds.

    Returns:
        (N, 2) or (N, 3) float64, and whether they are pixels.
    """
    rows = []
    for text in texts:
        try:
            row = [float(part) for part in text.replace(";", ",").split(",")]
        except ValueError:
            row = []
        if len(row) not in (2, 3) or not all(math.isfinite(v) for v in row):
            raise InputError(f"--points: expected u,v in pixels or x,y,z in metres, found {text!r}")
        rows.append(row)
    if len({len(row) for row in rows}) != 1:
        raise InputError("--points: some points are in pixels and some in metres")
    if len(rows) < 3:
        raise InputError(f"--points: expected three or more, found {len(rows)}")
    return np.array(rows), len(rows[0]) == 2


def calibrate_floor(recording: Path, /, *, options: FloorOptions = FloorOptions()) -> None:
    """Find the floor in a recording as a run does; print it, and write world.toml with --out or --save.

    Example: planview calibrate floor my_recording --out floor/world.toml

    Example, for every later run on the recording: planview calibrate floor my_recording --save

    Example, floor given by hand: planview calibrate floor my_recording --points 120,400 500,420 320,250

    Parameters
    ----------
    recording
        Folder with left/ and right/ images or videos and a calibration, or images with depth.
    """
    if options.points and options.tracks:
        raise InputError("--points and --tracks cannot be combined")
    if options.out and options.save:
        raise InputError("--out and --save cannot be combined")
    search = floor_search(load_config(options.config))
    if options.frames is not None:
        in_range("--frames", options.frames, 1, 1000)
        search = search.model_copy(update={"frames": options.frames})
    given = parse_points(options.points) if options.points else None
    opened = open_any(recording, OpenOptions(options.calibration))
    with PlainConsole(stderr=True).status(f"Looking at {search.frames} frames"):
        view = FloorDepths(opened, search)
        if given is not None:
            points, are_pixels = given
            points = view.points_at(points) if are_pixels else points
            floor = floor_from_points(points, "--points", view.depth_std_m(points) if are_pixels else None)
        elif options.tracks is not None:
            file = options.tracks / "tracks.csv" if options.tracks.is_dir() else options.tracks
            floor = floor_from_tracks(opened, view, read_tracks(file), _floor_of_run(opened, file), file)
        else:
            floor = view.find()
    target = (recording if recording.is_dir() else recording.parent) / "world.toml" if options.save else options.out
    image = options.picture or (target and target.with_suffix(".png"))
    say(_sentence(floor))
    if floor.doubt:
        say(f"is that the floor? {floor.doubt} (--points gives another floor)")
    for path in filter(None, (target, image)):
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            if path == target:
                save_world(floor, path)
            else:
                write_image(path, with_legend(view.picture(floor), _LEGEND))
        say(f"wrote {path}")
    if target is None:
        say("no world.toml written: --save keeps this floor in the recording, --out FILE elsewhere")
    if options.json_output:
        print(json.dumps(_report(floor, target, image)))


_LEGEND = [
    Entry(as_bgr(GRID_COLOUR), "a line per metre of floor"),
    Entry(as_bgr(AXIS_COLOUR), "x and y, 1 m from below the camera"),
]


def _floor_of_run(recording: Recording[Pair | DepthCamera], tracks: Path) -> Floor:
    """The floor those tracks were made with: the recording's world.toml, else the one in run.json."""
    if recording.head.world_SE3_left is not None:
        return Floor(recording.head.world_SE3_left)
    world = tracks.with_name("world.toml")
    if world.is_file():
        return load_world(world)
    camera = RunFolder(tracks.parent).camera
    if not isinstance(camera, FloorPinhole):
        run = tracks.with_name("run.json")
        raise InputError(f"{run}: no run.json or world.toml gives the floor of that run")
    return Floor(camera.world_SE3_camera)


def _sentence(floor: Floor) -> str:
    text = (
        f"camera {floor.height_m:.3f} m above the floor, tilt {math.degrees(floor.tilt_rad):.2f} and roll "
        f"{math.degrees(floor.roll_rad):.2f} degrees"
    )
    if math.isfinite(floor.inlier_fraction):
        text += f"; {floor.inlier_fraction:.0%} of the depth lies on it"
    if math.isfinite(floor.residual_m):
        text += f", {1000 * floor.residual_m:.0f} mm rms from it"
    if floor.covariance is not None:
        height, *angles = np.sqrt(floor.covariance.diagonal()).tolist()
        text += f"; height known to {100 * height:.1f} cm, angles to {math.degrees(max(angles)):.2f} degrees"
    return text


def _report(floor: Floor, target: Path | None, image: Path | None) -> dict[str, Any]:
    fit = {name: getattr(floor, name) for name in ("inlier_fraction", "residual_m")}
    values: dict[str, Any] = {
        "height_m": floor.height_m,
        "tilt_deg": math.degrees(floor.tilt_rad),
        "roll_deg": math.degrees(floor.roll_rad),
        **{name: value if math.isfinite(value) else None for name, value in fit.items()},
    }
    if floor.covariance is not None:
        height, tilt, roll = np.sqrt(floor.covariance.diagonal()).tolist()
        values |= {"height_std_m": height, "tilt_std_deg": math.degrees(tilt), "roll_std_deg": math.degrees(roll)}
    files = {name: path and str(path) for name, path in (("world", target), ("picture", image))}
    return {**values, "extent_m": floor.extent_m, **files}


@Parameter(name="*")
@dataclass(frozen=True)
class HumanOptions:
    """Where samples come from, what is known of the camera, and where it is written."""

    image_size: str | None = None
    """WxH of the image that the samples were taken in. Not needed with a video, nor with a JSON that holds it as
    "image_size": [width, height]."""
    lens: str | None = None
    """pinhole, normal, normal-wide, fisheye or black-corner-fisheye; all are tried when not given."""
    out: Path = Path("camera.toml")
    """camera.toml to write; next to it a picture (.png) and, with --auto, the samples."""
    frames: Path | None = None
    """Video that the samples come from: its frames are the picture's background."""
    auto: Flag = False
    """Collect the samples from a video of people walking by."""
    person_height: float | None = None
    """Mean height of the people in the samples with shoes, where it is known [m]; 1.76 is assumed otherwise."""
    focal: float | None = None
    """Focal length, where it is known [px of the samples' image]."""
    field: float | None = None
    """Horizontal field of view, where it is known, in place of the focal length [deg]: of a phone, from its EXIF."""
    camera_height: float | None = None
    """Height of the camera above the floor, where it is known [m]."""
    count: int = 50
    """How many samples --auto takes."""
    fps: FrameRate = None
    json_output: JsonFlag = False


def calibrate_human(samples: Path, /, *, options: HumanOptions = HumanOptions()) -> None:
    """Calibrate one camera from standing people: height, tilt and focal length, written to camera.toml.

    Example: planview calibrate human samples.csv --image-size 640x480 --lens normal-wide --out camera.toml

    Example, from people who walk by: planview calibrate human street.mp4 --auto --lens normal

    Parameters
    ----------
    samples
        CSV with columns left_px,top_px,width_px,height_px,head_x_px,head_y_px,foot_x_px,foot_y_px (and frame), or JSON:
        a list of {"box": [left, top, width, height], "head": [u, v], "foot": [u, v]}; 3 or more people at different
        places. With --auto, a video.
    """
    if options.lens is not None and options.lens not in LENS_K_320:
        raise InputError(f"--lens: expected one of {', '.join(LENS_K_320)}, found {options.lens!r}")
    known = _known(options)
    in_range("--count", options.count, 3, 200)
    source = samples if options.auto else options.frames
    video = open_video(source, OpenOptions(fps=options.fps)) if source else None
    size = _size(options.image_size, video, None if options.auto else read_image_size(samples), samples)
    if options.auto and video is not None:
        say(f"following people through {video.n_frames} frames of {samples}")
        with Progress(console=PlainConsole(stderr=True), transient=True) as progress:
            task = progress.add_task("Following people", total=video.n_frames)
            collected = collect_samples(video, options.count, done=lambda: progress.advance(task))
        taken, independent = collected.samples, collected.independent
    else:
        taken, independent = read_samples(samples), None
    check_samples(taken, size, str(samples))
    say(f"fitting a camera to {len(taken)} sightings of people: half a minute for 50")
    found = calibrate_from_people(taken, size, options.lens, known=known, independent=independent, name=str(samples))
    picture = options.out.with_suffix(".png")
    with writing(options.out):
        options.out.parent.mkdir(parents=True, exist_ok=True)
        save_ground_camera(found.camera, options.out)
        write_image(picture, _picture(found, taken, video))
        if options.auto:
            write_samples(taken, options.out.with_suffix(".samples.json"), found.camera.size)
    _summarise(found, len(taken))
    say(f"wrote {options.out} and {picture}")
    if options.json_output:
        print(json.dumps(_camera_report(found, taken, options.out)))


def _known(options: HumanOptions) -> KnownValues:
    try:
        return KnownValues(options.focal, options.field, options.camera_height, options.person_height)
    except ValueError as error:
        raise InputError(re.sub("|".join(_KNOWN), lambda name: _KNOWN[name[0]], str(error))) from error


_KNOWN = {
    "person_height_m": "--person-height",
    "height_m": "--camera-height",
    "focal_px": "--focal",
    "field_deg": "--field",
}


def _summarise(found: HumanCalibration, n_samples: int) -> None:
    camera, std = found.camera, found.std
    say(
        f"camera {camera.height_m:.2f} m (+-{std.height * camera.height_m:.2f}) above the floor, tilt "
        f"{math.degrees(camera.tilt_rad):.1f} (+-{math.degrees(std.tilt_rad):.1f}) degrees, roll "
        f"{math.degrees(camera.roll_rad):.1f} (+-{math.degrees(std.roll_rad):.1f}), focal length {camera.focal_px:.0f} "
        f"(+-{std.focal * camera.focal_px:.0f}) px, lens {camera.lens}; error {found.error:.3f} over {n_samples} "
        f"samples, search {found.search_s:.2f} s"
    )
    if found.odd:
        say(f"samples that fit badly, look at them again: {', '.join(str(i + 1) for i in found.odd)}")
    if found.boxes_only:
        say("heads and feet are the middles of the boxes' edges: the focal length rests on the lens class")
    say(found.assessment.sentence)


def _size(
    text: str | None, video: Recording[OneCamera] | None, recorded: tuple[int, int] | None, samples: Path
) -> tuple[int, int]:
    """(width, height) of the samples' image; what is known of it from several places must agree."""
    given = None if text is None else parse_size(text, "--image-size")
    sources = {"--image-size": given, "the video": None if video is None else video.head.size, str(samples): recorded}
    known = [(source, size) for source, size in sources.items() if size is not None]
    if not known:
        raise InputError("human needs --image-size WxH, the size of the image in which the samples were marked")
    (first, (width, height)), *others = known
    for source, (w, h) in others:
        if (w, h) != (width, height):
            raise InputError(f"{first}: expected the image size of {source}, {w}x{h}, found {width}x{height}")
    return width, height


def _picture(found: HumanCalibration, samples: Sequence[HumanSample], video: Recording[OneCamera] | None) -> U8:
    """Given and computed features next to people all over the floor (figure 6)."""
    camera = found.camera
    image = _background(camera.size, samples, video)
    given = draw_samples(image, camera, found.model, samples)
    crowded = draw_grid(image, camera.project, floor_around(camera, samples) or (-5.0, -5.0, 5.0, 5.0))
    for xy in crowd(camera, found.model):
        draw_person(crowded, camera, found.model, xy, COMPUTED)
    return np.hstack([given, crowded])


def _background(size: tuple[int, int], samples: Sequence[HumanSample], video: Recording[OneCamera] | None) -> U8:
    """The frame of the first sample with the other samples' people pasted in, or plain grey without a video."""
    canvas: U8 = np.full((size[1], size[0], 3), 60, dtype=np.uint8)
    if video is None:
        return canvas
    wanted = {s.frame: s for s in samples if s.frame >= 0}
    for frame in video:
        image = as_colour(frame.image)
        if frame.index == 0:
            canvas = image.copy()
        if sample := wanted.get(frame.index):
            left, top, width, height = (round(v) for v in sample.box_px)
            part = np.s_[max(0, top - 4) : top + height + 4, max(0, left - 4) : left + width + 4]
            canvas[part] = image[part]
        if frame.index >= max(wanted, default=0):
            break
    return canvas


def _camera_report(found: HumanCalibration, samples: Sequence[HumanSample], out: Path) -> dict[str, Any]:
    camera, std, verdict = found.camera, found.std, found.assessment
    following = verdict.next_sample
    return {
        "height_m": camera.height_m,
        "tilt_deg": math.degrees(camera.tilt_rad),
        "roll_deg": math.degrees(camera.roll_rad),
        "focal_px": camera.focal_px,
        "lens": camera.lens,
        "error": found.error,
        "height_std_m": std.height * camera.height_m,
        "tilt_std_deg": math.degrees(std.tilt_rad),
        "focal_std_px": std.focal * camera.focal_px,
        "roll_std_deg": math.degrees(std.roll_rad),
        "enough": verdict.enough,
        "floor_error_m": round(verdict.floor_error_m, 3) if math.isfinite(verdict.floor_error_m) else None,
        "verdict": verdict.sentence,
        "next_sample_px": None if following is None else [round(v, 1) for v in following.foot_px],
        "odd_samples": [i + 1 for i in found.odd],
        "sample_errors": [round(float(e), 4) for e in found.sample_errors],
        "samples": len(samples),
        "boxes_only": found.boxes_only,
        "search_s": round(found.search_s, 3),
        "camera": str(out),
    }
