"""Rig files and the limits of what is read."""

import os
import sys
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from pydantic import Field, ValidationError, field_validator

from calib.errors import MESSAGE_MAX, InputError, WorkError, printable
from calib.formats import load_rig
from calib.formats.base import parse_yaml
from calib.images import as_colour, as_grey, focal_share, write_image
from calib.io import (
    MAX_TOML,
    load_toml,
    parse_length,
    parse_size,
    parse_toml,
    reason,
    whole_file,
    write_whole,
)
from calib.libraries import import_open3d
from calib.params import Params, first_problem
from planview.counting.rules import load_rules
from planview.engine.config import load_config
from planview.trajectories.formats import load_file

MERGES = "\n".join(["b0: &b0 {x: 1}", *(f"b{i}: &b{i}\n  <<: [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9))])


@pytest.mark.parametrize(
    ("parse", "text", "found"),
    [
        (parse_toml, "a" + ".a" * 90_000 + " = 1", "nested more than 32 deep"),
        (parse_toml, "a = " + "[" * 90_000, None),
        (parse_toml, "a = " + "{b = " * 1000, None),
        (parse_toml, "a = " + "9" * 5000, None),
        (parse_toml, "x" * (MAX_TOML + 1), None),
        (parse_yaml, MERGES, "reference"),
        (parse_yaml, "a: " + "[" * 5000, "expected YAML"),
        (parse_yaml, "a: [" + "1, " * 100_000 + "1]", "expected YAML"),
    ],
    ids=["dotted key", "deep list", "deep table", "5000 digits", "too long", "merge bomb", "deep YAML", "long YAML"],
)
def test_text_beyond_reason_is_refused(parse, text, found):
    with pytest.raises(ValueError, match=found):
        parse(text)


@pytest.mark.parametrize("read", [load_rig, load_rules, load_config, load_file], ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", ["pipe", "/dev/zero"])
def test_pipes_and_devices_are_refused_instead_of_waited_for(tmp_path, read, name):
    path = tmp_path / name
    if name == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="a pipe or a device"):
        read(path)  # type: ignore[operator]


def test_large_files_folders_and_absence_are_named(tmp_path):
    (tmp_path / "sparse.toml").touch()
    os.truncate(tmp_path / "sparse.toml", 20_000_000_000)
    for name, found in (("sparse.toml", "20000000000"), ("", "found a folder"), ("none", "no such file or folder")):
        with pytest.raises(InputError, match=found):
            load_toml(tmp_path / name, "a rules.toml")


@pytest.mark.parametrize("setting", ["joint.patch_m=1e9", "joint.template_time_s=1e-30", "maps.distance_max_m=1e300"])
def test_settings_beyond_what_their_unit_can_mean_are_refused_by_name(setting):
    with pytest.raises(InputError, match=setting.split("=")[0]):
        load_config(None, [setting])


def test_polygon_of_too_many_corners_is_refused(tmp_path):
    corners = ", ".join(f"[{i}, {i * i % 7}]" for i in range(501))
    (tmp_path / "rules.toml").write_text(f'[[zone]]\nname = "z"\npolygon_m = [{corners}]\n')
    with pytest.raises(InputError, match="at most 500"):
        load_rules(tmp_path / "rules.toml")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (NotADirectoryError(20, "Not a directory", "a/b"), "a file where a folder is expected"),
        (OSError(28, "No space left on device"), "no space left on the disk"),
        (ValueError("two\nlines"), "two lines"),
        (OSError(), "OSError"),
    ],
)
def test_reason_of_an_error_is_words_on_one_line(error, text):
    assert reason(error) == text


def test_a_file_is_replaced_in_one_step_its_folder_made_and_left_as_it_was_by_an_error(tmp_path):
    folder = tmp_path / "made" / "deep"
    write_whole(folder / "a", "old")
    write_whole(folder / "a", b"new")
    with suppress(ZeroDivisionError), whole_file(folder / "a") as part:
        part.write_text("half")
        part.write_text(str(1 / 0))
    assert (folder / "a").read_text() == "new" and [file.name for file in folder.iterdir()] == ["a"]


def test_links_stay_links_and_devices_devices(tmp_path):
    (tmp_path / "target").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "target").read_text() == "new"
    write_whole(Path("/dev/null"), "gone")
    assert Path("/dev/null").is_char_device()


LENGTHS = {"24.23mm": 0.02423, "2.5 cm": 0.025, "0.1m": 0.1, "1in": 0.0254, "mm": 0.001, "3e1mm": 0.03}
NO_LENGTHS = ["", "24.23", "-3mm", "0mm", "nanmm", "infm", "24,23mm", "3 parsec", "mm24", "1e999m"]
NO_SIZES = ["1280", "0x5", "ax3", "-1x4", "1.5x2"]


def test_length_with_unit_is_metres_and_size_is_width_by_height():
    assert {text: parse_length(text) for text in LENGTHS} == pytest.approx(LENGTHS)
    assert parse_size("1280x720") == (1280, 720)


@pytest.mark.parametrize(
    ("parse", "text", "found"),
    [(parse_length, text, "--square: expected") for text in NO_LENGTHS]
    + [(parse_size, text, "--square: .*WIDTHxHEIGHT") for text in NO_SIZES],
)
def test_length_and_size_without_sense_are_refused(parse, text, found):
    with pytest.raises(InputError, match=found):
        parse(text, "--square")


class Cells(Params):
    cell_m: float = Field(ge=0)
    name: str = "a"

    @field_validator("name")
    @classmethod
    def _one_word(cls, value: str) -> str:
        if " " in value:
            raise ValueError(f"expected one word, found {value!r}")
        return value


class Table(Params):
    maps: Cells


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"cell_m": -1.0}, "maps.cell_m: should be greater than or equal to 0, found -1.0"),
        ({"cell_m": 1.0, "cel": 2}, "unknown name maps.cel"),
        ({}, "expected maps.cell_m, found none"),
        ({"cell_m": 1.0, "name": "a b"}, "maps.name: expected one word, found 'a b'"),
        ({"cell_m": "x" * 500}, None),
    ],
)
def test_first_problem_names_the_value_what_was_expected_and_found_and_cuts_it_short(values, sentence):
    with pytest.raises(ValidationError) as refused:
        Table.model_validate({"maps": values})
    printed = first_problem(refused.value)
    assert len(printed) < 200 if sentence is None else printed == sentence


def test_message_is_one_printable_line_whose_middle_is_left_out_where_it_is_long():
    assert str(InputError("a.toml: found\n\x1b[31m\tä")) == "a.toml: found \\x1b[31m\\tä"
    assert str(WorkError("my  clip: no floor")) == "my  clip: no floor"
    message = str(InputError(f"a.toml: found {'9' * 5000} as a key"))
    assert len(message) < MESSAGE_MAX and message.startswith("a.toml: found 99")
    assert message.endswith("9 as a key")
    assert printable("a\x1b[31m\u202eb\n\tä\udcff") == "a\\x1b[31m\\u202eb\n\tä\\udcff"


def test_missing_open3d_is_one_sentence_with_the_purpose(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(WorkError, match=r"^rendering needs open3d \(pip install open3d\)") as printed:
        import_open3d("rendering")
    assert "\n" not in str(printed.value)


BLUE = np.full((2, 3, 3), (255, 0, 0), np.uint8)
GREY = np.arange(6, dtype=np.uint8).reshape(2, 3)


def test_image_in_grey_and_in_colour_is_written_as_png_exactly(tmp_path):
    np.testing.assert_array_equal(as_grey(BLUE), np.full((2, 3), 29))
    assert as_grey(GREY) is GREY
    for name, image in (("blue.png", BLUE), ("grey.png", GREY)):
        write_image(tmp_path / name, image)
        np.testing.assert_array_equal(cv2.imread(str(tmp_path / name)), as_colour(image))


@pytest.mark.parametrize("name", ["floor.toml", "floor"])
def test_picture_of_no_known_format_is_refused_by_name(tmp_path, name):
    with pytest.raises(InputError, match=rf"e\.g\. floor\.png, found '{name}'"):
        write_image(tmp_path / name, BLUE)
    assert not (tmp_path / name).exists()


def photograph(*millimetres: int) -> bytes:
    image, exif, content = Image.new("RGB", (40, 30)), Image.Exif(), BytesIO()
    exif.get_ifd(0x8769).update((0xA405, value) for value in millimetres)
    image.save(content, "JPEG", exif=exif)
    return content.getvalue()


def test_focal_length_of_film_is_relative_to_its_diagonal():
    assert focal_share(photograph(26)) == pytest.approx(26 / 43.267, rel=1e-4)


@pytest.mark.parametrize("content", [photograph(), b"no photograph", b""])
def test_photograph_without_a_focal_length_is_refused(content):
    with pytest.raises(InputError, match="expected"):
        focal_share(content)
