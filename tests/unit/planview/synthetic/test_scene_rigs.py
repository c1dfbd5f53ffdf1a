"""Scenes with several heads: one room and one set of people, a recording per head on its own clock."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.errors import InputError
from calib.world import load_rigs
from planview.cli import main
from planview.synthetic.random_scenes.rooms import random_rigs
from planview.synthetic.render import SceneRenderer
from planview.synthetic.write import load_rig_scenes, write_rigs
from planview.trajectories.table import read_truth

ROOM = "fps = 10\nduration_s = 1\n[room]\nsize_m = [8, 8, 4]\n[lights]\nlamps = [{ at_m = [4, 5, 3.9] }]\n"
RIG = "width = 80\nheight = 60\nfocal_px = 55\ntilt_deg = 65\n"
PERSON = "[[people]]\nstart_m = [4, 4]\nface_deg = -90\nheight_m = 1.7\nsteps = [{ go = [[5, 4]] }]\n"
HEADS = (
    f'[[head]]\nname = "south"\n[head.rig]\nat_m = [4, 1, 2.4]\n{RIG}'
    f'[[head]]\nname = "west"\nstart_s = 0.3\n[head.rig]\nat_m = [1, 4, 2.6]\nheading_deg = 0\n{RIG}'
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(ROOM + PERSON + HEADS)
    return path


def test_heads_record_the_same_person_on_their_own_clocks(scene: Path, tmp_path: Path) -> None:
    write_rigs(load_rig_scenes(scene), tmp_path / "out")
    south, west = load_rigs(tmp_path / "out" / "rigs.toml")
    assert (south.start_s, west.start_s) == (0.0, 0.3)
    assert west.world_SE3_left.translation == pytest.approx([-3.0, 3.0, 2.6], abs=1e-6)
    a, b = (read_truth(tmp_path / "out" / name / "truth.csv") for name in ("south", "west"))
    assert (len(a), len(b)) == (10, 7)
    # West looks along the room's x axis: its x axis is the room's -y.
    in_common = np.column_stack([b.y_m - 3.0, 3.0 - b.x_m])
    np.testing.assert_allclose(in_common, np.column_stack([a.x_m, a.y_m])[3:], atol=2e-4)


def test_a_head_that_starts_at_once_records_what_a_single_rig_does(scene: Path) -> None:
    head = load_rig_scenes(scene)[0]
    assert (head.renderer().frame(4).left == SceneRenderer(head.scene).frame(4).left).all()


def test_synth_renders_heads(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(["synth", str(scene), str(tmp_path / "out"), "--frames", "2", "--jpeg", "--json"])
    assert not left.value.code
    assert json.loads(capsys.readouterr().out)["frames"] == 4
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["rigs.toml", "south", "west"]


def test_two_heads_of_one_name_are_refused(scene: Path) -> None:
    scene.write_text(scene.read_text().replace("west", "south"))
    with pytest.raises(InputError, match="name of their own"):
        load_rig_scenes(scene)


def test_drawn_heads_are_the_same_for_the_same_seed() -> None:
    one, again, other = random_rigs(5), random_rigs(5), random_rigs(6)
    assert [h.mount for h in one] == [h.mount for h in again]
    assert one[0].scene == again[0].scene
    assert one[0].scene != other[0].scene
