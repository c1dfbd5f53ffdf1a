"""Scenes and their rigs, rendered."""

from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.world import load_rigs
from planview.synthetic import assets
from planview.synthetic.motion import scripted_motion, step_length_m
from planview.synthetic.people import Body, Cast, Pose, pose_at
from planview.synthetic.render import SceneRenderer, SensorModel
from planview.synthetic.scene import Furniture, ImageSensor, ScenePerson, Walk, load_scene, parse_scene
from planview.synthetic.texture import Palette, fractal_noise
from planview.synthetic.write import load_rig_scenes, write_rigs
from planview.trajectories.table import read_truth
from tests.reference.noise import fractal_noise as plain_noise

COMMITTED = sorted(assets.SCENES.rglob("*.toml"))
OTHERS = {"demo", "rigs"}
SCENES = [p for p in COMMITTED if p.parent.name not in OTHERS and not p.name.endswith(".rules.toml")]
RIG = "[rig]\nat_m = [3, 0.3, 2.5]\n"


@pytest.mark.parametrize(
    ("text", "expected"),
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
def test_scene_that_cannot_be_is_refused_in_one_sentence_naming_the_key(text, expected):
    with pytest.raises(InputError) as refusal:
        parse_scene(text, "x.toml")
    assert str(refusal.value).startswith("x.toml: ")
    assert expected in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_nobody_of_a_committed_scene_walks_through_anybody(path):
    scene = load_scene(path)
    steps = [step for person in scene.people for step in person.steps]
    fastest_mps = max((step.speed_mps for step in steps if isinstance(step, Walk)), default=0.0)
    motions = Cast(scene, Palette()).motions
    times = np.arange(0, scene.duration_s, 0.3)
    place = np.array([[m.at(t)[0] if m.exists(t) else [np.nan] * 2 for t in times] for m in motions])
    for i in range(len(motions)):
        speed = np.linalg.norm(np.diff(place[i], axis=0), axis=1) / 0.3
        assert np.nanmax(speed) < max(1.7, 1.1 * fastest_mps)
        for j in range(i):
            gap = np.linalg.norm(place[i] - place[j], axis=1)
            assert not (gap < 0.38).any(), (i + 1, j + 1)


TALL = Body(ScenePerson(height_m=1.80, start_m=(0, 0)), Palette())


def test_standing_body_is_exactly_as_tall_as_asked():
    body = TALL.pose(Pose(), 2.0, -1.0, 0.7)
    assert body.top_m == pytest.approx(1.80, abs=1e-5)
    assert body.head[:2] == pytest.approx([2.0, -1.0], abs=0.01)
    assert body.mesh.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_sitting_lowers_the_head_by_the_thigh():
    sitting = TALL.pose(Pose(hip=(np.pi / 2, np.pi / 2), knee=(np.pi / 2, np.pi / 2)), 0, 0, 0)
    assert 1.80 - sitting.top_m == pytest.approx(0.245 * 1.80, abs=0.03)


def test_flexed_hip_swings_forward():
    raised = TALL.pose(Pose(hip=(1.4, 0.0), knee=(0.2, 0.0)), 0, 0, np.pi / 2)
    assert raised.mesh.vertices[:, 1].max() > 0.6  # the raised leg points along +y
    assert raised.mesh.vertices[:, 1].min() > -0.25


def test_body_faces_its_heading():
    assert TALL.pose(Pose(lean=1.0), 0, 0, np.pi / 2).chest == pytest.approx([0, np.cos(1.0), -np.sin(1.0)])


def walker(*steps, **values):
    return ScenePerson.model_validate({"start_m": (0, 0), "steps": steps, **values})


def test_walk_covers_its_way_at_its_speed_one_step_per_half_turn_of_its_phase():
    motion = scripted_motion(walker({"go": [(12, 0)], "speed_mps": 1.2}, height_m=1.75), {}, 12)
    xy, heading, _, speed, _ = motion.at(2.5)
    assert xy == pytest.approx([3.0, 0.0], abs=0.02)
    assert (heading, speed) == pytest.approx((0.0, 1.2), abs=0.01)
    turned = motion.at(8)[2] - motion.at(3)[2]
    step = step_length_m(1.75, np.array([1.2]))[0]
    assert turned / np.pi == pytest.approx(5 * 1.2 / step, rel=0.01)


def test_whoever_walks_backwards_does_not_turn():
    backs = walker({"go": [(2, 0)], "face_deg": 180}, face_deg=180)
    assert scripted_motion(backs, {}, 5).heading == pytest.approx(np.pi)


def test_planted_foot_does_not_slide():
    person = walker({"go": [(12, 0)], "speed_mps": 1.2}, height_m=1.75)
    motion, body = scripted_motion(person, {}, 12), Body(person, Palette())
    slid = []
    for t in np.arange(4.0, 5.0, 1 / 15):
        now, then = (body.pose(*pose_at(0, 1.75, motion, u)).mesh.vertices for u in (t, t + 1 / 15))
        slid.append(np.linalg.norm((then - now)[now[:, 2] < 0.012], axis=1).min(initial=1.0))
    assert np.median(slid) < 0.04  # the body moves 8 cm per frame


def test_low_seats_lower_the_head_more_than_a_chair():
    seats = {n: Furniture(kind=k, name=n, at_m=(2, 0), size_m=s) for n, k, s in
             (("low", "bench", (0.45, 0.5, 0.33)), ("chair", "chair", None))}  # fmt: skip

    def top_m(t, **step):
        person = walker(step, height_m=1.75)
        motion = scripted_motion(person, seats, 12)
        return Body(person, Palette()).pose(*pose_at(0, 1.75, motion, t)).top_m

    assert 0.8 < top_m(2.0, crouch_s=4) < 1.25
    assert 0.9 < top_m(9.0, sit_s=9, on="low") < top_m(9.0, sit_s=9, on="chair") - 0.1 < 1.3


def test_person_exists_from_entering_until_leaving():
    motion = scripted_motion(walker({"go": [(1, 0)], "speed_mps": 1.0}, enter_s=3, leaves=True), {}, 20)
    assert [motion.exists(t) for t in (2.9, 3.0, 3.9, 4.5)] == [False, True, True, False]


WANDERERS = RIG + "".join(
    f"[[people]]\nstart_m = [{x}, {y}]\nwander = {{ area_m = [0.5, 1, 5.5, 4.5] }}\n"
    for x in (1, 3, 5)
    for y in (1.5, 4)
)


def test_wanderers_keep_apart_on_walks_of_their_seed():
    scene = parse_scene("duration_s = 8\n" + WANDERERS, "w")
    once, again, other = (
        np.array([m.at(8)[0] for m in Cast(scene.model_copy(update={"seed": seed}), Palette()).motions])
        for seed in (1, 1, 9)
    )
    gaps = np.linalg.norm(once[:, None] - once, axis=2) + 10 * np.eye(6)
    assert gaps.min() > 0.45
    assert (once == again).all()
    assert not np.allclose(once, other, atol=0.3)


def test_things_stay_where_they_were_put():
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


ROOM = "fps = 10\nduration_s = 1\n[room]\nsize_m = [8, 8, 4]\n[lights]\nlamps = [{ at_m = [4, 5, 3.9] }]\n"
RIGS = "width = 80\nheight = 60\nfocal_px = 55\ntilt_deg = 65\n"
PERSON = "[[people]]\nstart_m = [4, 4]\nface_deg = -90\nheight_m = 1.7\nsteps = [{ go = [[5, 4]] }]\n"
MOUNTS = (
    f'[[mount]]\nname = "south"\n[mount.rig]\nat_m = [4, 1, 2.4]\n{RIGS}'
    f'[[mount]]\nname = "west"\nstart_s = 0.3\n[mount.rig]\nat_m = [1, 4, 2.6]\nheading_deg = 0\n{RIGS}'
)


@pytest.fixture
def scene(tmp_path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(ROOM + PERSON + MOUNTS)
    return path


def test_sensors_record_the_same_person_on_their_own_clocks(scene, tmp_path):
    write_rigs(load_rig_scenes(scene), tmp_path / "out")
    south, west = load_rigs(tmp_path / "out" / "rigs.toml")
    assert (south.start_s, west.start_s) == (0.0, 0.3)
    assert west.world_SE3_left.translation == pytest.approx([-3.0, 3.0, 2.6], abs=1e-6)
    a, b = (read_truth(tmp_path / "out" / name / "truth.csv") for name in ("south", "west"))
    assert (len(a), len(b)) == (10, 7)
    # West looks along the room's x axis: its x axis is the room's -y.
    in_common = np.column_stack([b.y_m - 3.0, 3.0 - b.x_m])
    np.testing.assert_allclose(in_common, np.column_stack([a.x_m, a.y_m])[3:], atol=2e-4)


def test_committed_room_has_two_sensors():
    sensors = load_rig_scenes(assets.SCENES / "rigs" / "two.toml")
    assert [sensor.mount.name for sensor in sensors] == ["a", "b"]
    assert len(sensors[0].scene.people) >= 2


def test_sensor_of_several_records_what_a_single_rig_does(scene):
    sensor = load_rig_scenes(scene)[0]
    assert (sensor.renderer().frame(4).left == SceneRenderer(sensor.scene).frame(4).left).all()


def test_synth_renders_sensors_but_not_two_of_one_name(scene, tmp_path, json_of):
    assert json_of("synth", scene, tmp_path / "out", "--frames", 2, "--jpeg")["frames"] == 4
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["rigs.toml", "south", "west"]
    scene.write_text(scene.read_text().replace("west", "south"))
    with pytest.raises(InputError, match="name of their own"):
        load_rig_scenes(scene)


CAMERAS = "[rig]\nwidth = 160\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
STANDING = "[[people]]\nstart_m = [4, 4]\nface_deg = -90\nheight_m = 1.7\n"


def renderer(text):
    return SceneRenderer(parse_scene(text, "test"))


@pytest.fixture(scope="module")
def standing():
    """A person 3 m in front of a distorted, converging pair."""
    rig = CAMERAS + "distortion = [-0.15, 0.05, 0.001, -0.001, 0.0]\nright_rotation_deg = [0.5, -1, 0.4]\n"
    return renderer(ROOM + rig + STANDING)


def test_noise_kernel_equals_its_plain_twin():
    rng = np.random.default_rng(1)
    points = rng.uniform(-5, 5, (500, 3)).astype(np.float32)
    points[:8] = np.round(points[:8])
    footprint = rng.uniform(0, 0.2, 500).astype(np.float32)
    wavelength = rng.uniform(0.05, 1, 500).astype(np.float32)
    ours = fractal_noise(points, footprint, wavelength, 4, 77)
    assert ours == pytest.approx(plain_noise(points, footprint, wavelength, 4, 77), abs=2e-4)


def test_same_scene_gives_same_pixels_in_any_order(standing):
    first = standing.frame(7)
    again = SceneRenderer(standing.scene)
    again.frame(3)
    assert (again.frame(7).left == first.left).all()
    assert (again.frame(7).right == first.right).all()


def test_other_seed_gives_other_pixels(standing):
    other = SceneRenderer(standing.scene.model_copy(update={"seed": 5})).frame(7)
    assert (other.left != standing.frame(7).left).any()


def test_truth_is_the_place_relative_to_the_camera(standing):
    (row,) = standing.frame(5).truth
    assert (row.x_m, row.y_m) == pytest.approx((0.0, 3.0), abs=0.06)  # people shift their weight
    assert row.height_m == pytest.approx(1.70, abs=0.01)
    assert row.visible == 1.0
    assert row.facing_deg == pytest.approx(-90, abs=8)  # they turn a little, too


def test_head_of_the_truth_projects_onto_the_person_in_both_images(standing):
    frame = standing.frame(5)
    (row,) = frame.truth
    world_SE3_rect, rig = standing.world_SE3_left, standing.rig
    room = standing.world_SE3_room.inverse() @ np.array([row.x_m, row.y_m, row.height_m - 0.11])
    left = standing.room_SE3_left.inverse() @ room
    u, v = np.round(rig.left.project(left)[0]).astype(int)
    assert frame.owner[v, u] == 1
    assert frame.depth[v, u] == pytest.approx(left[2], abs=0.15)
    empty = SceneRenderer(standing.scene.model_copy(update={"people": ()})).frame(5)
    u, v = np.round(rig.right.project(rig.right_SE3_left @ left)[0]).astype(int)
    changed = np.abs(frame.right.astype(int) - empty.right).sum(axis=2)
    assert changed[v, u] > 60
    assert world_SE3_rect.translation == pytest.approx([0, 0, 2.4])


def test_floor_depth_of_a_camera_straight_down_is_its_height():
    rig = "[rig]\nwidth = 64\nheight = 48\nfocal_px = 60\nat_m = [4, 4, 3]\ntilt_deg = 0\n"
    down = renderer(ROOM + rig + "distortion = [-0.1, 0, 0, 0]\n")
    frame = down.frame(0)
    assert frame.depth == pytest.approx(np.full((48, 64), 3.0), abs=1e-4)
    assert frame.truth == ()
    assert down.world_SE3_left.rotation[2] == pytest.approx([0, 0, -1], abs=1e-9)


def test_hidden_part_is_counted_by_pixels_of_the_person_alone():
    screen = "[[furniture]]\nkind = 'partition'\nat_m = [4, 3]\nheading_deg = 90\n"
    free, hidden = renderer(ROOM + CAMERAS + STANDING).frame(2), renderer(ROOM + CAMERAS + STANDING + screen).frame(2)
    shown = (hidden.owner == 1).sum() / (free.owner == 1).sum()
    assert 0.2 < shown < 0.8
    assert hidden.truth[0].visible == pytest.approx(shown, abs=1e-6)


def test_part_outside_the_image_counts_as_not_visible():
    narrow, wide = (
        renderer(ROOM + f"[camera]\nwidth = {w}\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
                 + STANDING.replace("[4, 4]", "[4.45, 4]")).frame(2)
        for w in (32, 160)
    )  # fmt: skip
    inside = (narrow.owner == 1).sum() / (wide.owner == 1).sum()
    assert 0.2 < inside < 0.8
    assert narrow.truth[0].visible == pytest.approx(inside, abs=0.05)
    assert wide.truth[0].visible == 1.0


def test_single_camera_boxes_hold_what_shows():
    camera = "[camera]\nwidth = 160\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
    screen = "[[furniture]]\nkind = 'partition'\nat_m = [4, 3]\nheading_deg = 90\n"
    scene = renderer(ROOM + camera + STANDING + screen)
    frame = scene.frame(2)
    (row,) = frame.truth
    rows, cols = np.nonzero(frame.owner == 1)
    left, top, width, height = row.box_px
    assert (left, top) == (cols.min(), rows.min())
    assert (width, height) == (np.ptp(cols) + 1, np.ptp(rows) + 1)
    assert row.full_box_px[:2] == (left, top)
    assert row.full_box_px[3] > 1.3 * height
    head = scene.ground_camera.project([row.x_m, row.y_m, row.height_m])
    assert head == pytest.approx([left + width / 2, top], abs=4)


def test_shadow_darkens_the_floor_away_from_the_lamp_only():
    lamp = ROOM.replace("[4, 5, 3.9]", "[4, 2.0, 3.5]").replace("[lights]", "[lights]\nambient = 0.08")
    rig = "[rig]\nwidth = 160\nheight = 120\nfocal_px = 60\nat_m = [4, 4, 3.9]\ntilt_deg = 0\n"
    down = "[sensor]\nvignetting = 0\n" + rig
    person, empty_room = renderer(lamp + down + STANDING), renderer(lamp + down)
    frame, empty = person.frame(0), empty_room.frame(0)
    floor = frame.owner == 0
    ratio = frame.left.astype(float).sum(axis=2) / empty.left.astype(float).sum(axis=2)
    # The top of the image looks along +y, away from the lamp behind the person: 0.6 to 1.2 m behind it.
    assert np.median(ratio[40:50, 76:84][floor[40:50, 76:84]]) < 0.85
    assert np.median(ratio[72:110, 40:120][floor[72:110, 40:120]]) == pytest.approx(1.0, abs=0.03)


def test_right_image_is_the_left_shifted_by_the_disparity_of_a_flat_floor():
    rig = "[rig]\nwidth = 160\nheight = 120\nfocal_px = 150\nat_m = [4, 4, 3]\ntilt_deg = 0\nbaseline_m = 0.2\n"
    sensor = "[sensor]\nmismatch = 0\nread_noise_e = 0\nfull_well_e = 1e6\nvignetting = 0\n"
    frame = renderer(ROOM + sensor + rig).frame(0)
    # focal * baseline / depth = 150 * 0.2 / 3 = 10 px.
    difference = np.abs(frame.left[:, 10:].astype(int) - frame.right[:, :-10])
    assert np.median(difference) <= 1
    assert np.abs(frame.left[:, 8:].astype(int) - frame.right[:, :-8]).mean() > 2 * difference.mean()


def test_sensor_noise_follows_the_signal():
    flat = np.full((200, 200, 3), 0.25, np.float32)
    sensor = ImageSensor(full_well_e=4000, read_noise_e=0, vignetting=0, blur_px=0, exposure=((1.0, 1.0), (1.1, 2.0)))
    model = SensorModel(sensor, (200, 200), 1.0, (3, 0))
    before, after = model(flat, 0, 0.0), model(flat, 1, 2.0)
    assert before.mean() == pytest.approx(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055), abs=1.0)
    assert after.mean() == pytest.approx(255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055), abs=1.0)
    # sqrt(0.25 * 4000) = 31.6 electrons of 4000, through a slope of the curve of 255 * 0.44 * 0.25 ** (1/2.4 - 1).
    assert before.std() == pytest.approx(0.0079 * 255 * 0.44 * 0.25 ** (1 / 2.4 - 1), rel=0.1)


def test_half_scale_gives_the_same_truth():
    text = ROOM + "[sensor]\ngrey = true\n" + CAMERAS + STANDING
    whole, half = renderer(text), SceneRenderer(parse_scene(text, "t"), 0.5)
    assert whole.frame(0).left.shape == (120, 160)
    assert half.frame(0).left.shape == (60, 80)
    assert half.rig.left.fx == pytest.approx(55)
    ours, theirs = whole.frame(4).truth[0], half.frame(4).truth[0]
    assert (ours.x_m, ours.y_m, ours.height_m) == (theirs.x_m, theirs.y_m, theirs.height_m)
