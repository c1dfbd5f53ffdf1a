"""The command line: each command's module is imported only when the command is called."""

from __future__ import annotations

import ast
import atexit
import gc
import inspect
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING, Literal, TextIO

from cyclopts import App, Group, Parameter

if TYPE_CHECKING:
    from cyclopts import CycloptsError

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads of small matrices wait for each other on a busy machine
COMMANDS = {
    "Start here": {"demo": "run", "check": "check", "run": "run"},
    "Results": {
        "report": "results",
        "view": "results",
        "render": "results",
        "plot": "results",
        "replay": "run",
        "edit": "tracks",
        "refine": "tracks",
        "count": "scores",
        "evaluate": "scores",
        "export": "tracks",
    },
    "Tools": {"params": "tools", "synth": "tools", "sweep": "sweep"},
}
"""By group of the help: the module of ``planview.commands`` with a command."""
CALIBRATE = ("align", "board", "convert", "floor", "human", "ui")


def make_app(words: Sequence[str] = ()) -> App:
    """The command tree; a command named among the words of the command line shows its own docstring as help."""
    app = App(
        name="planview",
        help="Stereo depth plan-view people tracking.",
        help_format="plaintext",  # reading Markdown takes a twentieth of a second
        help_epilogue="Exit status: 0 done, 1 the work failed, 2 wrong usage or bad input, 130 interrupted.",
        version=lambda: import_module("planview").__version__,
        version_flags=["--version", "-v"],
        group_parameters="Options",
        default_parameter=Parameter(negative_iterable=(), show_default=_default),
        suppress_keyboard_interrupt=False,
    )
    groups = {name: Group(name, sort_key=place) for place, name in enumerate([*COMMANDS, "Calibration"])}
    groups |= {"Tools": Group("Tools", sort_key=len(groups))}
    is_listing = not words or words[0] in ("--help", "-h", "calibrate", "completion")
    lines: dict[str, str] = first_lines("planview.api", "planview.commands") if is_listing else {}
    for group, commands in COMMANDS.items():
        for name, module in commands.items():
            _register(app, f"planview.commands.{module}:{name}", name, lines, words, groups[group])
    calibrate = App(name="calibrate", help="Find and convert calibrations.", group=groups["Calibration"])
    for name in CALIBRATE:
        _register(calibrate, f"planview.commands.calibrate:calibrate_{name}", name, lines, words)
    app.command(calibrate)
    lines = {"completion": (completion.__doc__ or "").partition("\n")[0]}
    _register(app, "planview.cli:completion", "completion", lines, words, groups["Tools"])
    return app


def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """Print a script that completes commands and options in a shell.

    Example: planview completion bash > ~/.local/share/bash-completion/completions/planview

    Args:
        shell: The shell that the script is for.
    """
    print(make_app().generate_completion(prog_name="planview", shell=shell))


def first_lines(*packages: str) -> dict[str, str]:
    """The first line of the docstring of every function in packages, whose modules are not imported."""
    lines: dict[str, str] = {}
    for package in packages:
        for file in Path(str(import_module(package).__file__)).parent.glob("*.py"):
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                doc = ast.get_docstring(node) if isinstance(node, ast.FunctionDef) else None
                if doc and isinstance(node, ast.FunctionDef):
                    lines.setdefault(node.name, doc.partition("\n")[0])
    return lines


def _register(
    app: App, target: str, name: str, lines: Mapping[str, str], words: Sequence[str], group: Group | None = None
) -> None:
    # Only the help of a command itself needs its docstring: with a text of its own the module is not imported.
    shown = _help_of(target) if name in words and {"--help", "-h"} & set(words) else {"help": lines.get(name, "")}
    app.command(target, name=name, group=group, **shown)


def _help_of(target: str) -> dict[str, str]:
    """Usage and docstring of a command, with its examples at the end, each on a line of its own."""
    from planview.commands.options import usage_of

    module, name = target.split(":")
    function = getattr(import_module(module), name)
    doc = inspect.getdoc(function) or ""
    head = re.split(r"\n(?:Args:|Parameters)\n", doc)[0]
    prose = []
    lines = []
    for part in filter(None, head.split("\n\n")):
        if not part.startswith("Example"):
            prose.append(" ".join(part.split()))
            continue
        what, _, text = re.sub(r"^Example[ ,]*(of )?", "", part).partition(":")
        # What is indented is shown as it stands, one line is a command that may be wrapped.
        shown = dedent(text) if text.startswith("\n") else " ".join(text.split())
        lines += [f"# {what}"] * bool(what) + [shown.strip("\n")]
    epilogue = "\n".join(["Examples:", *lines])
    return {"usage": usage_of(function, name), "help": "\n\n".join(prose), "help_epilogue": epilogue}


def _default(value: object) -> str | None:
    """A default as the help shows it; None hides that a switch is off or that an option is not needed."""
    return None if value in (None, (), False, "") else str(value)


def _note(
    message: Warning | str, category: type[Warning], filename: str, lineno: int,
    file: TextIO | None = None, line: str | None = None,
) -> None:  # fmt: skip
    """Print our own warnings as sentences, and those of libraries with their place."""
    own = category is UserWarning
    print(message if own else warnings.formatwarning(message, category, filename, lineno), file=sys.stderr)


def main(argv: list[str] | None = None, make: Callable[[Sequence[str]], App] | None = None) -> None:
    """Run a command; exit status 0 done, 1 the work failed, 2 wrong usage or bad input, 130 interrupted."""
    from calib.errors import InputError, WorkError
    from calib.io import reason

    words = sys.argv[1:] if argv is None else argv
    gc.disable()  # imports leave no garbage, and looking for it takes a seventh of their time
    atexit.register(gc.freeze)  # nor does it help an end: Python looks through all that was imported
    _stop_on_signals()
    warnings.showwarning = _note
    warnings.simplefilter("default", UserWarning)  # each command repeats what an earlier one in this process has said
    try:
        _refuse_empty(words)
        (make or make_app)(words)(words, exit_on_error=False, print_error=False)
    except (InputError, WorkError) as error:
        _fail(str(error), 2 if isinstance(error, InputError) else 1)
    except KeyboardInterrupt:
        _fail("interrupted", 130)
    except BrokenPipeError:
        # The reader of the pipe has closed it; Python would complain again when it flushes at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(128 + signal.SIGPIPE) from None
    except OSError as error:
        # Not expected by any command: a folder without permission, a disk that went away.
        _fail(f"{error.filename}: {reason(error)}" if error.filename else reason(error), 1)
    except Exception as error:
        from cyclopts import CycloptsError

        if isinstance(error, CycloptsError):
            _fail(_usage_error(error), 2)
        what = " ".join(str(error).split())
        _fail(f"unexpected {type(error).__name__}: {what} (the traceback is in {_traceback_file(error)})", 1)
    finally:
        gc.enable()


def _usage_error(error: CycloptsError) -> str:
    """What is wrong with the words of the command line."""
    from cyclopts import CoercionError, MissingArgumentError, UnusedCliTokensError

    argument = getattr(error, "argument", None)
    if isinstance(error, MissingArgumentError) and argument is not None:
        command = " ".join(error.command_chain or ())
        shown = argument.names[0] if argument.names else argument.name
        kind = "FOLDER" if shown == "--out" else "FILE" if argument.hint is Path else "VALUE"
        return f"{command} needs {shown} {kind}" if shown.startswith("--") else f"{command} needs {shown}"
    if isinstance(error, UnusedCliTokensError):
        return f"unexpected argument {' '.join(error.unused_tokens or ())!r}"
    if isinstance(error, CoercionError) and getattr(error.target_type, "__name__", "") in ("float", "int"):
        kind = "a whole number" if error.target_type is int else "a number"
        found = error.token.value if error.token else ""
        return f"{argument.name if argument else 'value'}: expected {kind}, found {found!r}"
    return " ".join(str(error).split())


def _traceback_file(error: Exception) -> str:
    """Write the traceback of an unexpected error to a file, and return its path."""
    import tempfile
    from traceback import format_exception

    with tempfile.NamedTemporaryFile("w", prefix="planview-", suffix=".log", delete=False, encoding="utf-8") as file:
        file.writelines(format_exception(error))
    return file.name


def _stop_on_signals() -> None:
    """SIGTERM and SIGHUP stop a command as Ctrl-C does, so that it ends with its files complete."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGTERM, signal.SIGHUP):
        # A program started with nohup ignores SIGHUP and must continue.
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
