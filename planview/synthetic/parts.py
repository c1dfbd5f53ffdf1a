"""A person's part in a drawn scene, written step by step with the time that it takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.types import F64
from planview.synthetic.furniture import furniture_size
from planview.synthetic.setting import Furniture
from planview.synthetic.stage import NoPlaceError, Stage

SEAT_AHEAD_M = 0.8
"""People come to this point in front of a seat before they sit down [m]."""


class Part:
    """Steps of one person, who comes through an opening.

    Attributes:
        time_s: when the steps so far are done.
        place: (2,) where the person then is.
    """

    def __init__(self, stage: Stage, enter_s: float, side: str | None = None, speed_mps: float = 1.1) -> None:
        self.stage, self.enter_s, self.speed_mps = stage, enter_s, speed_mps
        self.side = side or stage.side()
        self.hidden, self.behind, self.inside = stage.door(self.side)
        self.start, self.place, self.time_s = self.hidden, self.hidden, enter_s
        self.steps: list[dict[str, Any]] = []
        self.wander: dict[str, Any] | None = None
        self.leaves = False
        self.go([self.behind, self.inside])

    def go(self, points: list[F64], speed_mps: float | None = None, **values: Any) -> None:
        """Straight through points."""
        speed = speed_mps or self.speed_mps
        self.steps.append({"go": [_pair(p) for p in points], "speed_mps": float(speed), **values})
        for point in points:
            self.time_s += float(np.linalg.norm(point - self.place)) / speed
            self.place = np.asarray(point, np.float64)

    def walk_to(self, point: F64, **values: Any) -> None:
        """Around obstacles to a point."""
        self.go(self.stage.route(self.place, point), **values)

    def leave(self, side: str | None = None) -> None:
        """Walk out of an opening (the person's own when none is named) and be gone."""
        if side is not None and side != self.side:
            self.hidden, self.behind, self.inside = self.stage.door(side)
        self.walk_to(self.inside)
        self.go([self.behind, self.hidden])
        self.leaves = True

    def go_out_and_in(self, pause_s: float) -> None:
        """Out of the opening, wait, and come back in."""
        self.walk_to(self.inside)
        self.go([self.behind, self.hidden])
        self.do("stand", pause_s)
        self.go([self.behind, self.inside])

    def do(self, action: str, seconds: float, face: float | None = None) -> None:
        """Stand, bend, reach, crouch or sit on the floor for a time, facing a direction [rad]."""
        step: dict[str, Any] = {f"{action}_s": float(seconds)}
        if face is not None:
            step["face_deg"] = float(np.rad2deg(face))
        self.steps.append(step)
        self.time_s += seconds

    def until(self, time_s: float, face: float | None = None) -> None:
        """Stand until a time.

        Raises:
            NoPlaceError: it is past already.
        """
        if time_s < self.time_s - 0.2:
            raise NoPlaceError(f"late by {self.time_s - time_s:.1f} s")
        step: dict[str, Any] = {"until_s": float(time_s)}
        if face is not None:
            step["face_deg"] = float(np.rad2deg(face))
        self.steps.append(step)
        self.time_s = max(time_s, self.time_s)

    def take_seat(self, seat: Furniture, seconds: float) -> None:
        """Come to the front of a seat, sit down, and stand up again."""
        front = np.deg2rad(seat.heading_deg)
        ahead = np.array([np.cos(front), np.sin(front)])
        self.walk_to(np.array(seat.at_m) + max(SEAT_AHEAD_M, furniture_size(seat)[0] / 2 + 0.4) * ahead)
        self.steps.append({"sit_s": float(seconds), "on": seat.name})
        self.time_s += seconds + 2.0
        self.place = np.array(seat.at_m) + 0.32 * ahead

    def cartwheel(self, point: F64) -> None:
        """Turn a cartwheel to a point."""
        self.steps.append({"cartwheel": _pair(point)})
        self.time_s += 1.6 + float(np.linalg.norm(point - self.place)) / 1.3
        self.place = np.asarray(point, np.float64)

    def to_table(self) -> dict[str, Any]:
        """Movement of the person, as a table of ``[[people]]``."""
        inward = self.inside - self.behind
        table: dict[str, Any] = {
            "start_m": _pair(self.start),
            "enter_s": float(self.enter_s),
            "face_deg": float(np.rad2deg(np.arctan2(inward[1], inward[0]))),
            "steps": self.steps,
            "leaves": self.leaves,
        }
        return table if self.wander is None else table | {"wander": self.wander}


def _pair(point: F64) -> tuple[float, float]:
    return float(point[0]), float(point[1])
