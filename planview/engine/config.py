"""The whole configuration: a table per stage, from one TOML file and single values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from calib.errors import InputError
from calib.floor.plane import FloorParams
from calib.io import MAX_DEPTH, load_toml, parse_toml
from calib.params import Params, dotted_name, first_problem, tables_of
from planview.foreground.params import ForegroundParams
from planview.maps.grid import MapParams
from planview.tracking.detections import DetectionParams
from planview.tracking.ellipse_particle.tracker import EllipseParticleParams
from planview.tracking.human_model.explanation import HumanModelParams
from planview.tracking.joint.ranges import JointParams
from planview.tracking.template import TemplateParams
from stereo.floor import SETUP_FRAMES
from stereo.matcher import RangeParams, SgbmParams
from stereo.rectify import RectifyParams


class AnalysisParams(Params):
    """Size of the images behind the disparity."""

    width_px: int = Field(400, ge=80, le=8192)
    """Foreground and maps use every n-th row and column, n the smallest that brings the width down to this [px].
    Harville 2002, section 5, ran at 320x240; a head at 8 m is then still 5 px wide."""
    setup_frames: int = Field(SETUP_FRAMES, ge=3, le=500)
    """Frames, spread over the recording, in which floor and rig are measured (our choice)."""


class FeedbackParams(Params):
    """Feedback from tracker to foreground; our choices, the paper gives only the idea."""

    enabled: bool = True
    """Give feedback at all."""
    spread_px: int = Field(5, ge=0, le=50)
    """Margin added around a person's pixels for the next frame [px]."""


class SingleCameraParams(Params):
    """Foreground and motion of one camera (Zhang et al. 2008, section 2)."""

    foreground: ForegroundParams = ForegroundParams.model_validate(
        {"remove_colour_shadows": True, "shadow_ratio": 0.5, "luma_noise": 3.0, "chroma_noise": 1.8}
    )
    """The mixture model, here without depth: shadows are removed by their colour, at most twice as dark as the ground
    (as OpenCV's MOG2 has it), since dark clothes are like deeper shadows. The least noise is that of the sensor alone:
    where colours are all there is, clothes like the wall behind must differ from it, and noise above is learned."""


class Config(Params):
    """Every parameter that tracks depend on."""

    seed: int = Field(0, ge=0, lt=2**63)
    """Seed of every random generator."""
    analysis: AnalysisParams = AnalysisParams()
    rectify: RectifyParams = RectifyParams()
    range: RangeParams = RangeParams()
    sgbm: SgbmParams = SgbmParams()
    floor: FloorParams = FloorParams()
    foreground: ForegroundParams = ForegroundParams()
    feedback: FeedbackParams = FeedbackParams()
    maps: MapParams = MapParams()
    joint: JointParams = JointParams()
    template: TemplateParams = TemplateParams()
    single_camera: SingleCameraParams = SingleCameraParams()
    human_model: HumanModelParams = HumanModelParams()
    ellipse_particle: EllipseParticleParams = EllipseParticleParams()
    detections: DetectionParams = DetectionParams()


def load_config(path: Path | str | None = None, overrides: Sequence[str] = (), base: Config | None = None) -> Config:
    """The base (the defaults when None), then the file, then single values like ``foreground.learning_rate=0.002``.
    Raises InputError: an unreadable file, an unknown key, or a value out of range, by name."""
    return _validate(given_tables(path, overrides), "", base, "overrides")


def given_tables(path: Path | str | None, overrides: Sequence[str]) -> dict[str, Any]:
    """The tables of a file, then single values like ``foreground.learning_rate=0.002``. Raises InputError: an
    unreadable file, or one with an unknown key or a value out of range."""
    tables = {} if path is None else load_toml(Path(path), "a TOML configuration")
    _validate(tables, str(path), None)
    for value in overrides:
        _apply(tables, value)
    return tables


def config_of(tables: Mapping[str, Any], source: str = "", argument: str = "", base: Config | None = None) -> Config:
    """A configuration from its tables, as ``run.json`` has them, over the base (the defaults when None). Raises
    InputError: tables of another version; ``source``, a file, or the argument begins the sentence."""
    if not isinstance(tables, Mapping):
        raise InputError(f"expected a table per stage, found {type(tables).__name__}", argument=argument)
    return _validate(dict(tables), source, base, argument)


def _apply(tables: dict[str, Any], setting: str) -> None:
    name, equals, text = setting.partition("=")
    keys = name.strip().split(".")
    if not equals or not all(keys) or len(keys) > MAX_DEPTH:
        raise InputError(f"expected table.key=value, found {setting!r:.80}", argument="overrides")
    try:
        value = parse_toml(f"value = {text}")["value"]
    except ValueError:
        value = text.strip()
    tables[".".join(keys)] = value


def _over(defaults: dict[str, Any], tables: dict[str, Any]) -> dict[str, Any]:
    """The defaults with what the tables set: one key of a stage leaves the stage's others as they are; a key with dots
    is one of a table."""
    both = dict(defaults)
    for name, content in tables.items():
        key, dot, rest = str(name).partition(".")
        value = {rest: content} if dot else content
        nested = isinstance(value, dict) and isinstance(both.get(key), dict)
        both[key] = _over(both[key], value) if nested else value
    return both


def _validate(tables: dict[str, Any], source: str, base: Config | None, argument: str = "") -> Config:
    try:
        return Config.model_validate(_over((base or Config()).model_dump(), tables))
    except ValidationError as error:
        problem = f"{first_problem(error)}{_suggestion(error)}"
        raise InputError(f"{source}: {problem}" if source else problem, argument=argument) from error


def _suggestion(error: ValidationError) -> str:
    """Advice on an unknown name, as the end of its sentence; empty where no known one resembles it."""
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return ""
    names = [f"{table}.{name}".lstrip(".") for table, params in tables_of(Config) for name in params.model_fields]
    unknown = dotted_name(first["loc"])
    near = get_close_matches(unknown, names, n=1, cutoff=0.75)
    near += [name for name in names if name.rpartition(".")[2] == unknown.rpartition(".")[2]]
    return f" (did you mean {near[0]}?)" if near else ""
