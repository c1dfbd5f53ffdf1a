"""Files that are whole or not there."""

from contextlib import suppress
from pathlib import Path

from calib.files import whole_file, write_whole


def test_a_file_is_replaced_in_one_step(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", "old")
    write_whole(tmp_path / "a", "new")
    assert (tmp_path / "a").read_text() == "new"
    assert [file.name for file in tmp_path.iterdir()] == ["a"]


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


def test_folder_of_a_file_is_made(tmp_path: Path) -> None:
    write_whole(tmp_path / "new" / "deep" / "a.txt", "text")
    assert (tmp_path / "new" / "deep" / "a.txt").read_text() == "text"
