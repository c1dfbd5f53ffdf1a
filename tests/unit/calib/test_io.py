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
def test_special_files_are_refused_instead_of_waited_for(tmp_path, read, name):
    path = tmp_path / name
    if name == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="pipe"):
        read(path)


@pytest.mark.parametrize(
    ("name", "found"), [("sparse.toml", "20000000000"), ("", "a folder"), ("none", "no such file")]
)
def test_what_is_no_small_file_is_refused_by_its_kind(name, found, tmp_path):
    (tmp_path / "sparse.toml").touch()
    os.truncate(tmp_path / "sparse.toml", 20_000_000_000)
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


def test_folder_of_a_file_is_made(tmp_path):
    write_whole(tmp_path / "made" / "deep" / "a", b"new")
    assert (tmp_path / "made" / "deep" / "a").read_text() == "new"


def test_failed_writing_leaves_the_file_as_it_was(tmp_path):
    write_whole(tmp_path / "a", "old")
    with suppress(ZeroDivisionError), whole_file(tmp_path / "a") as part:
        part.write_text("half")
        part.write_text(str(1 / 0))
    assert (tmp_path / "a").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


def test_link_stays_a_link_when_written(tmp_path):
    (tmp_path / "target").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "new"


def test_device_stays_a_device_when_written():
    write_whole(Path("/dev/null"), "gone")
    assert Path("/dev/null").is_char_device()


LENGTHS = {"24.23mm": 0.02423, "2.5 cm": 0.025, "0.1m": 0.1, "1in": 0.0254, "mm": 0.001, "3e1mm": 0.03}
NO_LENGTHS = ["", "24.23", "-3mm", "0mm", "nanmm", "infm", "24,23mm", "3 parsec", "mm24", "1e999m"]
NO_SIZES = ["1280", "0x5", "ax3", "-1x4", "1.5x2"]


def test_length_with_unit_is_metres():
    assert {text: parse_length(text) for text in LENGTHS} == pytest.approx(LENGTHS)


def test_size_is_width_by_height():
    assert parse_size("1280x720") == (1280, 720)


@pytest.mark.parametrize(
    ("parse", "text", "found"),
    [(parse_length, text, "--square: expected") for text in NO_LENGTHS]
    + [(parse_size, text, "--square: .*WIDTHxHEIGHT") for text in NO_SIZES],
)
def test_quantity_without_sense_is_refused(parse, text, found):
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
def test_first_problem_is_one_short_sentence(values, sentence):
    with pytest.raises(ValidationError) as refused:
        Table.model_validate({"maps": values})
    printed = first_problem(refused.value)
    assert len(printed) < 200 if sentence is None else printed == sentence


def test_message_is_one_printable_line_whose_middle_is_left_out_where_it_is_long():
    assert str(InputError("a.toml: found\n\x1b[31m\tä")) == "a.toml: found \\x1b[31m\\tä"
    assert str(WorkError("my  clip: no floor")) == "my  clip: no floor"
    message = str(InputError(f"a.toml: found {'9' * 5000} as a key"))
    assert len(message) < MESSAGE_MAX
    assert message.startswith("a.toml: found 99")
    assert message.endswith("9 as a key")
    assert printable("a\x1b[31m\u202eb\n\tä\udcff") == "a\\x1b[31m\\u202eb\n\tä\\udcff"


def test_missing_open3d_is_one_sentence_with_the_purpose(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(WorkError, match="open3d") as printed:
        import_open3d("rendering")
    assert "\n" not in str(printed.value)


BLUE = np.full((2, 3, 3), (255, 0, 0), np.uint8)
GREY = np.arange(6, dtype=np.uint8).reshape(2, 3)


def test_grey_of_a_colour_is_its_luminance():
    np.testing.assert_array_equal(as_grey(BLUE), np.full((2, 3), 29))


@pytest.mark.parametrize("image", [BLUE, GREY], ids=["colour", "grey"])
def test_image_is_written_as_png_exactly(image, tmp_path):
    write_image(tmp_path / "image.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "image.png")), as_colour(image))


@pytest.mark.parametrize("name", ["floor.toml", "floor"])
def test_picture_of_no_known_format_is_refused_by_name(tmp_path, name):
    with pytest.raises(InputError, match=f"'{name}'"):
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
