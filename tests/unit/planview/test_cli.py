"""The command line and the public names."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import planview
from calib.errors import InputError, WorkError
from planview import cli

COMMANDS = [
    *([name] for group in cli.COMMANDS.values() for name in group),
    *(["calibrate", name] for name in cli.CALIBRATE),
]


def status_of(argv: list[str]) -> int:
    try:
        cli.main(argv)
    except SystemExit as left:
        return int(left.code or 0)
    return 0


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_of_every_command_has_an_example(command, capsys):
    assert status_of([*command, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Example" in text
    assert " ".join(["planview", *command]) in text


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_an_unknown_option_is_refused_in_one_sentence(command, capsys):
    assert status_of([*command, "--no-such-option"]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("planview: ")
    assert shown.err.count("\n") == 1
    assert shown.out == ""


@pytest.mark.parametrize("argv", [["no-such-command"], ["calibrate", "no-such"], ["run"], ["run", "x", "--fps", "a"]])
def test_wrong_usage_is_refused_in_one_sentence(argv, capsys):
    assert status_of(argv) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("argv", [["run", "x", "--out", ""], ["run", "x", "--out="], ["run", ""]])
def test_an_empty_value_is_refused_in_one_sentence(argv, capsys):
    option = "--out" if len(argv) > 2 else "run"
    assert status_of(argv) == 2
    assert capsys.readouterr().err == f"planview: {option}: expected a value, found an empty one\n"


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (InputError("a.csv: expected this, found that"), 2, "a.csv: expected this, found that"),
        (WorkError("no floor is visible"), 1, "no floor is visible"),
        (PermissionError(13, "Permission denied", "rec/left"), 1, "rec/left: no permission"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_errors_become_one_sentence_with_a_status(error, status, sentence, monkeypatch, capsys):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(cli, "make_app", lambda _: fail)
    assert status_of(["run"]) == status
    assert capsys.readouterr().err == f"planview: {sentence}\n"


def test_an_unexpected_error_becomes_one_sentence_that_names_a_file_with_the_traceback(monkeypatch, capsys, tmp_path):
    def fail(*_, **__):
        raise ZeroDivisionError("a\nb")

    monkeypatch.setattr(cli, "make_app", lambda _: fail)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert status_of(["run"]) == 1
    (log,) = tmp_path.iterdir()
    assert capsys.readouterr().err == (f"planview: unexpected ZeroDivisionError: a b (the traceback is in {log})\n")
    assert "Traceback" in log.read_text()
    assert "in fail" in log.read_text()


def test_the_package_imports_nothing_heavy():
    program = (
        "import sys, planview\nfrom planview.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = ('numba', 'open3d', 'rerun', 'cv2', 'numpy', 'matplotlib', 'scipy', 'pydantic')\n"
        "print('HEAVY', [m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "Track people in a recording" in done.stdout
    assert done.stdout.rstrip().endswith("HEAVY []")


def test_run_has_at_most_twenty_options(capsys):
    assert status_of(["run", "--help"]) == 0
    shown = re.findall(r"^│ [* ]*(--\S+)", capsys.readouterr().out, re.MULTILINE)
    assert "--out" in shown
    assert len(shown) <= 20


@pytest.mark.parametrize("flag", ["--version", "-v"])
def test_version_is_printed(flag, capsys):
    assert status_of([flag]) == 0
    assert capsys.readouterr().out.strip()[0].isdigit()


def test_completion_knows_the_options_of_commands(capsys):
    assert status_of(["completion", "bash"]) == 0
    text = capsys.readouterr().out
    assert "--overwrite" in text
    assert "complete -F" in text


ROOT = Path(__file__).resolve().parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_can_be_read_in_four_minutes():
    assert len(README.splitlines()) <= 120
    steps = [README.index(step) for step in ("make demo", "activate", "planview check", "planview run")]
    assert steps == sorted(steps)


@pytest.mark.parametrize("name", ["calib", "stereo"])
def test_file_of_the_users_that_hides_a_package_is_named(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("")
    (tmp_path / "script.py").write_text("import planview\n")
    outside = os.environ | {"PYTHONPATH": str(ROOT)}
    printed = subprocess.run([sys.executable, tmp_path / "script.py"], env=outside, capture_output=True, text=True)
    last = printed.stderr.splitlines()[-1]
    assert str(tmp_path / f"{name}.py") in last
    assert "rename that file" in last


@pytest.mark.parametrize("name", planview.__all__)
def test_every_public_name_is_what_it_says(name):
    value = getattr(planview, name)
    assert value.__name__.rpartition(".")[2] == name


def test_a_name_that_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="telepathy"):
        _ = planview.telepathy


def test_output_that_nobody_reads_on_ends_the_command_without_a_word(tmp_path):
    rows = "".join(f"{i},{i / 10},1,1.0,2.0,confirmed\n" for i in range(20_000))
    (tmp_path / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,state\n" + rows)
    words = [sys.executable, "-m", "planview", "export", tmp_path, "--to", "jsonl", "--out", "-"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as command:
        assert command.stdout.readline().startswith(b'{"frame": 0')
        command.stdout.close()
        assert command.stderr.read() == b""
