"""The Gaussian person model that templates are compared with."""

from types import SimpleNamespace

import numpy as np
import pytest

from planview.tracking.harville import TemplateTracker
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.templates import gaussian_model
from tests.unit.planview.tracking.overhead import observe


def test_gaussian_person_is_as_tall_and_shows_as_much_as_its_templates() -> None:
    occupancy = np.full((9, 9), 0.02, np.float32)
    person = SimpleNamespace(template_height=occupancy, template_occupancy=occupancy, height_m=1.8)
    tall, shown = gaussian_model(person, width_m=0.4, cell_m=0.1)  # type: ignore[arg-type]
    assert tall[4, 4] == tall[4, 6] == np.float32(1.8)
    assert tall[4, 7] == 0.0
    assert shown.sum() == pytest.approx(81 * 0.02)
    assert shown[4, 6] / shown[4, 4] == pytest.approx(np.exp(-0.5))


def test_tracker_follows_a_walker_as_a_gaussian() -> None:
    tracker = TemplateTracker(TemplateTrackerParams(person_model="gaussian"))
    for i, x in enumerate(np.linspace(-1.0, 1.0, 20)):
        tracks = tracker.update(observe(i, [(x, 0.3, 1.75)]))
    (track,) = tracks
    assert (track.track_id, track.state) == (1, "confirmed")
    assert (track.x_m, track.y_m) == pytest.approx((1.0, 0.3), abs=0.06)
