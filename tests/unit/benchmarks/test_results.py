"""The page of results: figures from JSON, which failures get a picture, and files that cannot serve."""

import json

import pytest

from benchmarks.results import Failure, failures, interval, load_report, number, results_page, shown
from calib.errors import InputError

TOTALS = {
    "minutes": 12.8, "significant": {"total": 2, "lost": 1, "missed": 0, "swapped": 1, "false_track": 0},
    "significant_per_10_min": 1.5625, "strict_per_10_min": 3.0, "mota": 0.95, "idf1": 0.97, "switches": 3,
    "position_error_m": 0.048, "position_std_m": 0.031, "height_error_m": None,
}  # fmt: skip


def error(kind, frame, duration_s=1.0, person=1):
    return {"kind": kind, "frame": frame, "truth_id": person, "track_id": 2, "duration_s": duration_s, "note": "n"}


def scene(*errors):
    return {
        "scene": "trio", "seed": 7, "frames": 450, "duration_s": 30.0, "mota": 0.95, "position_error_mean_m": 0.05,
        "significant_errors": {"total": len(errors)}, "significant_error_list": list(errors),
    }  # fmt: skip


def suite(online, refined):
    ways = {"online": online, "refined": refined}
    scenes = {way: {"scenes": [one], "totals": TOTALS} for way, one in ways.items()}
    return {"seeds": [7, 100], "commit": "abc1234", "date": "2026-11-22", **scenes}


def test_failure_is_gone_when_no_refined_error_of_its_kind_begins_within_two_seconds():
    report = suite(scene(error("swapped", 100), error("lost", 200)), scene(error("swapped", 129), error("lost", 231)))
    assert [f.refined for f in failures(report)] == [True, False]


def test_pictures_go_to_every_kind_in_turn_the_longest_first():
    found = [Failure({}, error("lost", k, duration_s=k), None) for k in (1, 3, 2)]
    found.append(Failure({}, error("swapped", 4), None))
    assert [f.error["frame"] for f in shown(found, 3)] == [3, 2, 4]
    assert shown(found, 0) == []


def test_page_gives_seeds_commit_figures_and_the_papers_beside():
    page = results_page(suite(scene(error("lost", 200)), scene()), None, [])
    assert "7 (worked on), 100 (judging)" in page
    assert "Commit abc1234, 2026-11-22" in page
    assert "| online | 12.8 | 1.6 | 3.0 | 1, 0, 1, 0 | 0.950 | 0.970 | 4.8 ± 3.1 | - | 3 |" in page
    assert "| trio | 7 | 1 | 0 | 0.950 | 5.0 |" in page
    assert "18 ± 14" in page


def test_page_has_the_ablation_with_intervals():
    figures = {key: [0.5, 0.0, 1.0] for key in ("per_10_min", "change_per_10_min", "misses", "false_positives")}
    row = {"variant": "height only", "settings": ["maps.statistic=height"], "paper_significant_errors": 17, **figures}
    row["position_error_m"] = [0.05, 0.04, 0.06]
    table = {"recordings": ["trio-7"], "variants": [row], "commit": "abc1234", "date": "2026-11-22"}
    page = results_page(suite(scene(), scene()), table, [])
    assert "| height only | `maps.statistic=height` | 0.5 [0.0, 1.0] | 0.5 [0.0, 1.0] | 17 |" in page
    assert "5.0 [4.0, 6.0] |" in page


def test_figure_that_is_not_known_is_a_dash():
    assert number(None) == "-"
    assert interval([None, None, None]) == "-"


@pytest.mark.parametrize(
    ("text", "found"),
    [("", "Expecting value"), ('{"online": {"scen', "Unterminated"), ('{"a": 1}', "found a"), ("[]", "found list")],
)
def test_report_that_is_cut_off_or_of_another_bench_is_refused_in_one_sentence(tmp_path, text, found):
    path = tmp_path / "suite.json"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"suite\.json: expected the JSON of a bench.*{found}"):
        load_report(path, "online")


def test_report_that_is_missing_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.json: expected the JSON"):
        load_report(tmp_path / "none.json", "online")


def test_report_of_the_suite_is_read(tmp_path):
    path = tmp_path / "suite.json"
    path.write_text(json.dumps(suite(scene(), scene())))
    assert load_report(path, "online")["seeds"] == [7, 100]
