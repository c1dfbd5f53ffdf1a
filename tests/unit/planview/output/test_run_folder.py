"""A run's folder opened: who is a person, and its camera."""

import math
from pathlib import Path

from cli import Cli, JsonOf

from calib.ground_camera import GroundCamera
from planview.output.run_folder import RunFolder
from planview.trajectories.table import people_of


def test_person_is_confirmed_for_half_a_second(street: Path) -> None:
    run = RunFolder(street)  # at 10 frames per second track 4 is confirmed in 15 frames, track 5 in 3
    assert run.people.tolist() == [4]
    assert people_of(run.tracks, 1 / 6).tolist() == [4, 5], "at 6 frames per second, 3 frames are half a second"


def test_all_commands_give_the_same_number_of_people(street: Path, cli: Cli, json_of: JsonOf) -> None:
    assert "18 rows of 1 people" in cli("export", street, "--to", "csv")[1]
    figures = json_of("edit", street, "--delete", "5")
    assert (figures["people_before"], figures["people"]) == (1, 1)
    assert RunFolder(street).info.people == 1
    assert ">1<" in (street / "report.html").read_text()
    (street / "rules.toml").write_text('[[zone]]\nname = "all"\npolygon_m = [[-20, 0], [20, 0], [20, 20], [-20, 20]]\n')
    assert json_of("count", street, "--rules", street / "rules.toml")["rules"]["all"]["people"] == 1


def test_camera_of_a_run_is_the_one_that_made_it(street: Path) -> None:
    assert RunFolder(street).rule_plane.camera == GroundCamera(160, 120, 120.0, 3.0, math.radians(60.0))
    assert RunFolder(street).size_px == (160, 120)
