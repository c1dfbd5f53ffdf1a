"""A command made from a public function, whose signature and docstring give its arguments, defaults and help."""

from __future__ import annotations

import ast
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
from typing import Annotated, Any, Literal, get_args, get_origin

from cyclopts import Group, Parameter

from calib.errors import InputError, WorkError
from planview.commands.options import say, typed

Flag = Annotated[bool, Parameter(negative="")]
"""A switch that is off unless it is given; there is no --no-... of it."""
JSON = {"json": "Print one JSON object to standard output."}
"""The switch of commands whose result can be printed for programs."""
QUIET = {"quiet": "Show no progress."}
"""The switch of commands that take long."""
_OPTIONS = {"overrides": "--set", "everything": "--all"}
"""Options that are shorter than the arguments of Python."""


@dataclass(frozen=True)
class Call:
    """A command as it was typed; calling it calls the public function, and an argument is found by its name.

    Attributes:
        own: options of the command line alone, which decide what is printed.
        options: names of options by those of arguments.
    """

    function: Callable[..., Any]
    bound: inspect.BoundArguments
    own: dict[str, Any]
    options: Mapping[str, str]

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

    def sentence(self, error: InputError | WorkError) -> str:
        """The sentence of an error with the options of this command."""
        return typed(error, self.options)

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
    names: Mapping[str, str | Sequence[str]] | None = None,
    groups: Mapping[str, str] | None = None,
    own: Mapping[str, str] | None = None,
) -> Callable[[Callable[[Call], object]], Callable[..., None]]:
    """Make a command of a function and of what prints its result, whose docstring has examples.

    Args:
        options: arguments that are options, though Python takes them by position.
        types: what words become, where the annotation does not say it; None leaves an argument to Python.
        names: all names of an option that has several, or of an argument that is called otherwise.
        groups: titles in the help, with the names of their options.
        own: switches of the command line alone, with their help.
    """
    signature = inspect.signature(function)
    own = own or {}
    types = types or {}
    names = {name: option for name, option in _OPTIONS.items() if name in signature.parameters} | dict(names or {})
    options_of = _option_names(signature, names)
    group_of = {
        name: Group(title, sort_key=place)
        for place, (title, members) in enumerate((groups or {}).items())
        for name in members.split()
    }
    switches = {name: inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False) for name in own}
    shown = []
    for one in (dict(signature.parameters) | switches).values():
        if one.name in own:
            kind: Any = Annotated[bool, Parameter(negative="", help=own[one.name])]
        elif one.name in types:
            kind = types[one.name]
        else:
            kind = _typed(str(one.annotation), function)
        if kind is None:
            continue
        if one.name in group_of:
            kind = Annotated[kind, Parameter(group=group_of[one.name])]
        if one.name in names:
            kind = Annotated[kind, Parameter(name=names[one.name])]
        place = one.POSITIONAL_ONLY if one.kind is one.POSITIONAL_OR_KEYWORD else one.kind
        shown.append(one.replace(kind=one.KEYWORD_ONLY if one.name in options else place, annotation=kind))
    shown.sort(key=lambda one: one.kind)

    def of(show: Callable[[Call], object]) -> Callable[..., None]:
        def run(*args: Any, **kwargs: Any) -> None:
            switched = {name: kwargs.pop(name, False) for name in own}
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            gc.freeze()  # all is imported (see ``cli.main``), and stays
            gc.enable()
            try:
                show(Call(function, bound, switched, options_of))
            except (InputError, WorkError) as error:
                error.args = (typed(error, options_of),)
                error.argument = error.remedy = ""
                raise

        run.__name__ = function.__name__
        run.__doc__ = _help(function, show, options_of)
        run.__signature__ = inspect.Signature(shown)  # type: ignore[attr-defined]
        run.__annotations__ = {one.name: one.annotation for one in shown}
        return run

    return of


def _option_names(signature: inspect.Signature, names: Mapping[str, str | Sequence[str]]) -> dict[str, str]:
    """The option of every argument, and of every other name that an option has."""
    options = {name: f"--{name.replace('_', '-')}" for name in signature.parameters}
    for name, given in names.items():
        first, *others = [given] if isinstance(given, str) else given
        options[name] = first
        options |= dict.fromkeys((other.strip("-") for other in others), first)
    return options


def _help(function: Callable[..., Any], show: Callable[[Call], object], options: Mapping[str, str]) -> str:
    """The docstring of a function with options in place of arguments and examples of the command in place of Python."""
    doc = inspect.getdoc(function) or ""
    doc = re.sub(r"```python\n.*?```\n", f"{inspect.getdoc(show) or ''}\n", doc, flags=re.DOTALL)
    doc = re.sub(r"\s+In Python\b.*?(?=\n+\s*\w+: |\n\n|$)", "", doc, flags=re.DOTALL)
    return re.sub(r"``(\w+)``", lambda word: options.get(word[1], word[0]), doc)


def _typed(annotation: str, function: Callable[..., Any]) -> Any:
    """The part of an annotation that words can give, e.g. the path of a path, a text or a table; None where they cannot
    give any."""
    parts = list[Any]()
    left = [ast.parse(annotation, mode="eval").body]
    while left:
        node = left.pop()
        if isinstance(node, ast.BinOp):
            left += [node.right, node.left]
            continue
        try:
            part = eval(ast.unparse(node), function.__globals__)
        except NameError:  # imported for type checkers only
            continue
        parts += get_args(part) if isinstance(part, UnionType) else [part]
    given = [part for part in parts if part is bool or get_origin(part) in (Literal, Sequence)]
    given = given or [kind for kind in (Path, str, float, int) if kind in parts][:1]
    if not given:
        return None
    if given == [bool]:
        return Flag
    if given == [Sequence[str]]:
        return Annotated[Sequence[str], Parameter(negative="")]
    return reduce(or_, given + [NoneType] * (None in parts))
