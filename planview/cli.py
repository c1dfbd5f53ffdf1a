"""The command line: each command's module is imported only when the command is called."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Literal

from cyclopts import App

COMMANDS = {
    "demo": "Run the clip that comes with the package and print its metrics.",
    "run": "Track people in a recording.",
    "refine": "Improve the tracks of a finished run, knowing the whole recording.",
    "edit": "Join, split, delete and rename tracks, and take edits back.",
    "evaluate": "Score tracks against truth.",
    "inspect": "Say what a recording holds and what it lacks.",
    "doctor": "Check a recording and its calibration before trusting results.",
    "synth": "Render a recording with exact truth from a TOML scene.",
    "count": "Count line crossings and zone occupancy in tracks.",
    "export": "Write tracks in the format of another program.",
    "sweep": "Run several settings or recordings and compare them.",
    "report": "Write the page of a run, or one page that compares several.",
    "render": "Draw a run as a video or a picture.",
    "debug": "Track a run again up to a frame with a parameter changed, and compare.",
    "view": "Open a run in the rerun viewer.",
}
CALIBRATE = {
    "align": "Find where stereo heads are beside each other from people who walk.",
    "board": "Calibrate a stereo rig from chessboard or ChArUco images.",
    "convert": "Convert a calibration from one format to another.",
    "floor": "Find the floor in a stereo recording.",
    "human": "Calibrate one camera from standing people.",
    "ui": "Calibrate in the browser.",
}


def make_app(words: Sequence[str] = ()) -> App:
    """The command tree; a command named among the words of the command line shows its own docstring as help."""
    app = App(
        name="planview",
        help="Stereo depth plan-view people tracking.",
        version=_version,
        version_flags=["--version", "-v"],
        default_parameter=None,
        suppress_keyboard_interrupt=False,
    )
    for name, text in COMMANDS.items():
        _register(app, f"planview.commands.{name}:{name}", name, text, words)
    calibrate = App(name="calibrate", help="Obtain, check and convert calibrations.")
    app.command(register_group(calibrate, "calibrate", "planview.commands", CALIBRATE, words))
    app.command(completion)
    return app


def completion(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print what completes commands and options in a shell.

    Example: planview completion bash > ~/.local/share/bash-completion/completions/planview

    Parameters
    ----------
    shell
        The shell that the text is for.
    """
    print(make_app().generate_completion(prog_name="planview", shell=shell))


def _register(app: App, target: str, name: str, text: str, words: Sequence[str]) -> None:
    # With a help text the module is not imported for a listing, but its docstring (with the example) is not shown.
    if name in words:
        app.command(target, name=name)
    else:
        app.command(target, name=name, help=text)


def register_group(app: App, group: str, package: str, commands: dict[str, str], words: Sequence[str]) -> App:
    """Add commands that stand in ``<package>.<group>_<name>``; those among the words show their whole docstring."""
    for name, text in commands.items():
        _register(app, f"{package}.{group}_{name}:{group}_{name}", name, text, words)
    return app


def _version() -> str:
    from importlib.metadata import version

    return version("planview")


def main(argv: list[str] | None = None, make: Callable[[Sequence[str]], App] | None = None) -> None:
    """Run a command; exit status 0 done, 1 the work failed, 2 wrong usage or bad input, 130 interrupted."""
    from calib.errors import InputError, WorkError
    from calib.io import reason

    words = sys.argv[1:] if argv is None else argv
    _stop_on_signals()
    try:
        _refuse_empty(words)
        (make or make_app)(words)(words, exit_on_error=False, print_error=False)
    except InputError as error:
        _fail(str(error), 2)
    except WorkError as error:
        _fail(str(error), 1)
    except KeyboardInterrupt:
        _fail("interrupted", 130)
    except OSError as error:
        # What no command expects: a folder that may not be read, a disk that went away.
        _fail(f"{error.filename}: {reason(error)}" if error.filename else reason(error), 1)
    except Exception as error:
        from cyclopts import CycloptsError

        if not isinstance(error, CycloptsError):
            raise
        _fail(" ".join(str(error).split()), 2)


def _stop_on_signals() -> None:
    """SIGTERM and SIGHUP stop a command as Ctrl-C does, so that it ends with its files complete."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGTERM, signal.SIGHUP):
        # A program started with nohup ignores SIGHUP, and is to go on.
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def _refuse_empty(words: Sequence[str]) -> None:
    """An empty path would mean the current folder."""
    from calib.errors import InputError

    for before, word in zip(["planview", *words], words, strict=False):
        option, equals, value = word.partition("=")
        if not word or (word.startswith("--") and equals and not value):
            raise InputError(f"{option or before}: expected a value, found an empty one")


def _fail(message: str, status: int) -> None:
    from calib.errors import printable

    print(f"planview: {printable(message)}", file=sys.stderr)
    raise SystemExit(status)
