"""Where a camera is above the floor."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.progress import Progress

from calib.errors import InputError, WorkError
from calib.floor.find import floor_from_points
from calib.floor_camera import FloorPinhole
from calib.ground_camera import LENS_K_320, save_ground_camera
from calib.images import as_colour, write_image
from calib.io import parse_size
from calib.people.calibration import HumanCalibration, calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import HumanSample, read_image_size, read_samples, refuse_bad_samples, write_samples
from calib.rig import Floor
from calib.types import F64, U8
from calib.world import load_world, save_world
from planview.api.arguments import Settings, in_range, one_of, path_of, settings
from planview.api.calibrate_pair import Calibrated
from planview.calibration.floor import AXIS_COLOUR, GRID_COLOUR, FloorDepths, draw_grid, floor_from_tracks
from planview.calibration.people import COMPUTED, collect_samples, crowd, draw_person, draw_samples, floor_around
from planview.drawing.style import Entry, as_bgr, with_legend
from planview.engine.setup import floor_search
from planview.output.folder import writing
from planview.output.progress import PlainConsole
from planview.output.run_folder import RunFolder
from planview.trajectories.table import read_tracks
from stereo.readers import OpenOptions, open_any
from stereo.readers.open import open_video
from stereo.recording import DepthCamera, Recording, SingleCamera, StereoPair


def floor(
    recording: Path | str,
    *,
    out: Path | str | None = None,
    save: bool = False,
    points: Sequence[str] = (),
    tracks: Path | str | None = None,
    calibration: Path | str | None = None,
    frames: int | None = None,
    picture: Path | str | None = None,
    config: Settings | None = None,
    set: Sequence[str] = (),
    quiet: bool = False,
) -> Calibrated[Floor]:
    """Find the floor in a recording as a run does; print it, and write world.toml with --out or --save.

    Example: planview calibrate floor my_recording --out floor/world.toml

    Example, for every later run on the recording: planview calibrate floor my_recording --save

    Example, floor given by hand: planview calibrate floor my_recording --points 120,400 500,420 320,250

    Args:
        recording: Folder with left/ and right/ images or videos and a calibration, or images with depth.
        out: world.toml to write, with a picture of a metric grid on the floor next to it.
        save: Write them into the recording (a video: next to it). Later runs and calibrations then use that floor.
        points: Three or more floor points instead: u,v pixels of the rectified left image (their depth is looked up),
            or x,y,z metres in the rectified left camera (x right, y down, z forward).
        tracks: tracks.csv of a run on this recording: refine its floor (run.json or world.toml) by where people's feet
            and heads are, for floors that are hidden or without texture.
        calibration: Calibration of the pair, if it is not in the recording.
        frames: How many frames to look at, spread over the recording; analysis.setup_frames when not given.
        picture: Picture of a metric grid on the floor; next to world.toml, with .png, when not given.
        config: TOML file with the parameters of a run: analysis.setup_frames and tables rectify, sgbm, range, floor.
        set: One parameter, e.g. ``set`` foreground.learning_rate=0.002; can be repeated.
        quiet: Show no progress.

    Raises:
        InputError: a recording that cannot be read, or arguments that exclude each other.
        WorkError: no floor is visible.
    """
    if points and tracks:
        raise InputError("points and tracks cannot be combined")
    if out and save:
        raise InputError("out and save cannot be combined")
    search = floor_search(settings(config, set))
    if frames is not None:
        in_range("frames", frames, 1, 1000)
        search = search.model_copy(update={"frames": frames})
    given = parse_points(points) if points else None
    path = Path(recording)
    opened = open_any(path, OpenOptions(path_of(calibration)))
    with PlainConsole(stderr=True, quiet=quiet).status(f"Looking at {search.frames} frames"):
        view = FloorDepths(opened, search)
        if given is not None:
            places, are_pixels = given
            places = view.points_at(places) if are_pixels else places
            found = floor_from_points(places, "points=", view.depth_std_m(places) if are_pixels else None)
        elif tracks is not None:
            file = Path(tracks) / "tracks.csv" if Path(tracks).is_dir() else Path(tracks)
            found = floor_from_tracks(opened, view, read_tracks(file), _floor_of_run(opened, file), file)
        else:
            found = view.find()
    target = (path if path.is_dir() else path.parent) / "world.toml" if save else path_of(out)
    image = path_of(picture) or (target and target.with_suffix(".png"))
    files = list(filter(None, (target, image)))
    for file in files:
        with writing(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            if file == target:
                save_world(found, file)
            else:
                write_image(file, with_legend(view.picture(found), _LEGEND))
    return Calibrated(found, files)


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
            raise InputError(f"expected u,v in pixels or x,y,z in metres, found {text!r}", argument="points")
        rows.append(row)
    if len({len(row) for row in rows}) != 1:
        raise InputError("some points are in pixels and some in metres", argument="points")
    if len(rows) < 3:
        raise InputError(f"expected three or more, found {len(rows)}", argument="points")
    return np.array(rows), len(rows[0]) == 2


_LEGEND = [
    Entry(as_bgr(GRID_COLOUR), "a line per metre of floor"),
    Entry(as_bgr(AXIS_COLOUR), "x and y, 1 m from below the camera"),
]


def _floor_of_run(recording: Recording[StereoPair | DepthCamera], tracks: Path) -> Floor:
    """The floor those tracks were made with: the recording's world.toml, else the one in run.json."""
    if recording.sensor.world_SE3_left is not None:
        return Floor(recording.sensor.world_SE3_left)
    world = tracks.with_name("world.toml")
    if world.is_file():
        return load_world(world)
    camera = RunFolder(tracks.parent).camera
    if not isinstance(camera, FloorPinhole):
        run = tracks.with_name("run.json")
        raise InputError(f"{run}: no run.json or world.toml gives the floor of that run")
    return Floor(camera.world_SE3_camera)


def human(
    samples: Path | str,
    *,
    image_size: str | None = None,
    lens: str | None = None,
    out: Path | str = Path("camera.toml"),
    frames: Path | str | None = None,
    auto: bool = False,
    person_height: float | None = None,
    focal: float | None = None,
    field: float | None = None,
    camera_height: float | None = None,
    count: int = 50,
    rough: bool = False,
    fps: float | None = None,
    quiet: bool = False,
) -> Calibrated[HumanCalibration]:
    """Calibrate one camera from standing people: height, tilt and focal length, written to camera.toml.

    Example: planview calibrate human samples.csv --image-size 640x480 --lens normal-wide --out camera.toml

    Example, from people who walk by: planview calibrate human street.mp4 --auto --lens normal

    Args:
        samples: CSV with columns left_px,top_px,width_px,height_px,head_x_px,head_y_px,foot_x_px,foot_y_px (and frame),
            or JSON: a list of {"box": [left, top, width, height], "head": [u, v], "foot": [u, v]}; 3 or more people at
            different places. With ``auto``, a video.
        image_size: WxH of the image that the samples were taken in. Not needed with a video, nor with a JSON that holds
            it as "image_size": [width, height].
        lens: pinhole, normal, normal-wide, fisheye or black-corner-fisheye; all are tried when not given.
        out: camera.toml to write, if the camera is known well enough; next to it a picture (.png) and, with ``auto``,
            the samples.
        frames: Video that the samples come from: its frames are the picture's background.
        auto: Collect the samples from a video of people walking by.
        person_height: Mean height of the people in the samples with shoes, where it is known [m]; 1.76 is assumed
            otherwise.
        focal: Focal length, where it is known [px of the samples' image].
        field: Horizontal field of view, where it is known, in place of the focal length [deg]: of a phone, from its
            EXIF.
        camera_height: Height of the camera above the floor, where it is known [m].
        count: How many samples ``auto`` takes.
        rough: Write a camera that is not known well enough, too, instead of failing.
        fps: Frames per second, where times are missing or wrong.
        quiet: Show no progress.

    Returns:
        The camera with the deviation of every value, and the files.

    Raises:
        InputError: samples or a video that cannot be read, or values that exclude each other.
        WorkError: too few people were found, or the camera is not known well enough.
    """
    if lens is not None:
        one_of("lens", lens, LENS_K_320)
    try:
        known = KnownValues(focal, field, camera_height, person_height)
    except ValueError as error:
        raise InputError(_in_arguments(str(error))) from error
    in_range("count", count, 3, 200)
    path = Path(samples)
    file = Path(out)
    source = path if auto else path_of(frames)
    video = open_video(source, OpenOptions(fps=fps)) if source else None
    size = _size(image_size, video, None if auto else read_image_size(path), path)
    console = PlainConsole(stderr=True, soft_wrap=True, highlight=False, quiet=quiet)
    if auto and video is not None:
        console.print(f"following people through {video.n_frames} frames of {path}")
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("Following people", total=video.n_frames)
            collected = collect_samples(video, count, done=lambda: progress.advance(task))
        taken = collected.samples
        independent = collected.independent
    else:
        taken = read_samples(path)
        independent = None
    refuse_bad_samples(taken, size, str(path))
    console.print(f"fitting a camera to {len(taken)} sightings of people: half a minute for 50")
    found = calibrate_from_people(taken, size, lens, known=known, independent=independent, name=str(path))
    if not (found.assessment.enough or rough):
        raise WorkError(f"{path}: {found.assessment.sentence}; the camera was not written", remedy="rough=True")
    picture = file.with_suffix(".png")
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        save_ground_camera(found.camera, file)
        write_image(picture, _picture(found, taken, video))
        if auto:
            write_samples(taken, file.with_suffix(".samples.json"), found.camera.size)
    return Calibrated(found, [file, picture])


def _in_arguments(problem: str) -> str:
    """A problem of known values, which begins with the name of one, with the argument in its place."""
    names = {"person_height_m": "person_height", "height_m": "camera_height", "focal_px": "focal", "field_deg": "field"}
    return re.sub("|".join(names), lambda name: f"{names[name[0]]}=", problem)


def _size(
    text: str | None, video: Recording[SingleCamera] | None, recorded: tuple[int, int] | None, samples: Path
) -> tuple[int, int]:
    """(width, height) of the samples' image; what is known of it from several places must agree."""
    given = None if text is None else parse_size(text, "image_size=")
    sources = {"image_size=": given, "the video": None if video is None else video.sensor.size, str(samples): recorded}
    known = [(source, size) for source, size in sources.items() if size is not None]
    if not known:
        problem = "expected WxH, the size of the image in which the samples were marked, found none"
        raise InputError(problem, argument="image_size")
    (first, (width, height)), *others = known
    for source, (w, h) in others:
        if (w, h) != (width, height):
            raise InputError(f"{first}: expected the image size of {source}, {w}x{h}, found {width}x{height}")
    return width, height


def _picture(found: HumanCalibration, samples: Sequence[HumanSample], video: Recording[SingleCamera] | None) -> U8:
    """Given and computed features next to people all over the floor (figure 6)."""
    camera = found.camera
    image = _background(camera.size, samples, video)
    given = draw_samples(image, camera, found.model, samples)
    crowded = draw_grid(image, camera.project, floor_around(camera, samples) or (-5.0, -5.0, 5.0, 5.0))
    for xy in crowd(camera, found.model):
        draw_person(crowded, camera, found.model, xy, COMPUTED)
    return np.hstack([given, crowded])


def _background(size: tuple[int, int], samples: Sequence[HumanSample], video: Recording[SingleCamera] | None) -> U8:
    """The frame of the first sample with the other samples' people pasted in, or plain grey without a video."""
    canvas: U8 = np.full((size[1], size[0], 3), 60, dtype=np.uint8)
    if video is None:
        return canvas
    by_frame = {s.frame: s for s in samples if s.frame >= 0}
    for frame in video:
        image = as_colour(frame.image)
        if frame.index == 0:
            canvas = image.copy()
        if sample := by_frame.get(frame.index):
            left, top, width, height = (round(v) for v in sample.box_px)
            part = np.s_[max(0, top - 4) : top + height + 4, max(0, left - 4) : left + width + 4]
            canvas[part] = image[part]
        if frame.index >= max(by_frame, default=0):
            break
    return canvas
