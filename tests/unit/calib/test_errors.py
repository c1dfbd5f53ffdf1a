"""Failures are said in one printable line."""

from calib.errors import MESSAGE_MAX, InputError, WorkError, printable


def test_message_is_one_printable_line() -> None:
    assert str(InputError("a.toml: found\n\x1b[31m\tä")) == "a.toml: found \\x1b[31m\\tä"


def test_spaces_in_a_path_stay() -> None:
    assert str(WorkError("my  clip: no floor")) == "my  clip: no floor"


def test_middle_of_a_long_message_is_left_out() -> None:
    message = str(InputError(f"a.toml: found {'9' * 5000} as a key"))
    assert len(message) < MESSAGE_MAX
    assert message.startswith("a.toml: found 99")
    assert message.endswith("9 as a key")


def test_printable_writes_control_characters_out() -> None:
    assert printable("a\x1b[31m\u202eb\n\tä\udcff") == "a\\x1b[31m\\u202eb\n\tä\\udcff"
