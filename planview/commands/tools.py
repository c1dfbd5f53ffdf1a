"""``planview params`` and ``synth``: the parameters of a run in words, and a scene rendered as a recording."""

from __future__ import annotations

import json
import re
import sys
from textwrap import fill

from calib.params import LARGEST, Described, tables_of
from planview.api import tools as api
from planview.api.result import aligned
from planview.commands.shell import JSON, QUIET, Call, command
from planview.engine.config import Config


@command(api.params, own=JSON)
def params(call: Call) -> None:
    """Example: planview params

    Example of those about the floor: planview params floor

    Example of one: planview params joint.stay_s

    Example of what a scene of planview synth may hold: planview params --all synthetic.scene
    """
    found = call()
    if call.prints_json({field.name: {**field._asdict(), "unit": unit_of(field)} for field in found}):
        return
    if len(found) == 1:
        only = found[0]
        bounds = f" ({only.range})" if only.range else ""
        print(f"{only.name} = {only.default or 'required'}{bounds}\n{fill(only.meaning, 100)}")
    elif not sys.stdout.isatty():  # a line each, for grep and awk
        for field in found:
            print(field.name, field.default or "required", unit_of(field), field.sentence, sep="\t")
    else:
        rows = [(field.name, field.default or "required", field.range, field.sentence) for field in found]
        print(aligned([("name", "default", "range", "meaning"), *rows]))


def unit_of(field: Described) -> str:
    """In which its value is, as its meaning has it in brackets, else its name; empty for plain numbers."""
    found = re.search(r"\[([^\]\d][^\]]*)\]", field.meaning)
    return found[1] if found else next((unit[1:] for unit in LARGEST if field.name.endswith(unit)), "")


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


@command(api.synth, own=JSON | QUIET)
def synth(call: Call) -> None:
    """Example: planview synth data/synthetic/crossing.toml /tmp/crossing --frames 150"""
    call.says()
