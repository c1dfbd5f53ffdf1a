"""Eight people close to the camera, who fill its view: the worst case of an engine whose time follows people."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.accuracy import RenderOptions, cache_folder, rendered
from planview.synthetic.assets import SCENES
from planview.synthetic.scene import Scene, load_scene

FRAMES = 170
"""Nobody enters in the first 75; in the last 60 all eight are near."""
ENTER_S, CAMERA_Y_M = 5.0, 3.4
AREA_M = (2.6, 5.0, 5.9, 6.9)
"""Floor on which they wander: 1.6 to 3.5 m before the camera."""


def near_people() -> Scene:
    """The committed scene of eight, with the camera amid the hall and everyone coming from behind it."""
    scene = load_scene(SCENES / "eight.toml")
    people = []
    for i, person in enumerate(scene.people):
        x = 2.4 + 0.52 * i
        steps = [{"go": [[x, CAMERA_Y_M + 1.8]], "speed_mps": 1.4}]
        wander = {"area_m": AREA_M, "speed_mps": (0.7, 1.2), "pause_s": (0.0, 0.5)}
        moved = {"start_m": [x, CAMERA_Y_M - 0.2 - 0.5 * (i % 2)], "enter_s": ENTER_S, "steps": steps, "wander": wander}
        people.append(person.model_dump() | {"face_deg": 90.0} | moved)
    rig = scene.model_dump()["rig"] | {"at_m": (4.25, CAMERA_Y_M, 3.0)}
    tables = scene.model_dump() | {"people": people, "rig": rig, "furniture": [], "duration_s": FRAMES / scene.fps}
    return Scene.model_validate(tables | {"description": "Eight people close to the camera."})


def near_recording(progress: Callable[[str], None]) -> Path:
    """It as a recording, rendered once into the user's cache (errors of ``rendered``)."""
    return rendered(near_people(), "near-people", RenderOptions(cache_folder()), progress)
