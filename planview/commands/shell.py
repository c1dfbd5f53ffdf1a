"""A command made from a public function, whose signature and docstring give its arguments, defaults and help."""

from __future__ import annotations

import builtins
import gc
import inspect
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from cyclopts import Group, Parameter

from calib.errors import InputError, WorkError
from planview.commands.options import OPTIONS, option_of, say, typed

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off unless it is given; there is no --no-... of it."""
JSON = {"json": "Print one JSON object to standard output."}
"""The switch of commands whose result can be printed for programs."""
QUIET = {"quiet": "Show no progress."}
"""The switch of commands that take long."""
SET = Annotated[
    Sequence[str], Parameter(negative="", help="One parameter, e.g. foreground.learning_rate=0.002; can be repeated.")
]
"""The option that changes single parameters, of commands that take a file of them."""


@dataclass(frozen=True)
class Call:
    """A command as it was typed; calling it calls the public function, and an argument is found by its name.

    Attributes:
        own: options of the command line alone, which decide what is printed.
    """

    function: Callable[..., Any]
    bound: inspect.BoundArguments
    own: dict[str, Any]

    def __call__(self) -> Any:
        if "quiet" not in self.own:
            return self.function(*self.bound.args, **self.bound.kwargs)
        from planview.commands.console import drawing  # of rich, which some commands do without

        with drawing(quiet=self.own["quiet"]) as bar:
            if "progress" in self.bound.arguments:
                self.bound.arguments["progress"] = bar
            return self.function(*self.bound.args, **self.bound.kwargs)

    def __getitem__(self, name: str) -> Any:
        return self.bound.arguments[name]

    def prints_json(self, value: object) -> bool:
        """Print the value where --json asks for it; whether it did."""
        if self.own["json"]:
            print(json.dumps(value, indent=2))
        return bool(self.own["json"])

    def says(self) -> Any:
        """Call the function and print its result: words and files as messages, with --json also as one object."""
        result = self()
        say(result)
        for file in result.files:
            say(f"wrote {file}")
        self.prints_json(result.to_json())
        return result


def command(
    function: Callable[..., Any],
    *,
    options: Sequence[str] = (),
    types: Mapping[str, Any] | None = None,
    groups: Mapping[str, str] | None = None,
    own: Mapping[str, str] | None = None,
) -> Callable[[Callable[[Call], object]], Callable[..., None]]:
    """Make a command of a function and of what prints its result, whose docstring has examples.

    Args:
        options: arguments that are options, though Python takes them by position.
        types: what words become, where the annotation does not say it; None leaves an argument to Python.
        groups: titles in the help, with the names of their options.
        own: switches of the command line alone, with their help.
    """
    signature = inspect.signature(function)
    given = {name: _typed(str(one.annotation), function) for name, one in signature.parameters.items()}
    kinds = {name: kind for name, kind in (given | dict(types or {})).items() if kind is not None}
    switches = own or {}
    for name, text in switches.items():
        kinds[name] = Annotated[bool, Parameter(negative="", help=text)]
    if "Settings" in str(signature.parameters.get("config")):
        kinds["set"] = SET
    for place, (title, names) in enumerate((groups or {}).items()):
        for name in names.split():
            kinds[name] = Annotated[kinds[name], Parameter(group=Group(title, sort_key=place))]
    shown = [_parameter(name, kind, signature, name in options) for name, kind in kinds.items()]

    def of(show: Callable[[Call], object]) -> Callable[..., None]:
        def run(*args: Any, **kwargs: Any) -> None:
            extra = {name: kwargs.pop(name, False) for name in (*switches, "set")}
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            gc.freeze()  # all is imported (see ``cli.main``), and stays
            gc.enable()
            try:
                if extra["set"]:
                    from planview.engine.config import given_tables  # of all stages

                    bound.arguments["config"] = given_tables(bound.arguments["config"], extra["set"])
                show(Call(function, bound, extra))
            except (InputError, WorkError) as error:
                error.args = (typed(error),)
                error.argument = error.remedy = ""
                raise

        run.__name__ = function.__name__
        run.__doc__ = _help(function, show)
        run.__signature__ = inspect.Signature(sorted(shown, key=lambda one: one.kind))  # type: ignore[attr-defined]
        run.__annotations__ = {one.name: one.annotation for one in shown}
        return run

    return of


def _parameter(name: str, kind: Any, signature: inspect.Signature, is_option: bool) -> inspect.Parameter:
    """An argument of a function as the command line takes it; by its name, where it is an option or Python has none."""
    if name in OPTIONS and name != "config":
        kind = Annotated[kind, Parameter(name=OPTIONS[name])]
    of_python = signature.parameters.get(name)
    if of_python is None:
        default = () if name == "set" else False
        return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
    place = of_python.KEYWORD_ONLY if is_option else of_python.kind
    place = of_python.POSITIONAL_ONLY if place is of_python.POSITIONAL_OR_KEYWORD else place
    return of_python.replace(kind=place, annotation=kind)


def _help(function: Callable[..., Any], show: Callable[[Call], object]) -> str:
    """The docstring of a function with options in place of arguments and examples of the command in place of Python."""
    doc = inspect.getdoc(function) or ""
    doc = re.sub(r"```python\n.*?```\n", f"{inspect.getdoc(show) or ''}\n", doc, flags=re.DOTALL)
    doc = re.sub(r"\n {8}", " ", doc)
    doc = re.sub(r"\s+In\s+Python\b.*?(?=\n+\s*\w+: |\n\n|$)", "", doc, flags=re.DOTALL)
    return re.sub(r"``(\w+)``", lambda word: option_of(word[1]), doc)


class _Names(dict[str, Any]):
    """Names that an annotation may hold; those that are imported for type checkers only are no type of words."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, object)


def _typed(annotation: str, function: Callable[..., Any]) -> Any:
    """The part of an annotation that words can give, e.g. the path of a path, a text or a table; None where they cannot
    give any."""
    kind = eval(annotation, {}, _Names(function.__globals__))
    parts = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    given = [part for part in parts if part is bool or get_origin(part) in (Literal, Sequence)]
    given = given or [kind for kind in (Path, str, float, int) if kind in parts][:1]
    if not given:
        return None
    if given == [bool]:
        return Flag
    first = given[0]
    if get_origin(first) is Sequence and first != Sequence[int] and get_origin(get_args(first)[0]) is not Literal:
        return Annotated[Sequence[str], Parameter(negative="")]
    return reduce(or_, given + [NoneType] * (NoneType in parts))
