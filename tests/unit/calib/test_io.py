"""Files, text and lengths of users."""

import os
from contextlib import suppress
from pathlib import Path

import pytest

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.base import parse_yaml
from calib.io import (
    MAX_TOML,
    load_toml,
    parse_length,
    parse_size,
    parse_toml,
    read_text,
    reason,
    whole_file,
    write_whole,
)
from planview.counting.rules import load_rules
from planview.engine.config import load_config
from planview.trajectories.formats import load_file


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 90_000 + " = 1",
        "a = " + "[" * 90_000,
        "a = " + "{b = " * 1000,
        "a = " + "9" * 5000,
        "x" * (MAX_TOML + 1),
    ],
    ids=["dotted key", "deep list", "deep table", "5000 digits", "too long"],
)  # fmt: skip
def test_toml_beyond_reason_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        parse_toml(text)


def test_toml_as_people_write_it_is_read() -> None:
    assert parse_toml('a.b.c = [[1.5, 2.5], [3.5, 4.5]] # "a.b.c.d"\n') == {"a": {"b": {"c": [[1.5, 2.5], [3.5, 4.5]]}}}


MERGES = "\n".join(["b0: &b0 {x: 1}", *(f"b{i}: &b{i}\n  <<: [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9))])


@pytest.mark.parametrize(
    ("text", "found"),
    [(MERGES, "reference"), ("a: " + "[" * 5000, "expected YAML"), ("a: [" + "1, " * 100_000 + "1]", "expected YAML")],
    ids=["merge bomb", "deep", "long"],
)
def test_yaml_beyond_reason_is_refused(text: str, found: str) -> None:
    with pytest.raises(ValueError, match=found):
        parse_yaml(text)


@pytest.mark.parametrize("read", [load_rig, load_rules, load_config, load_file], ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", ["pipe", "/dev/zero"])
def test_pipes_and_devices_are_refused_instead_of_waited_for(tmp_path: Path, read: object, name: str) -> None:
    path = tmp_path / name
    if name == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="a pipe or a device"):
        read(path)  # type: ignore[operator]


def test_large_file_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "sparse.toml"
    with path.open("wb") as file:
        file.truncate(20_000_000_000)
    with pytest.raises(InputError, match="20000000000"):
        read_text(path, "a world.toml")


def test_folder_and_absence_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found a folder"):
        load_toml(tmp_path, "a rules.toml")
    with pytest.raises(InputError, match="nothing there"):
        load_toml(tmp_path / "none", "a rules.toml")


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("floor.ransac_iterations=1000000000", "ransac_iterations"),
        ("maps.cell_m=1e-9", "cell_m"),
        ("template.patch_m=1e9", "patch_m"),
        ("template.template_time_s=1e-30", "template_time_s"),
        ("seed=" + "9" * 4000, "seed"),
        ("maps.distance_max_m=1e300", "distance_max_m"),
    ],
)  # fmt: skip
def test_settings_beyond_what_their_unit_can_mean_are_refused_by_name(setting: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        load_config(None, [setting])


def test_polygon_of_too_many_corners_is_refused(tmp_path: Path) -> None:
    corners = ", ".join(f"[{i}, {i * i % 7}]" for i in range(501))
    path = written(tmp_path / "rules.toml", f'[[zone]]\nname = "z"\npolygon_m = [{corners}]\n')
    with pytest.raises(InputError, match="at most 500"):
        load_rules(path)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (NotADirectoryError(20, "Not a directory", "a/b"), "a file where a folder is expected"),
        (OSError(28, "No space left on device"), "no space left on the disk"),
        (OSError(9999, "Odd"), "Odd"),
        (ValueError("two\nlines"), "two lines"),
        (OSError(), "OSError"),
    ],
)
def test_reason_of_an_error_is_words_on_one_line(error: Exception, text: str) -> None:
    assert reason(error) == text


def test_a_file_is_replaced_in_one_step_and_its_folder_made(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "deep"
    write_whole(folder / "a", "old")
    write_whole(folder / "a", "new")
    assert (folder / "a").read_text() == "new"
    assert [file.name for file in folder.iterdir()] == ["a"]


def test_an_error_while_writing_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", b"old")
    with suppress(ZeroDivisionError), whole_file(tmp_path / "a") as part:
        part.write_text("half")
        part.write_text(str(1 / 0))
    assert (tmp_path / "a").read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


def test_a_link_is_followed_and_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "new"


def test_a_device_is_written_and_not_replaced() -> None:
    write_whole(Path("/dev/null"), "gone")
    assert Path("/dev/null").is_char_device()


@pytest.mark.parametrize(
    ("text", "metres"),
    [("24.23mm", 0.02423), ("2.5 cm", 0.025), ("0.1m", 0.1), ("1in", 0.0254), ("mm", 0.001), ("3e1mm", 0.03)],
)
def test_length_with_unit_is_metres(text: str, metres: float) -> None:
    assert parse_length(text) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["", "24.23", "-3mm", "0mm", "nanmm", "infm", "24,23mm", "3 parsec", "mm24", "1e999m"])
def test_length_without_sense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--square: expected"):
        parse_length(text, "--square")


@pytest.mark.parametrize("text", ["1280", "0x5", "ax3", "-1x4", "1.5x2"])
def test_size_is_width_by_height_or_refused(text: str) -> None:
    assert parse_size("1280x720") == (1280, 720)
    with pytest.raises(InputError, match="WIDTHxHEIGHT"):
        parse_size(text)
