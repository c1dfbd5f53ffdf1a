"""Plan-view maps: built, recorded, of several rigs."""

import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from full_disk import report_free_mb
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_maps import write_toy_maps

from calib.errors import InputError, WorkError
from calib.pose import SE3
from calib.rig import world_from_plane
from planview.engine.open import open_engine
from planview.foreground.gain import Exposure
from planview.maps.grid import Grid, MapParams
from planview.maps.plan_view import FloorPoints, PlanViewMaps, accumulate, joint_grid, plan_view
from planview.maps.recording import BLOCK_FRAMES, MapsRecording, MapsWriter, RecordedPoints
from planview.maps.view import CODES, ViewBuilder, back_project, colour_codes, encode_colours, smoothing
from stereo.depth import RectifiedGeometry
from stereo.depth import back_project as to_points
from stereo.recording import Frame, Skipped
from tests.reference import maps as reference

GEOMETRY = RectifiedGeometry(64, 48, 50.0, 50.0, 31.5, 23.5, 0.1)
OVERHEAD = world_from_plane(np.array([0.0, 0.0, -1.0]), 3.0)


def maps_of(depth_m, rows=np.s_[20:28], columns=np.s_[28:36], step=1, **params):
    """Of a block of pixels that show something so far below a camera 3 m above the floor."""
    disparity, mask = np.full((48, 64), GEOMETRY.disparity_at(depth_m), np.float32), np.zeros((48, 64), np.uint8)
    mask[rows, columns] = 255
    disparity[:, 50:] = np.nan
    exact = MapParams.model_validate({"smoothing_m": 0.0, "occupancy_min": 0.0} | params)
    return ViewBuilder(GEOMETRY, OVERHEAD, exact, step)(disparity[::step, ::step], mask[::step, ::step])


def test_a_template_is_the_maps_around_a_place():
    maps = maps_of(2.0)
    height, occupancy = maps.around(0.0, 0.0)
    assert height.shape == occupancy.shape == (21, 21)
    assert height[10, 10] == pytest.approx(1.0, abs=1e-5)
    assert occupancy.sum() == pytest.approx(maps.occupancy.sum())
    assert (maps.around(maps.grid.x_max_m + 1, 0.0)[0] == 0).all()


@pytest.mark.parametrize(("depth_m", "step"), [(1.0, 1), (2.0, 1), (2.0, 2)])
def test_table_below_an_overhead_camera_has_its_size_at_any_distance(depth_m, step):
    maps = maps_of(depth_m, np.s_[10:30], np.s_[20:40], step)
    assert maps.height_raw.max() == pytest.approx(3.0 - depth_m, abs=1e-5)
    # 20 x 20 pixels, each depth / 50 wide.
    assert maps.occupancy_raw.sum() == pytest.approx((20 * depth_m / 50) ** 2, rel=1e-4)


@pytest.mark.parametrize("step", [1, 2, 3])
def test_points_for_a_cloud_are_the_points_that_are_tracked(step):
    builder, tilted = ViewBuilder(GEOMETRY, OVERHEAD, reduction=step), np.linspace(1.8, 4.0, 64 * 48, dtype=np.float32)
    disparity = tilted.reshape(48, 64)[: builder.shape[0], : builder.shape[1]]
    seen = builder.points(disparity, np.full(builder.shape, 255, np.uint8))
    cloud = OVERHEAD @ to_points(GEOMETRY.depth(disparity), GEOMETRY, step).reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(seen.xyz, cloud[seen.pixels], atol=1e-5)


def test_maps_skip_the_background():
    assert len(maps_of(2.0, np.s_[:24], np.s_[:]).points.xyz) == 24 * 50


@pytest.mark.parametrize("depth_m", [0.4, 2.95], ids=["above h_max", "on the ground"])
def test_maps_skip_what_is_too_high_or_too_low(depth_m):
    assert maps_of(depth_m).height_raw.max() == 0.0


def test_height_is_masked_where_occupancy_is_low():
    lone = maps_of(2.0, np.s_[20:21], np.s_[30:31], smoothing_m=0.04, occupancy_min=2.0)
    assert lone.height_raw.max() > 0.9
    assert lone.height.max() == 0.0


def test_images_of_another_size_are_refused():
    builder, mask = ViewBuilder(GEOMETRY, OVERHEAD), np.zeros((48, 64), np.uint8)
    for disparity, image in (((47, 64), (48, 64)), ((48, 64), (47, 64, 3))):
        with pytest.raises(ValueError, match="disparity, mask"):
            builder(np.zeros(disparity, np.float32), mask, np.zeros(image, np.uint8))


def test_hall_of_too_many_cells_is_refused():
    with pytest.raises(ValueError, match="at most"):
        Grid.covering(0.0, 0.0, 1000.0, 1000.0, 0.03)


def test_grid_cell_owns_its_lower_edge():
    grid = Grid.covering(0.0, 0.0, 1.0, 0.5, 0.1)
    assert grid.shape == (5, 10)
    assert grid.centre_of(0, 0) == pytest.approx((0.05, 0.05))
    assert grid.index_of(0.05, 0.05) == pytest.approx((0.0, 0.0))
    point = np.array([[0.5, 0.25, 1.0]], np.float32)
    assert accumulate(point, np.ones(1, np.float32), 0.0, (0.0, 0.0, 0.25), grid.shape)[0][1, 2] == 1.0


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_map_kernels_equal_their_reference(seed):
    rng = np.random.default_rng(seed)
    disparity = rng.uniform(-1, 30, (12, 16)).astype(np.float32)
    disparity[rng.random((12, 16)) < 0.2] = np.nan
    mask = (rng.random((12, 16)) < 0.7).astype(np.uint8)
    pose = SE3.from_rotvec(rng.normal(size=3), rng.normal(size=3)).matrix[:3]
    camera = np.array([20.0, 22.0, 7.5, 5.5, 10.0])
    results = []
    for project, add_up in ((back_project, accumulate), (reference.back_project, reference.accumulate)):
        points, area, pixels = project(disparity, mask, camera, pose, (0.5, 2.4))
        results.append((points, area, pixels, *add_up(points, area, 0.15, (-1.0, -2.0, 0.5), (9, 11))))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6)


GRID = Grid(-2.0, -2.0, 0.04, 100, 100)


def side(x: float, y: float, area_m2: float = 0.5) -> FloorPoints:
    """What shows of a body: an upright surface over a line of cells."""
    xyz = np.column_stack([np.linspace(x - 0.2, x + 0.2, 400), np.full(400, y), np.linspace(0.2, 1.7, 400)])
    return FloorPoints(xyz.astype(np.float32), np.full(400, area_m2 / 400, np.float32), np.arange(400, dtype=np.int32))


def joined(*sensors: FloorPoints) -> PlanViewMaps:
    return plan_view(sensors, joint_grid([GRID, GRID]), MapParams(smoothing_m=0.0))


def test_surface_that_one_sensor_sees_counts_whole():
    alone, far_away = side(0.3, -0.1), side(1.9, 1.9)
    np.testing.assert_array_equal(joined(alone).points.area, alone.area)
    np.testing.assert_array_equal(joined(alone, far_away).points.area[:400], alone.area)


def test_heights_are_the_highest_of_all_sensors():
    alone, low = side(0.3, -0.1), side(0.3, -0.1)
    low.xyz[:, 2] *= 0.5
    assert joined(low, alone).height_raw.max() == pytest.approx(1.7, abs=1e-6)


@pytest.mark.parametrize(
    ("sensors", "area_m2"),
    [
        ([side(0.3, -0.1)], 0.5),
        ([side(0.0, -0.12), side(0.0, 0.12, 0.25)], 0.5),
        ([side(-1.0, 0.0), side(1.0, 0.0)], 1.0),
        ([side(0.0, -0.12), side(0.0, 0.12, 0.005)], 0.5),
    ],
    ids=["one sensor", "two sides of a body: that which shows most", "two bodies", "nearly hidden from a sensor"],
)
def test_surface_of_a_body_is_what_the_best_sensor_sees(sensors, area_m2):
    occupancy = joined(*sensors).occupancy_raw
    assert occupancy.sum() == pytest.approx(area_m2, rel=0.01)


def test_maps_do_not_depend_on_the_order_of_the_sensors():
    sensors = side(0.0, -0.12), side(0.0, 0.12, 0.25), side(1.0, 1.0)
    one, other = joined(*sensors), joined(*sensors[::-1])
    np.testing.assert_array_equal(one.height_raw, other.height_raw)
    np.testing.assert_allclose(one.occupancy, other.occupancy, rtol=1e-5)


FIELDS = (
    *(("rig", name) for name in ("width", "height", "focal_u_px", "cu_px", "baseline_m", "reduction", "count")),
    *(("grid", name) for name in ("x_min_m", "cell_m", "n_rows")),
    ("", "fps"),
)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    return write_toy_maps(tmp_path_factory.mktemp("maps") / "maps.h5")


@pytest.fixture
def maps(good, tmp_path) -> Path:
    return Path(shutil.copy(good, tmp_path / "maps.h5"))


def track(path: Path) -> int:
    return sum(1 for _ in open_engine(path))


def test_frames_are_read_as_they_were_written(maps):
    recording = MapsRecording(maps)
    first, second, *_ = frames = list(recording)
    assert [f.index for f in frames][5:9] == [5, 6, 8, 9]
    assert recording.n_frames == track(maps) == 39
    assert recording.skipped == [Skipped(7, "left: file is missing")]
    assert recording.fps == 15.0
    points = first.shots[0]
    assert len(points.unmatched) >= 9
    assert len(points.pixels) == len(points.disparities)
    assert points.background is not None
    assert second.shots[0].background is None


def test_a_frame_that_shows_nothing_is_replayed_as_one(maps, tmp_path):
    recording, path = MapsRecording(maps), tmp_path / "with.h5"
    frame, every = next(iter(recording)), np.arange(np.prod(recording.sensor.rig.shape), dtype=np.int32)
    writer = MapsWriter(path, recording.sensor, 15.0)
    writer.add(frame)
    writer.add(Frame(1, 0.1, (RecordedPoints(every[:0], np.zeros(0, np.float32), None, every),)))
    writer.close()
    before, nothing = open_engine(path)
    assert before.views[0].shows
    assert not nothing.views[0].shows


def test_writing_stops_before_the_disk_is_full(maps, tmp_path, monkeypatch):
    recording, path = MapsRecording(maps), tmp_path / "less.h5"
    report_free_mb(monkeypatch, 200, 200, 10, 10)
    writer, first = MapsWriter(path, recording.sensor, 15.0), next(iter(recording))
    frame = replace(first, shots=(replace(first.shots[0], background=None),))
    for i in range(2 * BLOCK_FRAMES - 1):
        writer.add(replace(frame, index=i, timestamp_s=i / 15))
    with pytest.raises(WorkError, match="64 MB of free disk"):
        writer.add(replace(frame, index=2 * BLOCK_FRAMES, timestamp_s=10.0))
    writer.close()
    assert MapsRecording(path).n_frames == BLOCK_FRAMES


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e9, 1e9, "text", [1.0, 2.0]])
@pytest.mark.parametrize(("group", "name"), FIELDS)
def test_number_that_no_rig_has_is_refused_by_its_name(maps, group, name, value):
    with h5py.File(maps, "r+") as file:
        (file[group] if group else file).attrs[name] = value
    with pytest.raises(InputError, match=r"maps\.h5: expected plan-view maps.*, found ") as refused:
        MapsRecording(maps)
    assert isinstance(value, str | list) or name in str(refused.value)


def longer(file: Any) -> None:
    for column in file["frames"].values():
        column.resize(5 * 10**8, axis=0)


def other(name: str, values: object) -> Callable[[Any], None]:
    """The dataset holds something else."""

    def damage(file):
        del file[name]
        file[name] = values

    return damage


def at(name: str, place: int, value: float) -> Callable[[Any], None]:
    return lambda file: file[name].__setitem__(place, value)


def pose(place: tuple[int, int], value: float) -> Callable[[Any], None]:
    def damage(file):
        matrix = file["floor"].attrs["world_SE3_left"]
        matrix[place] = value
        file["floor"].attrs["world_SE3_left"] = matrix

    return damage


UP = np.eye(4)
"""Looks at the sky."""
UP[2, 3] = 2.5


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda file: file.attrs.update(version=99), "of version 2, found version 99"),
        (lambda file: file.attrs.update(version=1), "of version 2, found version 1: track the recording again"),
        (lambda file: file.attrs.update(config='{"telepathy": {}}'), "another version"),
        (lambda file: file["rig"].attrs.update(focal_u_px=1e4), "another rig"),
        (lambda file: file["points/appearance"].attrs.update(codes=7), "another version"),
        (lambda file: file["points/disparity"].resize(3, axis=0), r"points/disparity of \(3,\)"),
        (longer, "500000000"),
        (at("frames/timestamp_s", 3, 0.0), "times that do not increase"),
        (at("frames/index", 3, 0), "frames out of order"),
        (at("frames/end", 3, 10**9), "does not fit the frames"),
        (other("frames/index", np.arange(39.0)), "frames/index of"),
        (other("points/pixel", np.zeros((3, 3), np.int32)), "points/pixel of"),
        (other("background/disparity", np.zeros((1, 5), np.float32)), "backgrounds of another size"),
        (at("points/appearance", 5, 255), "colour codes below 200"),
        (at("points/pixel", 5, 10**9), "pixels in order"),
        (at("points/disparity", 5, -1.0), "disparities of points"),
        (pose((2, 3), 1e9), "above the floor"),
        (pose((0, 3), 1e9), "of the origin"),
        (pose((0, 0), np.nan), "finite rotation"),
        (lambda file: file["floor"].attrs.update(world_SE3_left=UP), "a camera that sees the space between floor and"),
        (lambda file: file["rig"].attrs.update(sensor="eye"), "a sensor 'eye'"),
        (lambda file: file["rig"].attrs.update(width=80.5), "width of 80.5"),
    ],
)
def test_table_that_no_run_wrote_is_refused(maps, damage, named):
    with h5py.File(maps, "r+") as file:
        damage(file)
    with pytest.raises(InputError, match=rf"maps\.h5: .*{named}"):
        track(maps)


@pytest.mark.parametrize("size", [0, 2**64 - 16, 2**62])
def test_strings_that_the_library_would_read_without_end_are_refused(maps, size):
    data = bytearray(maps.read_bytes())
    first = data.index(b"GCOL") + 16
    data[first : first + 16] = struct.pack("<H6xQ", int(size > 0), size)
    maps.write_bytes(data)
    with pytest.raises(InputError, match=r"maps\.h5: .*a damaged heap of strings"):
        MapsRecording(maps)
    maps.write_bytes(data[: first + 1])
    with pytest.raises(InputError, match=r"maps\.h5: "):
        MapsRecording(maps)


def codes_of(colour: tuple[int, int, int], gain: float = 1.0) -> int:
    image = np.full((1, 1, 3), colour, np.uint8)
    return int(colour_codes(image, np.zeros(1, np.int32), Exposure(gain))[0])


def test_colour_codes_of_grey_lie_in_the_middle_of_chroma_whatever_the_exposure():
    # Luma 100 is in the fourth of eight cells; U and V are in the third of five.
    assert codes_of((100, 100, 100)) == (3 * 5 + 2) * 5 + 2
    both = colour_codes(np.array([[10, 200]], np.uint8), np.array([0, 1], np.int32), Exposure())
    assert both.tolist() == [codes_of((10, 10, 10)), codes_of((200, 200, 200))]
    assert codes_of((110, 50, 70)) == codes_of((165, 75, 105), 1.5)
    corners = [codes_of((b, g, r)) for b in (0, 255) for g in (0, 255) for r in (0, 255)]
    assert 0 <= min(corners) <= max(corners) < CODES
    np.testing.assert_allclose(smoothing().sum(axis=1), 1.0, rtol=1e-5)  # a histogram keeps its mass


@pytest.mark.parametrize("channels", [1, 3])
def test_colour_kernel_equals_its_reference(channels):
    rng = np.random.default_rng(channels)
    image = rng.integers(0, 256, (300, channels)).astype(np.uint8)
    pixels = rng.permutation(300)[:200].astype(np.int32)
    ours, theirs = np.empty(200, np.uint8), np.empty(200, np.uint8)
    for encode, codes in ((encode_colours, ours), (reference.encode_colours, theirs)):
        encode(image, pixels, 1.3, -4.5, codes)
    np.testing.assert_array_equal(ours, theirs)
