"""Parameter spaces, and the configurations drawn from them."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import model_validator

from calib.errors import InputError
from calib.params import Params

COMBINATIONS_MAX = 1_000_000


class Range(Params):
    """Numbers from min to max; whole ones where all of min, max and step are."""

    min: int | float
    max: int | float
    step: int | float | None = None
    """Only min, min + step, ...; not together with log."""
    log: bool = False
    """Drawn evenly in the logarithm."""

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if not self.min < self.max:
            raise ValueError(f"expected min below max, found {self.min} and {self.max}")
        if self.step is not None and (self.log or self.step <= 0):
            raise ValueError(f"expected a step above 0 and without log, found {self.step}")
        if self.log and self.min <= 0:
            raise ValueError(f"expected min above 0 with log, found {self.min}")
        return self

    @property
    def whole(self) -> bool:
        """Whether all values are whole numbers."""
        return all(isinstance(value, int) for value in (self.min, self.max, self.step or 1))

    def at(self, fraction: float) -> int | float:
        """The value a fraction (0 to below 1) of the way through the range."""
        if self.step is not None:
            count = int((self.max - self.min) / self.step + 1e-9) + 1
            return self.min + self.step * int(fraction * count)
        low, high = (math.log(self.min), math.log(self.max)) if self.log else (self.min, self.max)
        if not self.whole:
            value = low + fraction * (high - low)
            return float(f"{math.exp(value) if self.log else value:.6g}")
        if self.log:
            return min(self.max, round(math.exp(low + fraction * (high - low))))
        return int(self.min + math.floor(fraction * (self.max - self.min + 1)))


Choices = list[Any]
Space = Choices | Range


@dataclass(frozen=True)
class Configuration:
    """Values of the varied parameters, as texts like ``template.range_m=0.4`` in the order of the study."""

    settings: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """All settings in one line."""
        return " ".join(self.settings) or "defaults"

    def value(self, name: str) -> str:
        """The text of a parameter's value; empty where it is not varied."""
        return next((s.partition("=")[2] for s in self.settings if s.partition("=")[0] == name), "")


def configuration(values: Mapping[str, Any]) -> Configuration:
    """Of parameter values, numbers, texts, truth values or lists of these."""
    return Configuration(tuple(f"{name}={json.dumps(value)}" for name, value in values.items()))


def grid(parameters: Mapping[str, Space]) -> list[Configuration]:
    """All combinations, the last parameter fastest; one without settings where there are no parameters.

    Raises:
        InputError: a range without step, or too many.
    """
    values = [_listed(name, space) for name, space in parameters.items()]
    count = math.prod(len(v) for v in values)
    if not 0 < count <= COMBINATIONS_MAX:
        raise InputError(f"expected 1 to {COMBINATIONS_MAX} combinations of parameters, found {count}")
    return [configuration(dict(zip(parameters, chosen, strict=True))) for chosen in itertools.product(*values)]


def random_draws(parameters: Mapping[str, Space], count: int, seed: int) -> list[Configuration]:
    """So many independent draws, each once; fewer where the space holds fewer."""
    generator = np.random.default_rng(seed)
    drawn: dict[Configuration, None] = {}
    for _ in range(20 * count):
        values = {name: _drawn(space, float(generator.random())) for name, space in parameters.items()}
        drawn[configuration(values)] = None
        if len(drawn) == count:
            break
    return list(drawn)


def _drawn(space: Space, fraction: float) -> Any:
    return space.at(fraction) if isinstance(space, Range) else space[int(fraction * len(space))]


def _listed(name: str, space: Space) -> list[Any]:
    if isinstance(space, list):
        return space
    if space.step is None:
        raise InputError(f"parameters.{name}: expected a list or a step for a grid, found a range without step")
    count = int((space.max - space.min) / space.step + 1e-9) + 1
    return [float(f"{value:.9g}") if isinstance(value, float) else value for value in
            (space.min + space.step * i for i in range(min(count, COMBINATIONS_MAX + 1)))]  # fmt: skip
