"""The likelihood of pixels given people: kernels against numpy, and what explains what."""

import numpy as np
import pytest
from reference.explain import log_likelihood
from toy_people import look_at, oblique_camera

from planview.maps.pixels import SeenPixels
from planview.tracking import body
from planview.tracking.template import _kernels as kernels
from planview.tracking.template.explanation import Explanation, People
from planview.tracking.template.params import TemplateParams

PARAMS = TemplateParams()
ADULT = (0.0, 3.0, 1.75)
TALL = np.array([1.75, 0.12])


def people_of(*poses: tuple[float, float, float]) -> People:
    n = len(poses)
    ratios = np.ones((n, kernels.PARTS, 200), np.float32)
    return People(np.array(poses).reshape(-1, 3), np.ones(n), np.tile(TALL, (n, 1)), ratios)


def explained(seen: SeenPixels) -> Explanation:
    return Explanation((seen,), PARAMS, body.body_table())


@pytest.mark.parametrize("other", [(0.3, 3.8, 1.6), (0.1, 5.4, 1.8)], ids=["in front", "behind"])
def test_evidence_of_a_person_is_the_difference_of_two_likelihoods(other):
    far = (0.0, 4.6, 1.75)
    seen = look_at(oblique_camera(), [far, other])
    every_pixel = TemplateParams(patch_m=0.011)
    dense = Explanation((seen,), every_pixel, body.body_table()).around(np.array(far), 0.4)
    dense.values[: dense.n, kernels.WEIGHT] = 1.0
    dense.layer(people_of(far, other), np.array([1]))
    found = dense.lam(np.array(far), np.ones((3, 200), np.float32))
    # Arms reach as far in both: what lies near one of the two lies near the other.
    without, both = (log_likelihood(seen, people, PARAMS, [other]) for people in ([other], [other, far]))
    assert found == pytest.approx(both - without, rel=0.03)


def test_a_person_where_the_background_is_seen_is_unlikely():
    frame = explained(look_at(oblique_camera(), []))
    samples = frame.around(np.array(ADULT), 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    assert samples.lam(np.array(ADULT), np.ones((3, 200), np.float32)) < -50


def test_a_hidden_person_costs_nothing():
    front = (0.0, 2.4, 1.85)
    frame = explained(look_at(oblique_camera(tilt_deg=85.0), [front]))
    behind = np.array([0.0, 3.1, 1.5])
    samples = frame.around(behind, 0.3)
    samples.layer(people_of(front), np.array([0]))
    assert samples.lam(behind, np.ones((3, 200), np.float32)) > -3


def test_ascent_finds_a_person_from_a_walkers_error_of_prediction():
    frame = explained(look_at(oblique_camera(), [ADULT]))
    start = np.array([0.15, 2.85, 1.62])
    samples = frame.around(start, 0.3)
    samples.layer(people_of(), np.zeros(0, np.int64))
    loose = np.array([1.0, 0.0, 1.0, 1.0])
    samples.ascend(start, start.copy(), loose, TALL, np.zeros((0, 3)), np.ones((3, 200), np.float32))
    assert start == pytest.approx(ADULT, abs=0.05)


def test_bodies_do_not_stand_in_each_other():
    samples = explained(look_at(oblique_camera(), [])).around(np.array(ADULT), 0.3)
    beside = samples.believed(np.array(ADULT), TALL, np.array([[0.0, 3.5, 1.0]]))
    within = samples.believed(np.array(ADULT), TALL, np.array([[0.0, 3.1, 1.0]]))
    assert beside == pytest.approx(0.0, abs=0.01)
    assert within < -8


def test_the_body_table_is_a_head_over_shoulders_over_legs():
    table = body.body_table()
    level = round(-table.angle_min_rad / table.angle_step_rad)

    def width(rel: float) -> float:
        w = int(((rel - 0.5) * body.TORSO.height_m - table.w_min_m) / table.cell_m)
        return 2 * float(table.cover[level, :, w].sum()) * table.cell_m

    assert width(0.92) == pytest.approx(0.18, abs=0.03)
    assert 0.42 < width(0.65) < 0.52
    assert 0.26 < width(0.2) < 0.35  # legs, and the stride that is now and then beside them
    assert width(1.1) < 0.02
