"""Plots of trajectories: what is drawn where, and the files of ``planview plot``."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from toy_tracks import positions_table

from calib.errors import InputError
from planview.output.plot import NamedTracks, figure_of
from planview.trajectories.clock import Clock
from planview.trajectories.plot import (
    DENSITY_CELL_M,
    NAMED_MAX,
    plot_counts,
    plot_density,
    plot_paths,
    plot_speed,
)
from planview.trajectories.table import Trajectories, write_table


def walkers(people: int = 1, frames: int = 60) -> Trajectories:
    """People who walk along y, half a metre apart, at 1.5 m/s in 30 frames per second."""
    frame, track = (part.ravel() for part in np.meshgrid(np.arange(frames), np.arange(1, people + 1), indexing="ij"))
    return positions_table(frame, track, np.column_stack([0.5 * track, 0.05 * frame]), timestamp_s=frame / 30.0)


def axes() -> object:
    return Figure().subplots()


def test_path_of_a_person_is_a_line_of_its_positions_with_equal_axes():
    drawn = plot_paths(walkers(), axes())
    line = drawn.get_lines()[0]
    assert line.get_xydata()[-1] == pytest.approx([0.5, 0.05 * 59])
    assert line.get_label() == "1"
    assert drawn.get_aspect() == 1.0
    assert (drawn.get_xlabel(), drawn.get_ylabel()) == ("x [m]", "y [m]")


def test_missing_frames_are_a_gap_in_the_path():
    table = walkers()
    drawn = plot_paths(table.where((table.frame < 20) | (table.frame > 40)), axes())
    assert np.isnan(drawn.get_lines()[0].get_ydata()).sum() == 1


def test_the_path_of_an_id_that_is_suddenly_elsewhere_has_a_gap():
    table = walkers()
    table.x_m[table.frame >= 30] += 30.0
    drawn = plot_paths(table, axes())
    assert np.isnan(drawn.get_lines()[0].get_ydata()).sum() == 1
    assert max(np.nanmax(line.get_ydata()) for line in plot_speed(table, axes()).get_lines()) < 2.0


def test_who_is_confirmed_for_too_short_is_nobody_in_any_plot():
    both = walkers(people=2)
    table = both.where((both.track_id == 1) | (both.frame < 5))
    assert plot_paths(table, axes()).get_legend_handles_labels()[1] == ["1"]
    assert max(plot_counts(table, axes()).get_lines()[0].get_ydata()) == 1


def test_legend_names_twenty_people():
    labels = plot_paths(walkers(people=23), axes()).get_legend_handles_labels()[1]
    assert len(labels) == NAMED_MAX + 1
    assert labels[-1] == "3 more"


def test_speed_without_velocities_is_that_of_the_positions():
    line = plot_speed(walkers(), axes()).get_lines()[0]
    assert line.get_ydata() == pytest.approx(1.5)


def test_speed_by_a_clock_of_whole_seconds_is_the_mean_over_them():
    table = walkers(frames=120)
    table.timestamp_s[:] = np.floor(table.timestamp_s)
    line = plot_speed(table, axes()).get_lines()[0]
    assert line.get_ydata() == pytest.approx(1.5)


def test_speeds_drawn_after_slower_ones_are_not_cut_off():
    both = axes()
    plot_speed(walkers(), both)
    plot_speed(replace(walkers(), y_m=3 * walkers().y_m), both)
    assert both.get_ylim()[0] == 0
    assert 4.5 < both.get_ylim()[1] < 5.5


def test_counts_are_people_in_every_frame():
    table = walkers(people=2)
    line = plot_counts(table.where((table.track_id == 1) | (table.frame < 30)), axes()).get_lines()[0]
    assert list(line.get_ydata())[:31:30] == [2, 1]
    assert list(line.get_ydata())[-1] == 0


def test_density_of_a_person_who_is_always_there_adds_up_to_one():
    mesh = plot_density(walkers(people=2), axes()).collections[0]
    assert np.ma.getdata(mesh.get_array()).sum() * DENSITY_CELL_M**2 == pytest.approx(2.0, abs=0.02)


def test_density_of_several_runs_is_refused():
    with pytest.raises(InputError, match="density of several runs"):
        figure_of([NamedTracks("a", walkers()), NamedTracks("b", walkers())], panels=["density"])


def test_frames_without_rows_have_the_times_of_a_steady_clock():
    table = walkers()
    clock = Clock(table.where(table.frame % 10 == 0))
    assert clock.at(np.array([5, 65])) == pytest.approx([5 / 30, 65 / 30])


def test_runs_are_told_apart_by_colour():
    figure = figure_of([NamedTracks("near", walkers()), NamedTracks("far", walkers(2))])
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["near", "far"]


def test_runs_in_metres_are_not_plotted_with_runs_in_pixels():
    none = np.full((5, 2), np.nan)
    boxes = positions_table(np.arange(5), np.ones(5, int), none + 0.0, box_px=np.ones((5, 4)))
    with pytest.raises(InputError, match="pixels"):
        figure_of([NamedTracks("a", walkers()), NamedTracks("b", boxes)])


@pytest.mark.parametrize(("name", "begins"), [("p.png", b"\x89PNG"), ("p.svg", b"<?xml")])
def test_command_writes_a_picture_of_the_kind_that_its_name_asks_for(tmp_path, shown_by, name, begins):
    with (tmp_path / "tracks.csv").open("w") as file:
        write_table(file, walkers())
    shown_by("plot", tmp_path, "--out", tmp_path / name)
    assert (tmp_path / name).read_bytes().startswith(begins)
