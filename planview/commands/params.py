"""``planview params``: the parameters of a run in words."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import reduce
from importlib import import_module
from pkgutil import walk_packages
from textwrap import fill
from typing import Annotated

from cyclopts import Parameter
from rich.table import Column, Table

from calib.errors import InputError
from calib.params import Described, Params, described, tables_of
from planview.commands.options import Flag
from planview.engine.config import Config
from planview.output.progress import PlainConsole


def params(pattern: str = "", /, *, all_: Annotated[Flag, Parameter(name="--all")] = False) -> None:
    """List the parameters of a run, with default, range and meaning; of one alone, also its reason and source.

    Example: planview params

    Example of those about the floor: planview params floor

    Example of one: planview params joint.stay_s

    Example of what a scene of planview synth may hold: planview params --all synthetic.scene

    Parameters
    ----------
    pattern
        Part of a name or of its meaning, or a name with * and ?.
    all_
        Also parameters of evaluation, counting, calibration, studies and rendered scenes, under their class in Python.
    """
    defaults = Config()
    tables = [(name, described(cls, inside(defaults, name))) for name, cls in tables_of(Config)]
    tables += [(name, described(cls)) for name, cls in _other_tables()] if all_ else []
    every = [field._replace(name=f"{table}.{field.name}".lstrip(".")) for table, fields in tables for field in fields]
    found = [field for field in every if field.name == pattern] or [f for f in every if _matches(f, pattern)]
    if not found:
        raise InputError(f"no parameter has {pattern!r} in its name or meaning; planview params lists all")
    console = PlainConsole(soft_wrap=True, highlight=False)
    if len(found) == 1:
        only = found[0]
        bounds = f" ({only.range})" if only.range else ""
        console.print(f"{only.name} = {only.default or 'required'}{bounds}\n{fill(only.meaning, 100)}")
        return
    table = Table(Column("name", no_wrap=True), "default", "range", "meaning", box=None, pad_edge=False)
    for field in found:
        table.add_row(field.name, field.default or "required", field.range, field.sentence)
    PlainConsole(highlight=False).print(table)


def inside(config: Config, table: str) -> Params:
    """A table of a configuration by its dotted name; itself for ""."""
    return reduce(getattr, filter(None, table.split(".")), config)


def _other_tables() -> Iterator[tuple[str, type[Params]]]:
    """Tables that are no part of a run's configuration, by module and class without the package."""
    of_a_run = {cls for _, cls in tables_of(Config)}
    for package in ("calib", "planview"):
        for module in walk_packages(import_module(package).__path__, f"{package}."):
            if not re.search(r"__main__|\.page|commands", module.name):
                for name, value in vars(import_module(module.name)).items():
                    is_table = isinstance(value, type) and issubclass(value, Params) and value is not Params
                    own = is_table and value.__module__ == module.name and not name.startswith("_")
                    if own and value not in of_a_run:
                        yield f"{module.name.removeprefix('planview.')}.{name}", value


def _matches(field: Described, pattern: str) -> bool:
    if any(c in pattern for c in "*?"):
        return fnmatch(field.name, pattern)
    return pattern.lower() in f"{field.name} {field.meaning}".lower()


def config_toml(config: Config) -> str:
    """All parameters as the TOML file that ``--config`` takes; those without a value are comments."""
    lines = []
    for table, _ in tables_of(Config):
        values = config.model_dump()
        for key in filter(None, table.split(".")):
            values = values[key]
        own = {name: value for name, value in values.items() if not isinstance(value, dict)}
        if own:
            lines += [f"\n[{table}]"] if table else []
            lines += [f"# {n} is not set" if v is None else f"{n} = {json.dumps(v)}" for n, v in own.items()]
    return "\n".join(lines)
