"""Scenes: what is refused and how, motion and wandering."""

import numpy as np
import pytest

from calib.errors import InputError
from planview.synthetic import assets
from planview.synthetic.motion import scripted_motion, step_length_m
from planview.synthetic.people import Body, Cast, Pose, pose_at
from planview.synthetic.scene import Furniture, ScenePerson, load_scene, parse_scene
from planview.synthetic.texture import Palette

COMMITTED = sorted(assets.SCENES.rglob("*.toml"))
SCENES = [
    p for p in COMMITTED if p.parent.name not in {"demo", "suite", "views"} and not p.name.endswith(".rules.toml")
]
RIG = "[rig]\nat_m = [3, 0.3, 2.5]\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "either a [rig] or a [camera]"),
        (RIG + "[camera]\nat_m = [3, 0.3, 2.5]\n", "either a [rig] or a [camera]"),
        (RIG + "colour = 3\n", "rig.colour"),
        ("fps = 0\n" + RIG, "fps"),
        ("fps = nan\n" + RIG, "fps"),
        ("duration_s = 1e9\n" + RIG, "duration_s"),
        (RIG + "[[people]]\nstart_m = [1, 1]\nheight_m = 17.8\n", "people.0.height_m"),
        (RIG + "[[people]]\nstart_m = [1, 1]\nsteps = [{ go = [[2, 2]], stand_s = 3 }]\n", "exactly one of go"),
        (RIG + "[[people]]\nstart_m = [1, 1]\nsteps = [{ sit_s = 3, on = 'stool' }]\n", "'stool'"),
        (RIG + "[[people]]\nstart_m = [1, 1]\nshirt = { colour = 'blue' }\n", "people.0.shirt.colour"),
        (RIG + "[lights]\nlamps = [{ kind = 'sun' }]\n", "towards"),
        (RIG + "[room]\nsize_m = [3, 3, 300]\n", "1 to 80 m"),
        ("[camera]\nat_m = [0, 0, 3]\nlens = 'brown'\n", "lens"),
        (RIG + "tilt_deg = [1\n", "TOML"),
    ],
)
def test_scene_that_cannot_be_is_refused_in_one_sentence_naming_the_key(text, said):
    with pytest.raises(InputError) as refusal:
        parse_scene(text, "x.toml")
    assert str(refusal.value).startswith("x.toml: ")
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_missing_and_binary_scene_files_are_refused(tmp_path):
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("a.toml", "b.toml"):
        with pytest.raises(InputError, match=name):
            load_scene(tmp_path / name)


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_committed_scene_loads_and_nobody_walks_through_anybody(path):
    scene = load_scene(path)
    motions = Cast(scene, Palette()).motions
    times = np.arange(0, scene.duration_s, 0.3)
    place = np.array([[m.at(t)[0] if m.exists(t) else [np.nan] * 2 for t in times] for m in motions])
    for i in range(len(motions)):
        speed = np.linalg.norm(np.diff(place[i], axis=0), axis=1) / 0.3
        assert np.nanmax(speed) < 1.7
        for j in range(i):
            gap = np.linalg.norm(place[i] - place[j], axis=1)
            assert not (gap < 0.4).any(), (i + 1, j + 1)


def test_standing_body_is_exactly_as_tall_as_asked_with_its_head_above_its_hips():
    body = Body(ScenePerson(height_m=1.80, start_m=(0, 0)), Palette()).pose(Pose(), 2.0, -1.0, 0.7)
    assert body.top_m == pytest.approx(1.80, abs=1e-5)
    assert body.head[:2] == pytest.approx([2.0, -1.0], abs=0.01)
    assert body.mesh.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_body_faces_its_heading_and_swings_a_flexed_hip_forward():
    still = Body(ScenePerson(start_m=(0, 0)), Palette())
    raised = still.pose(Pose(hip=(1.4, 0.0), knee=(0.2, 0.0)), 0, 0, np.pi / 2)
    assert raised.mesh.vertices[:, 1].max() > 0.6  # the raised leg points along +y
    assert raised.mesh.vertices[:, 1].min() > -0.25


def test_sitting_lowers_the_head_by_the_thigh():
    body = Body(ScenePerson(height_m=1.80, start_m=(0, 0)), Palette())
    sitting = body.pose(Pose(hip=(np.pi / 2, np.pi / 2), knee=(np.pi / 2, np.pi / 2)), 0, 0, 0)
    assert 1.80 - sitting.top_m == pytest.approx(0.245 * 1.80, abs=0.03)


def walker(*steps, **values):
    return ScenePerson.model_validate({"start_m": (0, 0), "steps": steps, **values})


def test_walk_covers_its_way_at_its_speed_and_turns_along_it():
    motion = scripted_motion(walker({"go": [(6, 0)], "speed_mps": 1.2}), {}, 10)
    xy, heading, _, speed, _ = motion.at(2.5)
    assert xy == pytest.approx([3.0, 0.0], abs=0.02)
    assert (heading, speed) == pytest.approx((0.0, 1.2), abs=0.01)
    assert motion.at(9)[0] == pytest.approx([6, 0], abs=0.01)


def test_gait_takes_one_step_per_half_turn_of_its_phase():
    motion = scripted_motion(walker({"go": [(12, 0)], "speed_mps": 1.2}, height_m=1.75), {}, 12)
    turned = motion.at(8)[2] - motion.at(3)[2]
    step = step_length_m(1.75, np.array([1.2]))[0]
    assert turned / np.pi == pytest.approx(5 * 1.2 / step, rel=0.01)


def test_planted_foot_does_not_slide():
    person = walker({"go": [(12, 0)], "speed_mps": 1.2}, height_m=1.75)
    motion, body = scripted_motion(person, {}, 12), Body(person, Palette())
    slid = []
    for t in np.arange(4.0, 5.0, 1 / 15):
        now, then = (body.pose(*pose_at(0, 1.75, motion, u)).mesh.vertices for u in (t, t + 1 / 15))
        slid.append(np.linalg.norm((then - now)[now[:, 2] < 0.012], axis=1).min(initial=1.0))
    assert np.median(slid) < 0.04  # the body moves 8 cm per frame


def test_cartwheel_puts_the_head_down_half_way_and_ends_upright_at_its_point():
    person = walker({"cartwheel": (0, 2)}, height_m=1.75)
    motion, body = scripted_motion(person, {}, 6), Body(person, Palette())
    tops = [body.pose(*pose_at(0, 1.75, motion, t)).top_m for t in np.arange(0.0, 5.0, 0.05)]
    assert min(tops) < 0.9
    assert (tops[0], tops[-1]) == pytest.approx((1.75, 1.75), abs=0.03)
    assert motion.at(5.0)[0] == pytest.approx([0, 2], abs=0.01)


def test_crouching_lowers_the_head_and_a_low_bench_more_than_a_chair():
    seats = {n: Furniture(kind=k, name=n, at_m=(2, 0), size_m=s) for n, k, s in
             (("low", "bench", (0.45, 0.5, 0.33)), ("chair", "chair", None))}  # fmt: skip
    tops = {}
    for name, step in (
        ("crouch", {"crouch_s": 4}),
        ("low", {"sit_s": 9, "on": "low"}),
        ("chair", {"sit_s": 9, "on": "chair"}),
    ):
        person = walker(step, height_m=1.75)
        motion = scripted_motion(person, seats, 12)
        t = 2.0 if name == "crouch" else 9.0
        tops[name] = Body(person, Palette()).pose(*pose_at(0, 1.75, motion, t)).top_m
    assert 0.8 < tops["crouch"] < 1.25
    assert 0.9 < tops["low"] < tops["chair"] - 0.1 < 1.3


def test_person_exists_from_entering_until_leaving():
    motion = scripted_motion(walker({"go": [(1, 0)], "speed_mps": 1.0}, enter_s=3, leaves=True), {}, 20)
    assert [motion.exists(t) for t in (2.9, 3.0, 3.9, 4.5)] == [False, True, True, False]


WANDERERS = RIG + "".join(
    f"[[people]]\nstart_m = [{x}, {y}]\nwander = {{ area_m = [0.5, 1, 5.5, 4.5] }}\n"
    for x in (1, 3, 5)
    for y in (1.5, 4)
)


def test_wanderers_keep_apart_and_another_seed_walks_elsewhere():
    scene = parse_scene("duration_s = 8\n" + WANDERERS, "w")
    once, again, other = (
        np.array([m.at(8)[0] for m in Cast(scene.model_copy(update={"seed": seed}), Palette()).motions])
        for seed in (1, 1, 9)
    )
    gaps = np.linalg.norm(once[:, None] - once, axis=2) + 10 * np.eye(6)
    assert gaps.min() > 0.45
    assert (once == again).all()
    assert not np.allclose(once, other, atol=0.3)


def test_pushed_chair_stays_where_it_was_left_and_carried_box_on_its_height():
    text = RIG + (
        "[[furniture]]\nkind = 'office_chair'\nname = 'c'\nat_m = [1, 1]\n"
        "[[furniture]]\nkind = 'box'\nname = 'b'\nat_m = [4, 4]\n"
        "[[people]]\nstart_m = [0.3, 1]\nsteps = [{ go = [[3, 1]], push = 'c', speed_mps = 1.0 }, { stand_s = 1 },"
        " { go = [[3, 3]], carry = 'b', put_z_m = 0.7 }, { go = [[1, 3]] }]\n"
    )
    cast = Cast(parse_scene(text, "p"), Palette())
    chair, box = (a.mesh.vertices for a in cast.at(20.0)[1:])
    assert chair.mean(axis=0)[:2] == pytest.approx([3.72, 1.0], abs=0.15)
    assert box[:, 2].min() == pytest.approx(0.7, abs=0.01)
