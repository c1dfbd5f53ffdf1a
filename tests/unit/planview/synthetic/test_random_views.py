"""Drawn views of one camera: every committed table gives scenes that hold what it asks for."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from planview.synthetic import assets
from planview.synthetic.camera import ground_camera
from planview.synthetic.random_scenes.views import random_view

VIEWS = sorted((assets.SCENES / "views").glob("*.toml"))


def table(path: Path) -> dict[str, object]:
    return tomllib.loads(path.read_text())


@pytest.mark.parametrize("path", VIEWS, ids=lambda p: p.stem)
def test_view_of_a_seed_is_drawn_again_alike_and_another_seed_otherwise(path):
    first, again, other = (random_view(table(path), seed, path.stem) for seed in (0, 0, 1))
    assert first == again
    assert first.scene != other.scene


@pytest.mark.parametrize("path", VIEWS, ids=lambda p: p.stem)
def test_line_of_a_view_lies_in_the_image_and_everybody_has_time_to_pass_it(path):
    for seed in range(4):
        view = random_view(table(path), seed, path.stem)
        assert view.scene.camera is not None
        size = np.array([view.scene.camera.width, view.scene.camera.height])
        for end in view.wire_px:
            assert (np.array(end) >= 0).all()
            assert (np.array(end) < size).all()
        assert view.scene.people
        assert all(p.enter_s < view.scene.duration_s - 3 for p in view.scene.people)


def test_changes_take_the_place_of_what_a_seed_draws():
    given = {"description": "", "camera": {"tilt_deg": 75, "person_share": 0.5}, "walks": {"people": 1}}
    view = random_view(given, 0, "one", {"room": {"gloss": 0.25}})
    assert view.scene.room.floor.gloss == 0.25


def test_person_in_the_middle_of_a_view_is_as_large_as_drawn():
    given = {"description": "", "camera": {"tilt_deg": 75, "person_share": 0.5}, "walks": {"people": 1}}
    mount = random_view(given, 0, "one").scene.camera
    assert mount is not None
    camera = ground_camera(mount)
    foot = camera.back_project(np.array([[159.5, 180.0]]))[0]
    rows = camera.project(np.array([[*foot, 0.0], [*foot, 1.7]]))[:, 1]
    assert abs(rows[1] - rows[0]) / 240 == pytest.approx(0.5, abs=0.06)
