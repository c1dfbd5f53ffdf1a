"""Rendered pixels, depth and truth against numbers known by hand."""

import numpy as np
import pytest

from planview.synthetic._kernels import fractal_noise
from planview.synthetic.render import SceneRenderer, SensorModel
from planview.synthetic.scene import Sensor, parse_scene
from tests.reference.noise import fractal_noise as plain_noise

ROOM = "fps = 10\nduration_s = 1\n[room]\nsize_m = [8, 8, 4]\n[lights]\nlamps = [{ at_m = [4, 5, 3.9] }]\n"
RIG = "[rig]\nwidth = 160\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
PERSON = "[[people]]\nstart_m = [4, 4]\nface_deg = -90\nheight_m = 1.7\n"


def renderer(text):
    return SceneRenderer(parse_scene(text, "test"))


@pytest.fixture(scope="module")
def standing():
    """A person 3 m in front of a distorted, converging pair."""
    rig = RIG + "distortion = [-0.15, 0.05, 0.001, -0.001, 0.0]\nright_rotation_deg = [0.5, -1, 0.4]\n"
    return renderer(ROOM + rig + PERSON)


def test_noise_kernel_equals_its_plain_twin():
    rng = np.random.default_rng(1)
    points = rng.uniform(-5, 5, (500, 3)).astype(np.float32)
    points[:8] = np.round(points[:8])
    footprint = rng.uniform(0, 0.2, 500).astype(np.float32)
    wavelength = rng.uniform(0.05, 1, 500).astype(np.float32)
    ours = fractal_noise(points, footprint, wavelength, 4, 77)
    assert ours == pytest.approx(plain_noise(points, footprint, wavelength, 4, 77), abs=2e-4)


def test_same_scene_gives_same_pixels_in_any_order_and_other_seed_gives_others(standing):
    first = standing.frame(7)
    again = SceneRenderer(standing.scene)
    again.frame(3)
    assert (again.frame(7).left == first.left).all() and (again.frame(7).right == first.right).all()
    other = SceneRenderer(standing.scene.model_copy(update={"seed": 5})).frame(7)
    assert (other.left != first.left).any()


def test_truth_is_the_place_relative_to_the_camera(standing):
    (row,) = standing.frame(5).truth
    assert (row.x_m, row.y_m) == pytest.approx((0.0, 3.0), abs=0.06)  # people shift their weight
    assert row.height_m == pytest.approx(1.70, abs=0.01)
    assert row.visible == 1.0


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
    rig = (
        "[rig]\nwidth = 64\nheight = 48\nfocal_px = 60\nat_m = [4, 4, 3]\ntilt_deg = 0\ndistortion = [-0.1, 0, 0, 0]\n"
    )
    down = renderer(ROOM + rig)
    frame = down.frame(0)
    assert frame.depth == pytest.approx(np.full((48, 64), 3.0), abs=1e-4)
    assert frame.truth == ()
    assert down.world_SE3_left.rotation[2] == pytest.approx([0, 0, -1], abs=1e-9)


def test_hidden_part_is_counted_by_pixels_of_the_person_alone():
    screen = "[[furniture]]\nkind = 'partition'\nat_m = [4, 3]\nheading_deg = 90\n"
    free, hidden = renderer(ROOM + RIG + PERSON).frame(2), renderer(ROOM + RIG + PERSON + screen).frame(2)
    shown = (hidden.owner == 1).sum() / (free.owner == 1).sum()
    assert 0.2 < shown < 0.8
    assert hidden.truth[0].visible == pytest.approx(shown, abs=1e-6)


def test_part_outside_the_image_counts_as_not_visible():
    narrow, wide = (
        renderer(ROOM + f"[camera]\nwidth = {w}\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
                 + PERSON.replace("[4, 4]", "[4.45, 4]")).frame(2)
        for w in (32, 160)
    )  # fmt: skip
    inside = (narrow.owner == 1).sum() / (wide.owner == 1).sum()
    assert 0.2 < inside < 0.8
    assert narrow.truth[0].visible == pytest.approx(inside, abs=0.05)
    assert wide.truth[0].visible == 1.0


def test_single_camera_boxes_hold_what_shows_and_the_whole():
    camera = "[camera]\nwidth = 160\nheight = 120\nfocal_px = 110\nat_m = [4, 1, 2.4]\ntilt_deg = 65\n"
    screen = "[[furniture]]\nkind = 'partition'\nat_m = [4, 3]\nheading_deg = 90\n"
    scene = renderer(ROOM + camera + PERSON + screen)
    frame = scene.frame(2)
    (row,) = frame.truth
    rows, cols = np.nonzero(frame.owner == 1)
    left, top, width, height = row.box_px
    assert (left, top) == (cols.min(), rows.min())
    assert (width, height) == (np.ptp(cols) + 1, np.ptp(rows) + 1)
    assert row.full_box_px[:2] == (left, top) and row.full_box_px[3] > 1.3 * height
    head = scene.ground_camera.project([row.x_m, row.y_m, row.height_m])
    assert head == pytest.approx([left + width / 2, top], abs=4)


def test_shadow_darkens_the_floor_away_from_the_lamp_only():
    lamp = ROOM.replace("[4, 5, 3.9]", "[4, 2.0, 3.5]").replace("[lights]", "[lights]\nambient = 0.08")
    down = (
        "[sensor]\nvignetting = 0\n[rig]\nwidth = 160\nheight = 120\nfocal_px = 60\nat_m = [4, 4, 3.9]\ntilt_deg = 0\n"
    )
    person, empty_room = renderer(lamp + down + PERSON), renderer(lamp + down)
    frame, empty = person.frame(0), empty_room.frame(0)
    floor = frame.owner == 0
    ratio = frame.left.astype(float).sum(axis=2) / empty.left.astype(float).sum(axis=2)
    # The top of the image looks along +y, away from the lamp behind the person: 0.6 to 1.2 m behind it.
    assert np.median(ratio[40:50, 76:84][floor[40:50, 76:84]]) < 0.85
    assert np.median(ratio[72:110, 40:120][floor[72:110, 40:120]]) == pytest.approx(1.0, abs=0.03)


def test_right_image_is_the_left_shifted_by_the_disparity_of_a_flat_floor():
    rig = "[rig]\nwidth = 160\nheight = 120\nfocal_px = 150\nat_m = [4, 4, 3]\ntilt_deg = 0\nbaseline_m = 0.2\n"
    frame = renderer(
        ROOM + "[sensor]\nmismatch = 0\nread_noise_e = 0\nfull_well_e = 1e6\nvignetting = 0\n" + rig
    ).frame(0)
    # focal * baseline / depth = 150 * 0.2 / 3 = 10 px.
    difference = np.abs(frame.left[:, 10:].astype(int) - frame.right[:, :-10])
    assert np.median(difference) <= 1
    assert np.abs(frame.left[:, 8:].astype(int) - frame.right[:, :-8]).mean() > 2 * difference.mean()


def test_sensor_noise_and_exposure_follow_the_signal():
    flat = np.full((200, 200, 3), 0.25, np.float32)
    sensor = Sensor(full_well_e=4000, read_noise_e=0, vignetting=0, blur_px=0, exposure=((1.0, 1.0), (1.1, 2.0)))
    model = SensorModel(sensor, (200, 200), 1.0, (3, 0))
    before, after = model(flat, 0, 0.0), model(flat, 1, 2.0)
    assert before.mean() == pytest.approx(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055), abs=1.0)
    assert after.mean() == pytest.approx(255 * (1.055 * 0.5 ** (1 / 2.4) - 0.055), abs=1.0)
    # sqrt(0.25 * 4000) = 31.6 electrons of 4000, through a slope of the curve of 255 * 0.44 * 0.25 ** (1/2.4 - 1).
    assert before.std() == pytest.approx(0.0079 * 255 * 0.44 * 0.25 ** (1 / 2.4 - 1), rel=0.1)


def test_grey_sensor_gives_one_channel_and_half_scale_the_same_truth():
    text = ROOM + "[sensor]\ngrey = true\n" + RIG + PERSON
    whole, half = renderer(text), SceneRenderer(parse_scene(text, "t"), 0.5)
    assert whole.frame(0).left.shape == (120, 160)
    assert half.frame(0).left.shape == (60, 80)
    assert half.rig.left.fx == pytest.approx(55)
    ours, theirs = whole.frame(4).truth[0], half.frame(4).truth[0]
    assert (ours.x_m, ours.y_m, ours.height_m) == (theirs.x_m, theirs.y_m, theirs.height_m)
