"""Where a camera is above the floor."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.errors import InputError, WorkError
from calib.ground_camera import LENS_K_320, save_ground_camera
from calib.images import write_image
from calib.io import size_text
from calib.people.calibration import HumanCalibration, calibrate_from_people
from calib.people.model import KnownValues
from calib.people.samples import read_image_size, read_samples, refuse_bad_samples, write_samples
from calib.pose import SE3
from calib.rig import Floor
from calib.types import F64
from calib.world import save_world
from planview.api.arguments import Settings, in_range, one_of, opening, path_of, settings, size_of
from planview.api.result import Result, plain_values
from planview.calibration.floor import FloorDepths, floor_from_tracks, parse_points
from planview.calibration.people import collect_samples, people_picture
from planview.engine.setup import floor_search
from planview.output.folder import writing
from planview.output.run_folder import RunFolder
from planview.progress import Progress, unseen
from planview.trajectories.table import read_tracks
from stereo.readers import open_any
from stereo.readers.open import open_video
from stereo.recording import DepthCamera, Recording, SingleCamera, StereoPair

log = logging.getLogger(__name__)


def floor(
    recording: Path | str,
    *,
    out: Path | str | None = None,
    save: bool = False,
    points: Sequence[str | Sequence[float]] | F64 = (),
    tracks: Path | str | None = None,
    calibration: Path | str | None = None,
    frames: int | None = None,
    picture: Path | str | None = None,
    config: Settings | None = None,
) -> Result[Floor]:
    """Find the floor in a stereo recording.

    It is found as a run does, or given by hand; ``out`` or ``save`` write it as world.toml.

    ```python
    print(planview.calibrate.floor("my_recording", save=True))  # for every later run on the recording
    planview.calibrate.floor("my_recording", points=[(120, 400), (500, 420), (320, 250)]).value.height_m
    ```

    Args:
        recording: Folder with left/ and right/ images or videos and a calibration, or images with depth.
        out: world.toml to write, with a picture of a metric grid on the floor next to it.
        save: Write them into the recording (a video: next to it). Later runs and calibrations then use that floor.
        points: Three or more floor points instead: u,v pixels of the rectified left image (their depth is looked up),
            or x,y,z metres in the rectified left camera (x right, y down, z forward). In Python also an array, a row
            per point.
        tracks: tracks.csv of a run on this recording: refine its floor by where people's feet
            and heads are, for floors that are hidden or without texture.
        calibration: Calibration of the pair, if it is not in the recording.
        frames: How many frames to look at, spread over the recording; analysis.setup_frames when not given.
        picture: Picture of a metric grid on the floor; next to world.toml, with .png, when not given.
        config: TOML file with the parameters of a run: analysis.setup_frames and tables rectify, sgbm, range, floor. In
            Python also a dict of those that differ, or a Config.

    Raises:
        InputError: a recording that cannot be read, or arguments that exclude each other.
        WorkError: no floor is visible.
    """
    given = parse_points(points) if len(points) else None
    if given is not None and tracks:
        raise InputError("points and tracks cannot be combined")
    if out and save:
        raise InputError("out and save cannot be combined")
    search = floor_search(settings(config))
    if frames is not None:
        in_range("frames", frames, 1, 1000)
        search = search.model_copy(update={"frames": frames})
    path = Path(recording)
    opened = open_any(path, opening(calibration))
    log.debug("looking at %d frames", search.frames)
    view = FloorDepths(opened, search)
    if given is not None:
        found = view.floor_at(given)
    elif tracks:
        file = Path(tracks) / "tracks.csv" if Path(tracks).is_dir() else Path(tracks)
        found = floor_from_tracks(opened, view, read_tracks(file), _floor_of_run(opened, file), file)
    else:
        found = view.find()
    target = (path if path.is_dir() else path.parent) / "world.toml" if save else path_of(out)
    image = path_of(picture) or (target and target.with_suffix(".png"))
    files = list(filter(None, (target, image)))
    for file in files:
        with writing(file):
            if file == target:
                save_world(found, file)
            else:
                write_image(file, view.picture(found))
    values = plain_values(
        found, "height_m", "tilt_rad", "roll_rad", "inlier_fraction", "residual_m", "extent_m", "doubt"
    )
    if found.covariance is not None:
        height_m, tilt_rad, roll_rad = np.sqrt(found.covariance.diagonal()).tolist()
        values |= {"height_std_m": height_m, "tilt_std_deg": math.degrees(tilt_rad)}
        values["roll_std_deg"] = math.degrees(roll_rad)
    return Result(found, values | {"world": target and str(target)}, files=files)


def _floor_of_run(recording: Recording[StereoPair | DepthCamera], tracks: Path) -> Floor:
    """The floor those tracks were made with: that of the recording, else the one in run.json."""
    if recording.sensor.world_SE3_left is not None:
        return Floor(recording.sensor.world_SE3_left)
    floor = RunFolder(tracks.parent).info.floor
    if floor is None or floor.world_SE3_left is None:
        raise InputError(f"{tracks.with_name('run.json')}: expected the floor of that run, found none")
    return Floor(SE3.from_matrix(floor.world_SE3_left))


def human(
    samples: Path | str,
    *,
    image_size: tuple[int, int] | str | None = None,
    lens: str | None = None,
    out: Path | str = Path("camera.toml"),
    frames: Path | str | None = None,
    auto: bool = False,
    person_height: float | None = None,
    focal: float | None = None,
    field: float | None = None,
    camera_height: float | None = None,
    count: int = 50,
    fps: float | None = None,
    progress: Progress = unseen,
) -> Result[HumanCalibration]:
    """Calibrate one camera from standing people.

    Height, tilt and focal length are written to camera.toml.

    ```python
    camera = planview.calibrate.human("street.mp4", auto=True, lens="normal").value.camera
    planview.calibrate.human("samples.csv", image_size=(640, 480), lens="normal-wide", out="camera.toml")
    ```

    Args:
        samples: CSV with columns left_px,top_px,width_px,height_px,head_x_px,head_y_px,foot_x_px,foot_y_px (and frame),
            or JSON: a list of {"box": [left, top, width, height], "head": [u, v], "foot": [u, v]}; 3 or more people at
            different places. With ``auto``, a video.
        image_size: WxH of the image that the samples were taken in. Not needed with a video, nor with a JSON that holds
            it as "image_size": [width, height]. In Python also (width, height).
        lens: pinhole, normal, normal-wide, fisheye or black-corner-fisheye; all are tried when not given.
        out: camera.toml to write, with the deviations; next to it a picture (.png) and, with ``auto``, the samples.
        frames: Video that the samples come from: its frames are the picture's background.
        auto: Collect the samples from a video of people walking by.
        person_height: Mean height of the people in the samples with shoes, where it is known [m]; 1.76 is assumed
            otherwise.
        focal: Focal length, where it is known [px of the samples' image].
        field: Horizontal field of view, where it is known, in place of the focal length [deg]: of a phone, from its
            EXIF.
        camera_height: Height of the camera above the floor, where it is known [m].
        count: How many samples ``auto`` takes.
        fps: Frames per second, where times are missing or wrong.
        progress: Called after every frame of a video.

    Returns:
        The camera with the deviation of every value.

    Raises:
        InputError: samples or a video that cannot be read, or values that exclude each other.
        WorkError: too few people were found, or they do not determine how large people are in the image.
    """
    if lens:
        one_of("lens", lens, LENS_K_320)
    try:
        known = KnownValues(focal, field, camera_height, person_height)
    except ValueError as error:
        raise InputError(_in_arguments(str(error))) from error
    in_range("count", count, 3, 200)
    path = Path(samples)
    file = Path(out)
    source = path if auto else path_of(frames)
    video = open_video(source, opening(fps=fps)) if source else None
    size = _size(size_of(image_size, "image_size"), video, None if auto else read_image_size(path), path)
    independent = None
    if auto and video is not None:
        log.info("following people through %d frames of %s", video.n_frames, path)
        taken, independent = collect_samples(video, count, progress)
    else:
        taken = tuple(read_samples(path))
    refuse_bad_samples(taken, size, str(path))
    log.info("fitting a camera to %d sightings of people: half a minute for 50", len(taken))
    found = calibrate_from_people(taken, size, lens, known=known, independent=independent, name=str(path))
    if not found.assessment.enough:
        raise WorkError(f"{path}: {found.assessment.sentence}; the camera was not written")
    picture = file.with_suffix(".png")
    with writing(file):
        save_ground_camera(found.camera, file)
        write_image(picture, people_picture(found, taken, video))
        if auto:
            write_samples(taken, file.with_suffix(".samples.json"), found.camera.size)
    camera = found.camera
    std = found.std
    values = plain_values(camera, "height_m", "tilt_rad", "roll_rad", "focal_px", "lens")
    values |= {"height_std_m": std.height * camera.height_m, "focal_std_px": std.focal * camera.focal_px}
    values |= {"tilt_std_deg": std.tilt_deg, "roll_std_deg": std.roll_deg}
    values |= {"relative_std": std.relative, "from_camera_std": std.from_camera}
    values["verdict"] = found.assessment.sentence
    if found.assessment.next_sample:
        values["next_sample_px"] = found.assessment.next_sample
    values |= plain_values(found, "error", "boxes_only")
    values |= {"samples": len(taken), "odd_samples": [number + 1 for number in found.odd]}
    return Result(found, values, files=[file, picture])


def _in_arguments(problem: str) -> str:
    """A problem of known values, which begins with the name of one, with the argument in its place."""
    names = {"person_height_m": "person_height", "height_m": "camera_height", "focal_px": "focal", "field_deg": "field"}
    return re.sub("|".join(names), lambda name: f"{names[name[0]]}=", problem)


def _size(
    given: tuple[int, int] | None,
    video: Recording[SingleCamera] | None,
    recorded: tuple[int, int] | None,
    samples: Path,
) -> tuple[int, int]:
    """(width, height) of the samples' image; what is known of it from several places must agree."""
    sources = {"image_size=": given, "the video": None if video is None else video.sensor.size, str(samples): recorded}
    known = [(source, size) for source, size in sources.items() if size is not None]
    if not known:
        problem = "expected WxH, the size of the image in which the samples were marked, found none"
        raise InputError(problem, argument="image_size")
    (first, size), *others = known
    for source, other in others:
        if other != size:
            sizes = f"{size_text(other)}, found {size_text(size)}"
            raise InputError(f"{first}: expected the image size of {source}, {sizes}")
    return size
