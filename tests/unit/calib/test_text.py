"""Files that would take a parser's time, memory or stack are refused before it sees them."""

import os
from pathlib import Path

import pytest

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.yaml_text import parse_yaml
from calib.text import MAX_TOML, load_toml, parse_toml, read_text, reason
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


def test_yaml_merge_bomb_is_refused() -> None:
    levels = [f"b{i}: &b{i}\n  <<: [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9)]
    with pytest.raises(ValueError, match="reference"):
        parse_yaml("\n".join(["b0: &b0 {x: 1}", *levels]))


@pytest.mark.parametrize("text", ["a: " + "[" * 5000, "a: [" + "1, " * 100_000 + "1]"], ids=["deep", "long"])
def test_yaml_beyond_reason_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected YAML"):
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
