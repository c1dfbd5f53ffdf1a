"""Whole evaluations."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_tracks import positions_table

from calib.errors import InputError, WorkError
from planview.api.scores import evaluate
from planview.evaluation.align import FloorAlignment, align_tracks, move_tracks
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.evaluation.result import KINDS
from planview.output.folder import RunInfo, write_run_info
from planview.output.report.page import scores_of
from planview.output.run_folder import RunFolder
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, concatenate

KEYS = (
    "truth_rows", "mota", "motp_m", "idf1", "hota", "switches", "misses", "false_positives", "position_error_mean_m",
    "position_error_std_m", "height_error_mean_m", "significant_errors", "mostly_tracked", "mostly_lost",
    "fragmentations", "switches_per_minute", "ass_a", "det_a", "significant_errors_per_10_min",
    "significant_errors_per_10_min_upper", "events", "events_per_10_min", "events_per_10_min_upper",
    "strict_identity_changes", "strict_per_10_min", "by_distance", "by_visibility", "by_people",
)  # fmt: skip


def walk(n: int = 100, track_id: int = 1, x_m: float = 0.0, height_m: float = 1.7, start: int = 0) -> Trajectories:
    """A person walking along y at x_m, 30 frames per second."""
    frame = start + np.arange(n)
    xy = np.column_stack([np.full(n, x_m), 0.03 * frame])
    return positions_table(frame, np.full(n, track_id), xy, np.full(n, height_m), frame / 30)


def test_evaluation_measures_the_errors_of_matches():
    result = evaluate_tracks(walk(x_m=0.1, height_m=1.75), walk()).to_json()
    assert result["truth_rows"] == 100
    assert (result["mota"], result["idf1"]) == (1.0, 1.0)
    assert result["motp_m"] == result["position_error_mean_m"] == pytest.approx(0.1)
    assert result["position_error_std_m"] == pytest.approx(0.0, abs=1e-9)
    assert result["height_error_mean_m"] == pytest.approx(0.05)
    assert result["significant_errors"] == dict.fromkeys(("total", *KINDS), 0)


def test_facing_of_walkers_is_compared_apart_from_standers():
    # The walker goes along y, the other stands; both face y, the walker by 30 degrees off, the other backwards.
    walker, stander = walk(), walk(track_id=2, x_m=2.0)
    stander = replace(stander, y_m=np.zeros(100))
    truth = concatenate([walker, stander])
    truth = replace(truth, facing_deg=np.full(200, 90.0))
    tracks = replace(truth, facing_deg=np.where(truth.track_id == 1, 120.0, -85.0))
    result = evaluate_tracks(tracks, truth)
    walkers, standers = (result.to_json()["facing"][name] for name in ("walkers", "standers"))
    assert (walkers["rows"], walkers["sure_share"], walkers["sure_right_share"]) == (100, 1.0, 1.0)
    assert walkers["median_deg"] == walkers["median_modulo_180_deg"] == pytest.approx(30)
    assert (standers["rows"], standers["sure_share"], standers["sure_right_share"]) == (100, 1.0, 0.0)
    assert (standers["median_deg"], standers["median_modulo_180_deg"]) == pytest.approx((175, 5))
    assert result.facing.walkers_deg == pytest.approx(30)


def test_facing_that_is_not_sure_counts_as_an_axis():
    truth = replace(walk(), facing_deg=np.full(100, 90.0))
    tracks = replace(truth, facing_deg=np.full(100, -80.0), facing_confidence=np.repeat([0.6, 0.95], [75, 25]))
    walkers = evaluate_tracks(tracks, truth).to_json()["facing"]["walkers"]
    assert (walkers["rows"], walkers["sure_share"], walkers["sure_right_share"]) == (100, 0.25, 0.0)
    assert (walkers["median_deg"], walkers["median_modulo_180_deg"]) == pytest.approx((170, 10))


def test_without_truth_of_facing_walkers_are_compared_with_their_way():
    tracks = replace(walk(), facing_deg=np.full(100, 100.0))
    result = evaluate_tracks(tracks, walk())
    assert "facing" not in result.to_json()
    assert result.facing.walkers_deg == pytest.approx(10)
    assert evaluate_tracks(walk(), walk()).facing.walkers_deg is None


def test_rates_are_over_the_time_scored():
    # 300 frames at 30 fps are 10 s; the id changes at frame 150: one switch, one significant error.
    tracks = replace(walk(300), track_id=np.repeat([1, 2], 150))
    result = evaluate_tracks(tracks, walk(300)).to_json()
    assert result["duration_s"] == pytest.approx(10.0)
    assert result["switches_per_minute"] == pytest.approx(6.0)
    assert (result["significant_errors"]["lost"], result["strict_identity_changes"]) == (1, 1)
    assert result["significant_errors_per_10_min"] == result["strict_per_10_min"] == pytest.approx(60.0)
    assert (result["events"], result["events_per_10_min"]) == (1, pytest.approx(60.0))
    assert result["events_per_10_min_upper"] == pytest.approx(60 * 4.744, rel=1e-3)


def test_breakdown_groups_rows():
    # Person 1 stands 1 m away, tracked 0.1 m off; person 2, half hidden, 5 m away in the first 40 frames, untracked.
    near = positions_table(np.arange(100), np.full(100, 1), np.tile([0.0, 1.0], (100, 1)))
    far = positions_table(np.arange(40), np.full(40, 2), np.tile([3.0, 4.0], (40, 1)), visible=np.full(40, 0.5))
    result = evaluate_tracks(replace(near, x_m=near.x_m + 0.1), concatenate([near, far])).to_json()

    def counts(key):
        return {row["group"]: (row["truth_rows"], row["matches"]) for row in result[key] if row["truth_rows"]}

    assert counts("by_distance") == {"0-2": (100, 100), "4-6": (40, 0)}
    assert counts("by_visibility") == {"0.5-0.75": (40, 0), "0.75-1": (100, 100)}
    assert counts("by_people") == {"1-2": (140, 100)}
    assert result["by_distance"][0]["position_error_mean_m"] == pytest.approx(0.1)
    assert result["by_distance"][2]["position_error_mean_m"] is None


@pytest.mark.parametrize("state", ["tentative", "lost"])
def test_rows_that_are_not_confirmed_are_neither_found_nor_false(state):
    result = evaluate_tracks(replace(walk(), state=np.full(100, state)), walk())
    assert (result.clear.misses, result.clear.false_positives) == (100, 0)


def test_frames_limit_both_tables():
    result = evaluate_tracks(walk(50), walk(), frames=(10, 49))
    assert (result.sequence.truth_rows, result.clear.misses, result.sequence.track_rows) == (40, 0, 40)


def test_scene_without_people_scores_false_tracks_only():
    result = evaluate_tracks(walk(60), walk(0)).to_json()
    assert (result["mota"], result["false_positives"], result["significant_errors"]["false_track"]) == (None, 60, 1)


def test_run_without_tracks_misses_everybody():
    result = evaluate_tracks(walk(0), walk()).to_json()
    assert (result["mota"], result["misses"], result["motp_m"]) == (0.0, 100, None)
    assert result["significant_errors"]["missed"] == 1


def test_prediction_saves_a_person_from_being_lost_but_not_from_misses():
    tracks = walk()
    state = np.where((tracks.frame >= 30) & (tracks.frame < 75), "lost", "confirmed")
    held = evaluate_tracks(replace(tracks, state=state), walk())
    assert (held.clear.misses, held.significant) == (45, [])
    gone = evaluate_tracks(tracks.where(state == "confirmed"), walk())
    assert [(error.kind, error.frame) for error in gone.significant] == [("lost", 30)]


def strays(x_m: float) -> Trajectories:
    """Lost from frame 30 on, and predicted x_m away from the person."""
    tracks = walk()
    held = tracks.frame < 30
    return replace(tracks, state=np.where(held, "confirmed", "lost"), x_m=np.where(held, 0, x_m))


def test_prediction_that_strays_from_its_person_is_a_false_track_where_the_truth_has_the_person():
    other = walk(70, track_id=2, start=30)  # the person walks on under another id
    result = evaluate_tracks(concatenate([strays(0.6), other]), walk())
    assert [(e.kind, e.frame, e.track_id) for e in result.significant] == [("false_track", 30, 1), ("lost", 30, 1)]
    assert result.events == 1
    assert [e.kind for e in evaluate_tracks(concatenate([strays(0.4), other]), walk()).significant] == ["lost"]
    assert evaluate_tracks(strays(3.0), walk(30)).significant == []


def test_hidden_person_is_neither_missed_nor_a_reason_for_false_positives():
    truth = replace(walk(), visible=np.where(np.arange(100) < 40, 0.1, 1.0))
    for result in (evaluate_tracks(walk(60, start=40), truth), evaluate_tracks(walk(), truth)):
        assert (len(result.significant), result.ignored_rows, result.sequence.truth_rows) == (0, 40, 60)
        assert (result.clear.misses, result.clear.false_positives, result.clear.mota) == (0, 0, 1.0)
    assert evaluate_tracks(walk(), truth, EvaluationParams(min_visible=0.0)).sequence.truth_rows == 100


HIDDEN = replace(walk(), visible=np.full(100, 0.1))


def test_hidden_person_excuses_no_second_track():
    twice = concatenate([walk(track_id=1), walk(track_id=2, x_m=0.2)])
    assert evaluate_tracks(twice, HIDDEN).clear.false_positives == 100


def test_track_of_a_hidden_person_is_not_handed_to_the_untracked_neighbour():
    result = evaluate_tracks(walk(track_id=7), concatenate([HIDDEN, walk(track_id=2, x_m=0.4)]))
    assert (result.clear.misses, result.clear.false_positives) == (100, 0)


def test_boxes_match_at_half_overlap_without_floor_positions():
    nowhere = np.full((10, 2), np.nan)
    box = np.tile([10.0, 10.0, 20.0, 60.0], (10, 1))
    truth = positions_table(np.arange(10), np.ones(10, np.int64), nowhere, box_px=box)
    params = EvaluationParams(match_on="boxes")
    near, far = (replace(truth, box_px=box + np.array([right, 0, 0, 0])) for right in (5, 11))
    assert evaluate_tracks(near, truth, params).clear.mota == 1.0
    assert evaluate_tracks(far, truth, params).clear.mota == -1.0
    assert evaluate_tracks(near, truth, params).to_json()["motp_m"] is None


def test_boxes_measure_metres_only_in_a_common_frame():
    box = np.column_stack([10.0 * np.arange(100), np.zeros(100), np.full(100, 20.0), np.full(100, 60.0)])
    truth = replace(walk(), box_px=box)
    tracks = replace(walk(x_m=40.0), box_px=box)
    params = EvaluationParams(match_on="boxes")
    assert evaluate_tracks(tracks, truth, params).to_json()["motp_m"] is None
    aligned = evaluate_tracks(tracks, truth, params.model_copy(update={"align": True}))
    assert aligned.to_json()["motp_m"] == pytest.approx(0.0, abs=1e-9)


def test_tracks_without_positions_on_the_floor_are_refused():
    tracks = replace(walk(), x_m=np.full(100, np.nan))
    with pytest.raises(InputError, match="tracks with floor positions"):
        evaluate_tracks(tracks, walk())


def write(path: Path, header: str, rows: list[str]) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture
def files(tmp_path) -> tuple[Path, Path]:
    tracks = [f"{t},{t / 30:.4f},1,0.1,{0.03 * t:.2f},1.75,confirmed" for t in range(60)]
    truth = [f"{t},4,0.0,{0.03 * t:.2f},1.7,1" for t in range(90)]
    return (
        write(tmp_path / "tracks.csv", "frame,timestamp_s,id,x_m,y_m,height_m,state", tracks),
        write(tmp_path / "truth.csv", "frame,id,x_m,y_m,height_m,visible", truth),
    )


def test_evaluate_prints_one_json_object_with_the_agreed_keys(files, json_of):
    result = json_of("evaluate", *files)
    assert all(key in result for key in KEYS)
    assert set(result["significant_errors"]) == {"total", "lost", "missed", "swapped", "transferred", "false_track"}


def test_evaluate_scores_the_frames_of_the_run_as_its_report_does(files, json_of):
    folder = files[0].parent
    info = RunInfo(input=str(folder), finished=True, frames_read=75, fps=30.0)
    write_run_info(info, folder / "run.json")
    result = json_of("evaluate", folder)
    scores = scores_of(RunFolder(folder))
    printed = scores.to_json()
    assert result["duration_s"] == pytest.approx(2.5, abs=0.01)
    assert result["misses"] == 15
    assert {key: result[key] for key in printed} == printed


@pytest.mark.parametrize(
    ("truth", "note"),
    [
        ([f"{t},4,0.0,{0.03 * t:.2f},1.7,1" for t in range(20)], "33% of the tracks' rows are judged"),
        (
            [f"{t},4,900,{9000 + 30 * t},1700,1" for t in range(60)],
            "the truth's unit is millimetres",
        ),
    ],
    ids=["no rows in most frames", "another unit"],
)
def test_truth_that_does_not_fit_is_noted(files, cli, truth, note):
    write(files[1], "frame,id,x_m,y_m,height_m,visible", truth)
    status, printed = cli("evaluate", *files)
    assert status == 0
    assert note in " ".join(printed.split())


def test_truth_of_other_frames_is_refused_naming_both_files(files, refused):
    files[1].write_text("frame,id,x_m,y_m,height_m\n500,1,0,0,1.7\n501,1,0,0,1.7\n")
    printed = refused("evaluate", *files)
    assert f"{files[1]}: expected truth of the frames 0 to " in printed
    assert printed.endswith(f"of {files[0]}, found 500 to 501")


def test_evaluate_lists_each_significant_error(files, shown_by):
    text = files[1].read_text() + "".join(f"{t},5,3,3,1.6,1\n" for t in range(20, 90))
    files[1].write_text(text)
    shown = shown_by("evaluate", *files, "--frames", "0:89", "--gate", "0.3")
    assert "frame 20: missed: person 5" in shown


MOT16_ROWS = "".join(f"{t},1,{10 * t},20,30,40,1,1,1\n" for t in range(1, 6))


def test_evaluate_pools_recordings_of_one_name(tmp_path, json_of):
    for name, rows in (("a", MOT16_ROWS), ("b", MOT16_ROWS + "1,2,400,20,30,40,1,1,1\n")):
        (tmp_path / "gt" / name / "gt").mkdir(parents=True)
        (tmp_path / "gt" / name / "gt" / "gt.txt").write_text(rows)
    (tmp_path / "mine" / "data").mkdir(parents=True)
    for name in ("a", "b", "extra"):
        results = MOT16_ROWS.replace(",1,1,1\n", ",1,-1,-1,-1\n")
        (tmp_path / "mine" / "data" / f"{name}.txt").write_text(results)
    result = json_of("evaluate", tmp_path / "mine", tmp_path / "gt", "--boxes")
    assert {name: scores["misses"] for name, scores in result["recordings"].items()} == {"a": 0, "b": 1}
    assert (result["truth_rows"], result["misses"], result["mota"]) == (11, 1, pytest.approx(10 / 11))


def test_evaluate_names_the_recording_without_tracks(tmp_path, refused):
    for folder in ("gt", "mine"):
        (tmp_path / folder).mkdir()
    (tmp_path / "gt" / "a.txt").write_text(MOT16_ROWS)
    assert "expected tracks for 'a'" in refused("evaluate", tmp_path / "mine", tmp_path / "gt", "--boxes")


def test_evaluate_refuses_boxes_outside_of_the_sequences_images(tmp_path, refused):
    (tmp_path / "seqinfo.ini").write_text("[Sequence]\nimWidth=100\nimHeight=80\n")
    for name, rows in (("gt.txt", MOT16_ROWS), ("mine.txt", "1,1,500,20,30,40\n")):
        (tmp_path / name).write_text(rows)
    sentence = refused("evaluate", tmp_path / "mine.txt", tmp_path / "gt.txt", "--boxes")
    assert "expected boxes inside images of 100x80, found 1 of 1 outside" in sentence


def test_motchallenge_distractor_is_neither_person_nor_error(tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text(MOT16_ROWS + "".join(f"{t},9,300,20,30,40,0,8,1\n" for t in range(1, 6)))
    truth = load_truth(path)
    tracks = replace(truth, visible=np.ones(len(truth)))
    result = evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes", min_visible=0.0))
    assert (result.sequence.truth_rows, result.clear.false_positives, result.clear.mota) == (5, 0, 1.0)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--gate", "-1"], "--gate: "),
        (["--min-visible", "2"], "--min-visible: "),
        (["--frames", "9:3"], "--frames: expected FIRST:LAST, FIRST not after LAST"),
        (["--boxes"], "image boxes"),
        ([], "tracks.csv"),
    ],
)
def test_evaluate_refuses_bad_usage_in_one_sentence(files, refused, words, sentence):
    if not words:
        files[0].unlink()
    assert sentence in refused("evaluate", *files, *words)


def test_truth_of_every_fifth_frame_leaves_the_others_out():
    tracks, truth = walk(101), walk(101)
    truth = truth.where(truth.frame % 5 == 0)
    result = evaluate_tracks(tracks, truth)
    assert (result.clear.mota, result.clear.false_positives, result.unjudged_rows) == (1.0, 0, 80)
    assert result.duration_s == pytest.approx(21 * 5 / 30)
    assert "every 5th frame only" in result.doubts
    stray = evaluate_tracks(replace(tracks, x_m=tracks.x_m + 5 * (tracks.frame >= 50)), truth)
    assert [(error.kind, error.frame) for error in stray.significant] == [("false_track", 50), ("lost", 50)]


def test_rows_without_a_position_are_counted():
    tracks = walk(10)
    tracks.x_m[3] = np.inf
    result = evaluate_tracks(tracks, walk(10))
    assert result.unplaced_rows == 1
    assert "1 rows without a finite position" in result.doubts


def test_what_a_run_returns_is_scored_on_the_frames_that_it_read():
    tracks = replace(walk(50), n_frames=60)
    assert evaluate(tracks, walk()).clear.misses == 10
    assert evaluate(tracks.where(tracks.frame < 40), walk()).clear.misses == 20
    assert evaluate(walk(50), walk()).clear.misses == 50


def test_tracks_that_begin_later_are_scored_from_their_first_frame_on():
    tracks = replace(walk(20, start=40), first_frame=30, n_frames=70)
    assert evaluate(tracks, walk()).clear.misses == 20
    assert evaluate(tracks.to_dataframe(), walk()).clear.misses == 20


def test_truth_beyond_the_tracks_of_a_table_is_noted():
    with pytest.warns(UserWarning, match="40 truth rows"):
        evaluate(replace(walk(50), n_frames=60), walk())


MOTION = FloorAlignment(math.radians(120), 3.0, -2.0, 0.0, 0)


def two_walkers() -> Trajectories:
    frame = np.repeat(np.arange(40), 2)
    walker = np.tile([1, 2], 40)
    t = frame / 40
    xy = np.column_stack([np.where(walker == 1, 3 * t, 1 + 0.5 * t), np.where(walker == 1, 0.2 * t, 2 - 3 * t)])
    return positions_table(frame, walker, xy)


def test_alignment_finds_the_motion_from_noisy_paths():
    truth = move_tracks(two_walkers(), MOTION)
    noisy = two_walkers()
    rng = np.random.default_rng(1)
    xy = np.column_stack([noisy.x_m, noisy.y_m]) + rng.normal(0, 0.05, (80, 2))
    tracks = positions_table(noisy.frame, 10 - noisy.track_id, xy)
    order = np.lexsort((tracks.track_id, tracks.frame))
    laid, alignment = align_tracks(tracks.where(order), truth, 0.5)
    assert alignment.pairs == 80
    assert math.degrees(alignment.rotation_rad) == pytest.approx(120, abs=1.0)
    assert alignment.rms_m < 0.1
    assert np.isfinite(laid.x_m).all()


def test_alignment_starts_from_boxes_where_both_have_them():
    plain = two_walkers()
    xy = np.column_stack([plain.x_m, plain.y_m])
    box = np.column_stack([100 * plain.x_m, 100 * plain.y_m + 300, np.full(80, 40.0), np.full(80, 80.0)])
    tracks = positions_table(plain.frame, plain.track_id, xy, box_px=box)
    truth = positions_table(plain.frame, plain.track_id, MOTION.apply(xy), box_px=box)
    _, alignment = align_tracks(tracks, truth, 0.5)
    assert (alignment.x_m, alignment.y_m) == pytest.approx((3.0, -2.0))


def test_alignment_needs_people_who_move():
    still = positions_table(np.arange(20), np.ones(20, np.int64), np.zeros((20, 2)))
    with pytest.raises(WorkError, match="tracks that move"):
        align_tracks(still, still, 0.5)
