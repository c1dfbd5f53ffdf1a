"""``rules.toml``: the tripwires, zones and queues to count, and the camera that places them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from pydantic import AfterValidator, Field, ValidationError

from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.formats import load_rig
from calib.formats.one_camera import load_one_camera
from calib.io import load_toml
from calib.params import Location, Params, dotted_name, first_problem
from calib.people.model import ADULT_HEIGHT_M
from calib.types import F64
from calib.world import load_world
from planview.counting.events import Direction
from planview.trajectories.table import PERSON_S, Trajectories
from stereo.rectify import RectifyParams, ideal_pinhole

PlaneName = Literal["floor", "image"]


class RulePlane:
    """The plane in which rules are applied: the floor; the image for rules in pixels of a camera that is not known.
    ``image_size``: (width, height) [px] where only that is known; ``has_floor``: tracks have places in metres."""

    def __init__(
        self, camera: FloorCamera | None = None, image_size: tuple[int, int] | None = None, has_floor: bool = True
    ) -> None:
        self.camera = camera
        self.has_floor = has_floor
        self.image_size = camera.size if camera is not None else image_size

    def place(self, points: F64, *, in_pixels: bool, what: str) -> tuple[PlaneName, F64]:
        """The plane and the points in it. Pixels go to the floor when the camera is known, where the line between them
        is straight. Raises InputError: outside the view, above the horizon, fractions of the image, or metres where
        nobody has a place on the floor."""
        if in_pixels and (points >= 0).all() and points.max() <= 1:
            raise InputError(f"{what}: expected pixels, found fractions of the image, up to {points.max():g}")
        if not in_pixels and not self.has_floor:
            raise InputError(
                f"{what}: expected pixels (from_px, polygon_px), since a camera without a calibration has no metres"
            )
        outline = _along(points)
        if in_pixels:
            self._require_in_view(points, outline, what)
        elif self.camera is not None:
            pixels = self.camera.project(np.column_stack([outline, np.zeros(len(outline))]))
            self._require_in_view(points, pixels, what, self.camera.back_project(self._raster()))
        if self.camera is None or not in_pixels:
            return "image" if in_pixels else "floor", points
        on_floor = self.camera.back_project(points)
        if not np.isfinite(on_floor).all():
            bad = tuple(points[~np.isfinite(on_floor).all(axis=1)][0].tolist())
            raise InputError(f"{what}: expected pixels that show the floor, found {bad} above the horizon")
        return "floor", on_floor

    def beyond_border(self, line: F64) -> F64:
        """A line (2, 2) whose ends at the border are moved on by the image's larger side, where the feet of people are
        whom the border cuts."""
        if self.image_size is None:
            return line
        length = float(np.hypot(*(line[1] - line[0])))
        last = np.array(self.image_size) - 1.0
        inside = np.minimum(line, last - line).min(axis=1)
        ahead = (line[1] - line[0]) / length * max(self.image_size)
        return np.asarray(line + (inside <= 1.0)[:, None] * np.stack([-ahead, ahead]))

    def _require_in_view(self, points: F64, outline_px: F64, what: str, raster: F64 | None = None) -> None:
        """Raise unless part of the outline is in the image, or a zone surrounds some of what the image shows."""
        if self.image_size is None:
            return
        width, height = self.image_size
        if ((outline_px >= -0.5) & (outline_px <= np.array(self.image_size) - 0.5)).all(axis=1).any():
            return
        visible = self._raster() if raster is None else raster[np.isfinite(raster).all(axis=1)]
        if len(points) > 2 and (Outline(points).depth(*visible.T) > 0).any():
            return
        raise InputError(f"{what}: expected a place inside the view of {width}x{height} pixels, found all outside")

    def _raster(self) -> F64:
        """(64, 2) pixels spread over the image."""
        width, height = self.image_size or (0, 0)
        u, v = np.meshgrid(np.linspace(0, width - 1, 8), np.linspace(0, height - 1, 8))
        return np.column_stack([u.ravel(), v.ravel()])


def _along(points: F64) -> F64:
    """65 points on each side of the closed outline, which are tested for being in view."""
    share = np.linspace(0.0, 1.0, 65)[:, None]
    sides = zip(points, np.roll(points, -1, axis=0), strict=True)
    return np.concatenate([start + share * (end - start) for start, end in sides])


class Outline:
    """An (N, 2) polygon, for asking about points."""

    def __init__(self, polygon: F64) -> None:
        self._area = shapely.Polygon(polygon)

    def depth(self, x: F64, y: F64) -> F64:
        """Distance of points (of any shape) to the outline: positive inside, negative outside, NaN for NaN."""
        away = np.where(np.isfinite(x + y), shapely.distance(self._area.exterior, shapely.points(x, y)), np.nan)
        return np.where(shapely.contains_xy(self._area, x, y), away, -away)

    def inner_radius(self) -> float:
        """Radius of the largest circle inside, within a hundredth of the polygon's size."""
        left, low, right, high = self._area.bounds
        return float(shapely.maximum_inscribed_circle(self._area, max(right - left, high - low) / 100).length)


def problem_of(polygon: F64) -> str:
    """The fault of an (N, 2) polygon, in words that end "found ..."; empty where there is none."""
    shape = shapely.Polygon(polygon)
    if shapely.convex_hull(shape).area < 1e-6:
        return "points on a line"
    if not shape.is_valid:
        return "edges that cross or touch at " + str(shapely.is_valid_reason(shape)).partition("[")[2].rstrip("]")
    return ""


def plane_of(camera: Path | None, rig: Path | None) -> RulePlane | None:
    """The plane of a camera above the floor, or of a rig with a world.toml in its folder; None of neither. Raises
    InputError: both, or a file that cannot be read."""
    if camera and rig:
        raise InputError("a camera and a rig cannot be combined")
    if camera:
        return RulePlane(load_one_camera(camera))
    return _stereo_plane(rig) if rig else None


def _stereo_plane(rig_path: Path) -> RulePlane:
    rig = load_rig(rig_path)
    world = (rig_path if rig_path.is_dir() else rig_path.parent) / "world.toml"
    if not world.is_file():
        raise InputError(f"{world}: expected the pose of the rig above the floor (calibrate it first), found no file")
    rotation = rig.rectifying_rotations()[0]
    params = RectifyParams()
    geometry = ideal_pinhole(rig.left, rotation, params.working_px, params.field_quantile, rig.baseline_m)
    return RulePlane(geometry.above(load_world(world).world_SE3_left))


NEAR_HEIGHTS = 3.0
"""Heights of a person within which a rule is near to tracks that are all in one place."""


class AnalyticsParams(Params):
    """Tripwires and zones."""

    hysteresis_m: float = Field(0.25, ge=0, le=5)
    """Distance beyond a line at which a person must be observed, on both sides, for a crossing [m]. Half a shoulder's
    breadth, so that the body is across; more than twice the position noise of a good tracker."""
    zone_hysteresis_m: float = Field(0.15, ge=0, le=5)
    """Depth inside or outside a zone at which a person must be observed to enter or leave it [m]. A little more
    than the position noise of a tracker. Smaller than for a line: a crossing counted wrongly stays counted, occupancy
    is right again with the next step, and a person walking along the outline is inside all the same."""
    min_age_s: float = Field(PERSON_S, ge=0, le=60)
    """People confirmed for less do not count yet; once they do, what they did before counts too [s]. By default
    what makes a track a person everywhere (``people_of``)."""
    stitch_s: float = Field(2.0, ge=0, le=60)
    """A track that begins within this time of another one's end, where that one was heading, is the same person [s].
    Trackers re-attach by themselves over longer times (Harville 2002: 4 s), so this only bridges what they
    do not, and two people through the same door are farther apart."""
    stitch_m: float = Field(0.6, ge=0, le=5)
    """Distance to the predicted place up to which it is [m]: what a person who stops, or turns, walks in half a
    second."""
    interval_s: float = Field(60.0, gt=0, le=86400)
    """Length of the intervals of the totals [s]."""


def _plain_name(name: str) -> str:
    """Names are cells of events.csv, which spreadsheets open: one that begins like a formula is refused."""
    if name[0] in "=+-@" or not name.isprintable():
        raise ValueError(f"expected a name of printable characters that begins with none of = + - @, found {name!r}")
    return name


_Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_plain_name)]
_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e5, le=1e5)]
_PointIn = tuple[_Number, _Number]
MAX_RULES = 200
"""Rules of one kind."""
# Corners of a zone: each pair of edges is tried for crossing, and each person against each edge.
_Polygon = Annotated[list[_PointIn], Field(max_length=500)]


class _NamedRule(Params):
    name: _Name


class _PlacedRule(_NamedRule):
    hysteresis_m: float | None = Field(None, ge=0, le=5)
    """Instead of the parameter of the same name."""
    min_age_s: float | None = Field(None, ge=0, le=60)
    """Instead of the parameter of the same name."""


class Tripwire(_PlacedRule):
    """A line that people cross, from its first to its second point, on the floor [m] or in the image [px]."""

    from_m: _PointIn | None = None
    to_m: _PointIn | None = None
    from_px: _PointIn | None = None
    to_px: _PointIn | None = None
    inward: Literal["left_to_right", "right_to_left"] | None = None
    """The direction that the totals also call ``in``; the other one is ``out``."""


class Zone(_PlacedRule):
    """An area that people are in; the polygon is closed by itself."""

    polygon_m: _Polygon | None = None
    polygon_px: _Polygon | None = None


class Queue(_NamedRule):
    """People waiting in a zone."""

    zone: _Name
    """Name of the zone."""
    min_wait_s: float = Field(5.0, ge=0, le=3600)
    """A shorter stay in the zone is passing through and not waiting [s]. A zone of a queue's usual 4 m
    is crossed in 3 s at walking pace."""


class _File(Params):
    tripwire: list[Tripwire] = Field(default_factory=list, max_length=MAX_RULES)
    zone: list[Zone] = Field(default_factory=list, max_length=MAX_RULES)
    queue: list[Queue] = Field(default_factory=list, max_length=MAX_RULES)


@dataclass(frozen=True, eq=False)
class Placed:
    """A line (2, 2) or polygon (N, 2) in the plane in which it is applied; ``counted``: the line beyond the border of
    the image (``RulePlane.beyond_border``), where it differs."""

    name: str
    plane: PlaneName
    points: F64
    hysteresis_m: float | None = None
    min_age_s: float | None = None
    inward: Direction = ""
    counted: F64 | None = None


@dataclass(frozen=True, eq=False)
class Rules:
    """Checked rules."""

    tripwires: tuple[Placed, ...]
    zones: tuple[Placed, ...]
    queues: tuple[Queue, ...]
    source: str

    def __repr__(self) -> str:
        return f"Rules({', '.join(self.names)})"

    @property
    def names(self) -> list[str]:
        return [rule.name for rule in self.tripwires + self.zones] + [queue.name for queue in self.queues]

    @property
    def unknown_size_note(self) -> str:
        """A sentence where lines in pixels may end at the image's border, whose place is not known; empty elsewhere."""
        names = [wire.name for wire in self.tripwires if wire.plane == "image" and wire.counted is None]
        if not names:
            return ""
        return (
            f"{self.source}: the size of the images is not known, so the line {names[0]!r} ends at its end points: "
            "people whose feet the border of the image cuts off do not cross it"
        )

    def far_rule_note(self, tracks: Trajectories) -> str:
        """A sentence on rules of which no track comes within the size of the place that all tracks cover; empty where
        there are none."""
        left, top, width, height = tracks.box_px.T
        for rule in self.tripwires + self.zones:
            places = np.column_stack([left + width / 2, top + height])
            tall = height
            unit = "px"
            if rule.plane == "floor":
                places = np.column_stack([tracks.x_m, tracks.y_m])
                tall = np.full(len(tracks), ADULT_HEIGHT_M)
                unit = "m"
            has_place = np.isfinite(places).all(axis=1)
            if not has_place.any():
                continue
            low = places[has_place].min(axis=0)
            high = places[has_place].max(axis=0)
            before = rule.points.min(axis=0) - high
            beyond = low - rule.points.max(axis=0)
            away = float(np.hypot(*np.maximum(before, beyond).clip(min=0)))
            size = float(np.hypot(*(high - low)))
            if away > max(size, NEAR_HEIGHTS * float(np.median(tall[has_place]))):
                return (
                    f"{self.source}: no track comes within {away:.0f} {unit} of rule {rule.name!r}: another unit, "
                    "swapped axes, or another origin"
                )
        return ""

    def of_truth(self, zone_hysteresis_m: float) -> Rules:
        """The same places for true positions: no age to reach, zones with a hysteresis of their own."""
        wires = tuple(replace(wire, min_age_s=0.0) for wire in self.tripwires)
        zones = tuple(replace(zone, hysteresis_m=zone_hysteresis_m, min_age_s=0.0) for zone in self.zones)
        return replace(self, tripwires=wires, zones=zones)


def load_rules(rules: Mapping[str, Any] | Path | str, plane: RulePlane | None = None) -> Rules:
    """Read ``rules.toml``, or tables as it has them; pixels stay pixels without a camera. Raises InputError:
    unreadable, empty, a key or value that does not belong, duplicate names, a line of zero length or outside the view,
    a polygon that crosses itself or has no area, a queue of an unknown zone."""
    if isinstance(rules, Mapping):
        return parse_rules(rules, plane or RulePlane(), "rules=")
    return parse_rules(load_toml(Path(rules), "a rules.toml"), plane or RulePlane(), str(rules))


def parse_rules(data: Mapping[str, Any], plane: RulePlane, source: str) -> Rules:
    """Rules from the content of a rules.toml (same errors as ``load_rules``)."""
    if not data:
        raise InputError(f"{source}: expected at least one [[tripwire]] or [[zone]], found an empty file")
    data = {name: [rules] if isinstance(rules, dict) else rules for name, rules in data.items()}
    unknown = set(data) - set(_File.model_fields)
    if unknown:
        raise InputError(f"{source}: expected tables named tripwire, zone or queue, found {min(unknown)!r}")
    try:
        file = _File.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{source}: {first_problem(error, partial(_name_of, data))}") from error
    if not file.tripwire and not file.zone:
        raise InputError(f"{source}: expected at least one [[tripwire]] or [[zone]], found none")
    names = [rule.name for rule in (*file.tripwire, *file.zone, *file.queue)]
    zones = [zone.name for zone in file.zone]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise InputError(f"{source}: expected every rule to have a name of its own, found {name!r} twice")
    for queue in file.queue:
        if queue.zone not in zones:
            raise InputError(
                f"{source}: expected queue {queue.name!r} to name one of the zones "
                f"({', '.join(zones) or 'there are none'}), found {queue.zone!r}"
            )
    return Rules(
        tuple(_wire(rule, plane, source) for rule in file.tripwire),
        tuple(_zone(rule, plane, source) for rule in file.zone),
        tuple(file.queue),
        source,
    )


def _name_of(data: dict[str, Any], location: Location) -> str:
    """``from_m in tripwire 'door'`` for a value of a rule; a rule without a name is counted from 1."""
    table, *rest = location
    if not rest:
        return str(table)
    number, *keys = rest
    try:
        rule = f"{table} {data[str(table)][int(number)]['name']!r}"
    except (LookupError, TypeError, ValueError):
        rule = f"{table} number {int(number) + 1}" if isinstance(number, int) else str(table)
    return f"{dotted_name(tuple(keys))} in {rule}" if keys else rule


def _wire(rule: Tripwire, plane: RulePlane, source: str) -> Placed:
    metres = (rule.from_m, rule.to_m)
    pixels = (rule.from_px, rule.to_px)
    given = [pair for pair in (metres, pixels) if pair != (None, None)]
    if len(given) != 1 or None in given[0]:
        raise InputError(
            f"{source}: expected from_m and to_m, or from_px and to_px, in tripwire {rule.name!r}, "
            f"found {', '.join(sorted(rule.model_fields_set - {'name'})) or 'neither'}"
        )
    points = np.array(given[0], dtype=np.float64)
    if np.hypot(*(points[1] - points[0])) < (1e-6 if given[0] is metres else 1e-3):
        raise InputError(
            f"{source}: expected two different points in tripwire {rule.name!r}, found a line of zero length "
            f"at {given[0][0]}"
        )
    where, points = plane.place(points, in_pixels=given[0] is pixels, what=f"{source}: tripwire {rule.name!r}")
    counted = plane.beyond_border(points) if where == "image" and plane.image_size is not None else None
    return Placed(rule.name, where, points, rule.hysteresis_m, rule.min_age_s, rule.inward or "", counted)


def _zone(rule: Zone, plane: RulePlane, source: str) -> Placed:
    if (rule.polygon_m is None) == (rule.polygon_px is None):
        given = "neither" if rule.polygon_m is None else "both"
        raise InputError(f"{source}: expected polygon_m or polygon_px in zone {rule.name!r}, found {given}")
    points = np.array(rule.polygon_m or rule.polygon_px or [], dtype=np.float64).reshape(-1, 2)
    if len(points) > 3 and (points[0] == points[-1]).all():
        points = points[:-1]
    if len(points) < 3:
        raise InputError(f"{source}: expected at least 3 points in zone {rule.name!r}, found {len(points)}")
    problem = problem_of(points)
    if problem:
        raise InputError(
            f"{source}: expected a polygon that does not cross itself in zone {rule.name!r}, found {problem}"
        )
    where, points = plane.place(points, in_pixels=rule.polygon_px is not None, what=f"{source}: zone {rule.name!r}")
    return Placed(rule.name, where, points, rule.hysteresis_m, rule.min_age_s)
