"""Planview in a program: runs, engines step by step, and a tracker of one's own."""

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from crossing_video import CAMERA, CrossingVideo
from toy_run import EMPTY, FRAMES

import planview
from calib.errors import InputError
from calib.types import U8
from planview.engine.engine import Engine, FrameResult
from planview.engine.open import engine_of, open_engine
from planview.engine.sensor import StageClock
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.ellipse_particle import EllipseParticleTracker
from planview.trajectories.state import TrackState
from stereo.recording import Frame


def test_run_without_a_folder_gives_what_a_folder_would_hold(engine, tmp_path):
    frames = EMPTY + 6
    kept = planview.run(engine, out=tmp_path / "out", frames=frames)
    tracks = planview.run(engine, frames=frames)
    assert len(tracks) > 0
    assert np.array_equal(tracks.x_m, kept.x_m)
    assert (tmp_path / "out" / "report.html").is_file()


def test_evaluation_takes_tables(engine, tmp_path):
    tracks = planview.run(engine, out=tmp_path / "out", frames=FRAMES)
    confirmed = tracks.where(tracks.state == "confirmed")
    assert planview.evaluate(tmp_path / "out", confirmed).to_json()["mota"] == 1.0


def test_dataframe_has_the_columns_of_the_file(engine, tmp_path):
    frame = planview.run(engine, out=tmp_path / "out", frames=EMPTY + 6).to_dataframe()
    header = (tmp_path / "out" / "tracks.csv").read_text().splitlines()[0]
    assert ",".join(frame.columns) == header
    assert frame.state.iloc[-1] in ("tentative", "confirmed")


def test_a_tracker_without_reset_is_refused_before_the_recording_is_read(tmp_path):
    class Forgetful:
        decisions = ()
        update = debug = print

    with pytest.raises(InputError, match=r"reset and needs, found .*Forgetful"):
        open_engine(tmp_path / "nowhere", Forgetful())


def test_tracker_of_one_camera_refuses_pairs(recording):
    with pytest.raises(InputError, match="one camera"):
        planview.run(recording, tracker="ellipse-particle")


def test_matcher_refuses_one_camera(recording):
    with pytest.raises(InputError, match="stereo pairs"):
        planview.run(recording / "left", tracker="ellipse-particle", matcher=lambda left, right: left)


SHOWN = EMPTY + 12


def stepped(engine: Engine, frames: int) -> list[FrameResult]:
    engine.reset()
    return [engine.step(frame) for frame, _ in zip(engine.recording, range(frames), strict=False)]


def test_steps_of_a_stereo_engine_give_the_tracks_of_its_iteration_timed_by_stage_without_reading(engine):
    iterated = [result.tracks for result, _ in zip(engine, range(SHOWN), strict=False)]
    assert any(iterated)
    assert [result.tracks for result in stepped(engine, SHOWN)] == iterated
    (result,) = stepped(engine, 1)
    assert list(result.stages_ms) == ["rectify", "match", "foreground", "maps", "track"]


def test_reset_forgets_the_background_of_a_stereo_engine(engine):
    stepped(engine, EMPTY + 3)
    assert not stepped(engine, 1)[0].views[0].foreground.any()


def test_steps_of_a_single_camera_engine_give_the_tracks_of_its_iteration():
    engine = engine_of(CrossingVideo(), EllipseParticleTracker())
    assert [r.tracks for r in stepped(engine, CrossingVideo.n_frames)] == [r.tracks for r in engine]


def test_frame_without_a_later_time_leaves_the_engine_as_it_was():
    engine = engine_of(CrossingVideo(), EllipseParticleTracker())
    frames = list(CrossingVideo())[:40]
    expected = [result.tracks for result in stepped(engine, 40)]
    engine.reset()
    tracks = [engine.step(frame).tracks for frame in frames[:30]]
    for time_s in (math.nan, math.inf, frames[29].timestamp_s, 0.0):
        with pytest.raises(InputError, match="frame 30: its time"):
            engine.step(replace(frames[30], timestamp_s=time_s))
    assert tracks + [engine.step(frame).tracks for frame in frames[30:]] == expected


def test_engine_that_resumes_refuses_a_frame_from_before():
    engine, resumed = (engine_of(CrossingVideo(), EllipseParticleTracker()) for _ in range(2))
    stepped(engine, 3)
    resumed.set_state(engine.state())
    with pytest.raises(InputError, match=r"0\.2 s"):
        resumed.step(list(CrossingVideo())[2])


def test_frames_of_another_kind_of_recording_are_refused(engine):
    with pytest.raises(InputError, match="one image"):
        engine.step(Frame(0, 0.0, ((np.zeros((48, 64), np.uint8),),)))


@pytest.mark.parametrize(("returned", "found"), [(None, "None"), ([(1.0, 2.0)], r"\[\(1.0, 2.0\)\]")])
def test_trackers_that_return_anything_but_track_states_are_refused(returned, found):
    tracker = EllipseParticleTracker()
    tracker.update = lambda observation: returned
    with pytest.raises(InputError, match=f"EllipseParticleTracker.update, found {found}"):
        next(iter(engine_of(CrossingVideo(), tracker)))


class OwnTracker(EllipseParticleTracker):
    """A tracker of somebody else's module."""


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        ([TrackState(1, "Confirmed", 1.0, 1.0)], "the state 'Confirmed'"),
        ([TrackState(1, "lost"), TrackState(1, "lost")], "the id 1 twice"),
        ([TrackState(1, "lost", x_m=None)], "the x_m None"),
        ([TrackState(1, "lost", box_px=(1.0, 2.0))], "the box (1.0, 2.0)"),
    ],
)
def test_rows_that_no_table_holds_are_named_at_the_first_frame(rows, found):
    tracker = OwnTracker()
    tracker.update = lambda observation: rows
    with pytest.raises(InputError, match=re.escape(f"OwnTracker.update for tracks.csv, found {found}")):
        next(iter(engine_of(CrossingVideo(), tracker)))


def test_labels_of_another_size_are_named():
    tracker = OwnTracker()
    tracker.feedback = lambda: np.zeros((3, 3), np.uint8)
    with pytest.raises(InputError, match=r"\(3, 3\)"):
        next(iter(engine_of(CrossingVideo(), tracker)))


def test_results_are_short_in_a_console():
    result = next(iter(engine_of(CrossingVideo(), EllipseParticleTracker())))
    assert repr(result) == "FrameResult(frame 0, 0.00 s, 0 tracks)"
    assert repr(TrackState(3, "lost", 1.234, 2.0)) == "TrackState(3, lost, x_m=1.23, y_m=2.00, height_m=nan)"


def test_arguments_of_another_type_are_refused_by_name(recording, tmp_path):
    with pytest.raises(InputError, match="config="):
        planview.open_engine(recording, config=[1])
    with pytest.raises(InputError, match="options="):
        planview.open_engine(recording, options={"fps": 30.0})
    with pytest.raises(InputError, match="tracker="):
        planview.open_engine(recording, EllipseParticleTracker)
    (tracker := EllipseParticleTracker()).foreground_columns = "a"
    with pytest.raises(InputError, match="foreground_columns"):
        engine_of(CrossingVideo(), tracker)
    with pytest.raises(InputError, match="NoneType"):
        planview.count(None, tmp_path / "rules.toml")
    with pytest.raises(InputError, match=r"\(9, 1\)"):
        planview.evaluate(tmp_path, frames=(9, 1))
    with pytest.raises(InputError, match="frames="):
        planview.run(recording, frames=-1)


@pytest.mark.parametrize("known", [True, False])
def test_an_engine_without_stereo_says_what_it_knows_of_its_camera(known):
    engine = engine_of(CrossingVideo(), EllipseParticleTracker(), camera=CAMERA if known else None)
    assert engine.rigs == {}
    assert (engine.camera_info() is not None, engine.floor_info() is not None) == (known, known)


class Brightest:
    """Follows the brightest pixel; gives no feedback, as trackers of plan-view maps do."""

    needs = "maps"
    decisions: tuple[Decision, ...] = ()

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        image = observation.views[0].image
        row, column = np.unravel_index(int(image.argmax()), image.shape)
        return (TrackState(1, "confirmed", box_px=(float(column), float(row), 1.0, 1.0)),)

    def feedback(self) -> U8 | None:
        return None

    def debug(self) -> TrackerDebug:
        return TrackerDebug()

    def reset(self) -> None:
        """Nothing is remembered."""


class BrightestInImage(Brightest):
    """The same as an ``ImageTracker``."""

    needs = "image"
    foreground_columns = None

    def study(self, observations: Iterable[Observation]) -> None:
        """Nothing to learn."""


def test_an_engine_with_a_tracker_that_gives_no_state_has_none():
    with pytest.raises(TypeError, match=r"BrightestInImage has no state\(\)"):
        engine_of(CrossingVideo(), BrightestInImage()).state()


class Remembering(BrightestInImage):
    """Hands out the list that it goes on with."""

    def __init__(self) -> None:
        self.times_s = []

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        self.times_s.append(observation.timestamp_s)
        return ()

    def state(self) -> dict[str, list[float]]:
        return {"times_s": self.times_s}

    def set_state(self, state: dict[str, list[float]]) -> None:
        self.times_s = state["times_s"]


def test_the_state_of_an_engine_is_a_copy_whatever_its_tracker_hands_out():
    tracker = Remembering()
    engine = engine_of(CrossingVideo(), tracker)
    first, second, third, *_ = engine.recording
    engine.step(first)
    state = engine.state()
    for frame in (second, third):
        engine.step(frame)
        engine.set_state(state)
        assert tracker.times_s == [0.0]


@pytest.fixture
def clip(tmp_path) -> Path:
    for i in range(3):
        image = np.zeros((48, 64), np.uint8)
        image[20, 10 + i] = 255
        cv2.imwrite(str(tmp_path / f"{i:03}.png"), image)
    return tmp_path


def test_a_tracker_of_images_gets_the_frames_of_one_camera(clip):
    engine = open_engine(clip, BrightestInImage(), options=planview.OpenOptions(fps=10))
    boxes = [result.tracks[0].box_px[:2] for result in engine]
    assert boxes == [(10, 20), (11, 20), (12, 20)]


def test_a_tracker_of_plan_view_maps_needs_depth(clip):
    with pytest.raises(InputError):
        open_engine(clip, Brightest())


def test_maps_of_a_depth_image_of_ones_own_take_the_three_lines_of_the_api_page():
    page = (Path(__file__).resolve().parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
    block = page.partition("## Maps of a depth image")[2].partition("```python\n")[2].partition("```")[0].strip()
    depth_m, people = np.full((480, 640), 10.0, np.float32), np.zeros((480, 640), np.uint8)
    depth_m[220:260, 300:340], people[220:260, 300:340] = 1.2, 1  # a head below the middle of the image
    names = {"planview": planview, "np": np, "depth_m": depth_m, "people": people}
    exec(block.rpartition("\n\n")[2], names)
    maps, height_m = names["maps"], 2.7 - 1.2 * math.cos(math.radians(30))
    assert block.rpartition("\n\n")[2].count("\n") == 2
    assert float(maps.height.max()) == pytest.approx(height_m, abs=0.1)
    row, column = np.unravel_index(int(np.argmax(maps.occupancy)), maps.occupancy.shape)
    x_m, y_m = maps.grid.centre_of(float(row), float(column))
    assert (x_m, y_m) == pytest.approx((0.0, 1.2 * math.sin(math.radians(30))), abs=0.1)


def placed(result: FrameResult) -> list[tuple[int, float, float]]:
    return [(person.track_id, person.x_m, person.y_m) for person in result.tracks]


def test_loop_of_the_architecture_page_gives_the_tracks_of_the_engine(engine):
    page = (Path(__file__).resolve().parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
    names = {"Observation": Observation, "StageClock": StageClock, "FrameResult": FrameResult}
    exec(page.partition("```python\n")[2].partition("```")[0], names)
    expected = [placed(result) for result in engine]
    engine.reset()
    looped = names["track"](engine.recording, engine.sensors, engine.tracker)
    assert any(expected)
    assert [placed(result) for result in looped] == expected


def test_point_cloud_of_a_frame_lies_on_its_surfaces(engine):
    result = next(r for r in engine if r.frame == EMPTY + 5)
    points = np.asarray(result.point_cloud().points)
    person = result.tracks[0]
    near = np.hypot(points[:, 0] - person.x_m, points[:, 1] - person.y_m) < 0.2
    assert abs(np.median(points[~near, 2])) < 0.1
    assert points[near, 2].max() > 1.2
    assert len(points) == len(result.point_cloud().colors)


def test_template_of_a_person_is_as_high_as_the_person(engine):
    result = next(r for r in engine if r.frame == EMPTY + 5)
    height, occupancy = result.template(result.tracks[0]) or pytest.fail("no template")
    assert height.max() == pytest.approx(result.tracks[0].height_m, abs=0.15)
    assert occupancy.max() > 0


def test_paths_may_be_text(recording, tmp_path):
    (tmp_path / "c.toml").write_text("seed = 7\n")
    (tmp_path / "t.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n0,0,1,0,0,confirmed\n")
    assert planview.load_config(str(tmp_path / "c.toml")).seed == 7
    assert len(planview.read_tracks(str(tmp_path / "t.csv"))) == 1
    assert planview.open_recording(str(recording)).n_frames > 0


def test_configuration_may_be_tables_of_what_differs(recording):
    engine = planview.open_engine(str(recording), config={"analysis": {"setup_frames": 4}})
    assert engine.config.analysis.setup_frames == 4
    with pytest.raises(planview.InputError, match=r"config=: .*did you mean analysis\.setup_frames"):
        planview.open_engine(str(recording), config={"analysis": {"setup_frame": 4}})
