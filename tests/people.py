"""Samples of people that a known camera sees."""

import numpy as np

from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.people.samples import HumanSample


def standing_people(camera: GroundCamera, count: int, seed: int = 0, noise_px: float = 0.0) -> list[HumanSample]:
    """People of the paper's size at random places where the whole of them is in the image."""
    rng, model = np.random.default_rng(seed), HumanModel()
    people = []
    while len(people) < count:
        xy = camera.back_project(rng.uniform((0, 0), (camera.width, camera.height)))
        if not np.isfinite(xy).all() or np.hypot(*xy) > 25:
            continue
        left, top, width, height = model.boxes(camera, xy)
        right, bottom = left + width, top + height
        if not (left > 0 and top > 0 and right < camera.width and bottom < camera.height and height > 25):
            continue
        ends = [left, top, right, bottom, *model.head(camera, xy), *model.foot(camera, xy)]
        a, b, c, d, hu, hv, fu, fv = np.array(ends) + rng.normal(0, noise_px, 8)
        people.append(HumanSample((a, b, c - a, d - b), (hu, hv), (fu, fv)))
    return people
