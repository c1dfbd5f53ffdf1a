"""Random scenes."""

import copy
import tomllib
from itertools import combinations
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.random_scenes.generator import KINDS, SUITE, random_scene, scene_of_table
from benchmarks.random_scenes.stage import EXPOSURE_DELAY_S, FreeFloor, automatic_exposure
from benchmarks.random_scenes.tables import Challenge, NoPlaceError, Phenomenon, resolved
from calib.errors import InputError, WorkError
from planview.synthetic.camera import ground_camera
from planview.synthetic.people import Cast
from planview.synthetic.texture import Palette

FILES = sorted(SUITE.glob("*.toml"))
TABLE = {
    "description": "two cross, one stands",
    "covers": ["320x240"],
    "duration_s": 12,
    "room": {"width_m": {"min": 5.5, "max": 7.0}, "depth_m": {"min": 5.5, "max": 7.0}},
    "camera": {"lens_deg": {"min": 58, "max": 74}, "height_m": {"min": 2.1, "max": 2.5}},
    "choreography": [
        {"kind": "cross", "people": 2, "duration_s": 8},
        {"kind": "stand", "people": 1, "duration_s": {"min": 3, "max": 6}},
    ],
}


def challenge(seed, *choreography, name="test", **values):
    table = copy.deepcopy(TABLE) | values
    return scene_of_table("suite", table | ({"choreography": choreography} if choreography else {}), seed, name).scene


def test_range_gives_a_number_in_it_and_a_choice_one_of_its_list():
    rng = np.random.default_rng(1)
    got = [
        resolved({"a": {"min": 1, "max": 3}, "b": {"min": 0.5, "max": 0.6}, "c": {"choose": ["x", "y"]}, "d": [4]}, rng)
        for _ in range(50)
    ]
    assert {g["a"] for g in got} == {1, 2, 3} and all(0.5 <= g["b"] < 0.6 for g in got)
    assert {g["c"] for g in got} == {"x", "y"} and got[0]["d"] == [4]


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_committed_challenge_is_valid_for_all_its_ranges(path):
    table = tomllib.loads(path.read_text())
    for seed in range(20):
        challenge = Challenge.model_validate(resolved(table, np.random.default_rng(seed)))
        assert challenge.choreography and challenge.covers


def test_committed_challenges_cover_every_phenomenon_and_last_ten_minutes():
    covered = {phenomenon for path in FILES for phenomenon in tomllib.loads(path.read_text())["covers"]}
    assert covered == set(get_args(Phenomenon))
    assert sum(tomllib.loads(path.read_text())["duration_s"] for path in FILES) >= 600


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 10_000))
def test_people_of_every_seed_keep_apart(seed):
    scene = challenge(seed)
    assert 5.5 <= scene.room.size_m[0] <= 7.0 and 2.1 <= scene.mount.at_m[2] <= 2.5
    times = np.arange(0, 12, 0.1)
    places = [m.places(times) for m in Cast(scene, Palette()).motions]
    assert len(places) == 3
    for i, one in enumerate(places):
        for other in places[:i]:
            assert not (np.linalg.norm(one - other, axis=1) < 0.38).any()


@pytest.mark.slow
def test_tightest_scene_is_found():
    for seed in range(9000, 9010):
        assert len(random_scene("suite", seed, SUITE / "overhead.toml").scene.people) == 4


@pytest.mark.parametrize("kind", KINDS)
def test_scene_of_a_seed_is_always_the_same_and_of_another_seed_another(kind):
    path = KINDS[kind][0]
    path = path / "exposure.toml" if path.is_dir() else path
    first, again, other = (random_scene(kind, seed, path) for seed in (3, 3, 4))
    assert first.scene == again.scene and first.scene != other.scene


def test_scenes_of_two_names_differ_and_a_table_of_another_kind_is_refused(tmp_path):
    assert challenge(1, name="other") != challenge(1)
    (tmp_path / "odd.toml").write_text('description = "x"')
    with pytest.raises(InputError, match=r"odd\.toml: expected covers"):
        random_scene("suite", 1, tmp_path / "odd.toml")


def test_people_of_a_meeting_stay_at_their_spacing():
    meeting = {"kind": "meet", "people": 2, "duration_s": 8, "spacing_m": 0.5, "every_s": 1.5}
    scene = challenge(3, meeting, duration_s=24)
    one, other = (m.places(np.arange(0, 24, 0.1)) for m in Cast(scene, Palette()).motions)
    gap = np.linalg.norm(one - other, axis=1)
    close = np.flatnonzero(gap < 0.6)
    assert len(close) > 60  # longer than 6 s of its 8
    assert gap[close].min() > 0.4


def test_pair_walks_in_step_beside_each_other():
    walk = {"kind": "pair", "people": 2, "spacing_m": 0.45, "duration_s": 12, "turns": 2}
    scene = challenge(4, walk, duration_s=18)
    one, other = Cast(scene, Palette()).motions
    times = np.arange(5.0, 8.0, 0.1)
    assert np.linalg.norm(one.places(times) - other.places(times), axis=1) == pytest.approx(0.45, abs=0.02)
    assert scene.people[0].height_m == scene.people[1].height_m
    assert np.cos([one.at(t)[2] - other.at(t)[2] for t in times]) == pytest.approx(1.0, abs=0.05)


def test_walkers_turn_in_view_and_hide_each_other_again_and_again():
    scene = random_scene("suite", 2, SUITE / "crossing.toml").scene
    motions = Cast(scene, Palette()).motions
    x = [m.places(np.arange(0, scene.duration_s, 0.1))[:, 0] for m in motions]
    passes = sum(int((np.diff(np.sign(a - b)[np.isfinite(a - b)]) != 0).sum()) for a, b in combinations(x, 2))
    assert passes >= 6


def test_recording_lasts_until_things_are_taken():
    scene = random_scene("suite", 3, SUITE / "objects.toml").scene
    ends = [motion.script_end_s for motion in Cast(scene, Palette()).motions]
    assert max(ends) < scene.duration_s + 4


def test_similar_clothes_are_the_same_and_children_are_small():
    walkers = {"kind": "cross", "people": 3, "duration_s": 8}
    scene = challenge(5, walkers, clothes="similar", children=1)
    assert len({p.shirt for p in scene.people}) == 1
    assert sorted(p.height_m < 1.25 for p in scene.people) == [False, False, True]


def test_ranges_that_ask_for_too_much_are_refused_in_one_sentence(monkeypatch):
    monkeypatch.setattr("benchmarks.random_scenes.generator.ATTEMPTS", 2)
    crowded = {"kind": "meet", "people": 12, "spacing_m": 1.5}
    with pytest.raises(WorkError, match="test, seed 1: none of 2 attempts fits into its room"):
        challenge(1, crowded)


def test_automatic_exposure_makes_up_for_a_dimmed_lamp_with_a_delay():
    lights = {"ambient": 0.5, "lamps": [{"level": 0.5, "dim": ((5.0, 1.0), (5.01, 0.0))}]}
    exposure = np.array(automatic_exposure(lights, 15.0))
    at = np.interp([4.9, 5.0 + EXPOSURE_DELAY_S, 14.9], exposure[:, 0], exposure[:, 1])
    assert at[0] == pytest.approx(1.0)
    assert at[1] == pytest.approx(2 - 1 / np.e, abs=0.1)  # a first-order lag covers all but 1 / e by its time constant
    assert at[2] == pytest.approx(2.0, abs=0.01)


def test_route_goes_around_what_is_not_free_and_there_is_none_through_a_wall():
    points = 0.2 * np.stack(np.meshgrid(np.arange(21), np.arange(21)), -1).reshape(-1, 2)
    wall = (points[:, 0] > 1.5) & (points[:, 0] < 2.5)
    start, end = np.array([0.4, 0.4]), np.array([3.6, 0.4])
    way = FreeFloor(points[~wall | (points[:, 1] > 2.9)], 0.2).route(start, end)
    assert max(p[1] for p in way) > 2.0 and way[-1] == pytest.approx(end)
    with pytest.raises(NoPlaceError):
        FreeFloor(points[~wall], 0.2).route(start, end)


def test_room_fills_with_twelve_people_who_all_leave() -> None:
    people = random_scene("conference", 1).scene.people
    assert len(people) == 12 and all(person.leaves for person in people)
    seats = [seat for person in people for seat in person.seats]
    assert len(seats) == len(set(seats)) >= 8


def test_middle_of_a_standing_person_on_the_zone_is_in_the_image() -> None:
    room = random_scene("conference", 2)
    corners = np.array(room.zone_m)
    u, v = ground_camera(room.scene.camera).project(np.column_stack([corners, np.full(len(corners), 0.8)])).T
    assert ((u >= 0) & (u < 320) & (v >= 0) & (v < 240)).all()


def test_rigs_of_a_seed_share_their_scene_and_begin_apart() -> None:
    one, other = random_scene("rigs", 5).rigs
    assert one.scene.people == other.scene.people and one.mount.start_s == 0.0 < other.mount.start_s
