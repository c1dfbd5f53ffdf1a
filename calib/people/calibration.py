"""One camera from standing people, and how well it is known (Zhang et al. 2008, section 3.3).

The whole of what a caller needs: ``found = calibrate_from_people(samples, size, known=KnownValues(field_deg=70))``,
then ``found.camera``, ``found.std`` (deviations), ``found.assessment.enough`` and ``.sentence`` (the verdict in plain
words), ``found.assessment.next_sample.foot_px`` (where the next person should stand in the image; None where no further
person helps) and ``found.odd`` (samples to look at again).

Samples are read in three ways: heads and feet where they are marked, in boxes around the outline or in boxes that end
at head and foot; and heads and feet that are but the middles of the boxes' edges. Each with every lens. The one with
the largest evidence is taken; what the others say enters the deviations by their probability.

The paper's E_bb and weights are illegible in the copy at hand; our choice is E_bb = 1 - IoU of the boxes,
w_hf = D_hf / D_bb (head to foot over the diagonal of the box), w_bb = 1 - w_hf. The person stands where head and foot
together project nearest to the sample's (the paper is silent; our choice).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.errors import WorkError
from calib.ground_camera import LENS_K_320, GroundCamera
from calib.people.assessment import Assessment, CameraDeviations, assess, camera_deviations
from calib.people.model import HumanModel, KnownValues, people_of, prior_of, scaled_model
from calib.people.refine import CameraPosterior, GroundCameraFit, posterior_of, refine, with_outline_errors
from calib.people.samples import HumanSample, People, check_samples, level_ends, only_boxes
from calib.people.search import HumanCalibrationParams, SearchProblem, search, warm_up
from calib.types import F64

ODD_FROM = 3.0
"""A sample whose residuals are this many deviations is odd: not a standing person, or marked wrongly (our choice)."""
MAX_ROLL_RAD = math.radians(7.0)
"""A larger roll is none of a camera, but of wrong samples (our choice: 3.5 deviations of the prior)."""


@dataclass(frozen=True, eq=False)
class HumanCalibration:
    """A camera from people, and how far to trust it.

    Attributes:
        camera: the best one.
        model: the person it was found with.
        error: mean weighted error E = whf Ehf + wbb Ebb over the samples (Zhang 2008).
        sample_errors: (n,) float64 E per sample.
        std: standard deviations of height, tilt, focal length and roll.
        assessment: expected floor error, whether it is enough, and where to add the next sample.
        odd: numbers of the samples that fit badly and were weighted down.
        girth: width of the sampled people against the model's [1].
        stature: mean height of the sampled people against the model's [1], as far as a known camera height tells it.
        boxes_only: whether heads and feet were read as but the middles of the boxes' edges.
        search_s: duration of the search [s].
    """

    camera: GroundCamera
    model: HumanModel
    error: float
    sample_errors: F64
    std: CameraDeviations
    assessment: Assessment
    odd: tuple[int, ...]
    girth: float
    stature: float
    boxes_only: bool
    search_s: float


def calibrate_from_people(
    samples: Sequence[HumanSample],
    size: tuple[int, int],
    lens: str | None = None,
    *,
    known: KnownValues | None = None,
    independent: int | None = None,
    model: HumanModel | None = None,
    params: HumanCalibrationParams | None = None,
    name: str = "samples",
) -> HumanCalibration:
    """The camera whose projected people fit the samples best, its deviations and a verdict.

    A camera that is not known well enough is returned all the same, and its assessment says so; one of which height
    and focal length cannot be told apart at all is refused.

    Args:
        samples: at least 3 people at different places.
        size: (width, height) of the image [px].
        lens: class of table 2; None tries all.
        known: focal length or field of view, camera height, height of the people, as far as known.
        independent: so many of the samples are independent, as of few people observed often, found by outlines of
            foreground; None for all, marked by hand. The others repeat the same body height, gait and shadow, and are
            weighted down.
        model: the person; by default the paper's 1.76 m, or the height known.
        params: of the search.
        name: of the samples' source, for messages.
    Raises:
        InputError: samples from which no camera can be told.
        WorkError: no camera fits them, or too many do.
        ValueError: an unknown lens.
    """
    check_samples(samples, size, name)
    if lens is not None and lens not in LENS_K_320:
        raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {lens!r}")
    known, params = known or KnownValues(), params or HumanCalibrationParams()
    model = scaled_model(model or HumanModel(), known)
    warm_up()
    start = time.perf_counter()
    people = people_of(samples, model, independent)
    tried = _tried([lens] if lens else list(LENS_K_320), size, people, model, known, params)
    # Most samples must fit well; how badly the odd ones fit, which are weighted down, does not matter.
    found = tried[0]
    fits = found.fit.deviations <= ODD_FROM
    error = float(np.median(found.problem.each(found.fit.camera)[fits])) if fits.any() else math.inf
    if error > params.max_error or fits.mean() < 0.5:
        raise WorkError(
            f"{name}: no camera fits the samples: error {error:.2f} (at most {params.max_error:g}), "
            f"{1.0 - fits.mean():.0%} of the samples far off; "
            "are they standing people of one size in upright images of this size?"
        )
    posterior = posterior_of([t.fit for t in tried], people, model)
    if independent is not None:
        posterior = with_outline_errors(posterior, people, model)
    std = camera_deviations(posterior.fit)
    if abs(posterior.fit.camera.roll_rad) > MAX_ROLL_RAD:
        raise WorkError(
            f"{name}: expected an upright image, found people who lean as in one turned by "
            f"{math.degrees(posterior.fit.camera.roll_rad):.0f} degrees: blobs that are not one person each, "
            "or a camera to be turned"
        )
    if not std.height <= params.max_height_std:
        raise WorkError(
            f"{name}: camera height and focal length cannot be told apart from these samples (height known to "
            f"{min(std.height, 10):.0%}): add people nearer to and farther from the camera, or give the focal length "
            "or the camera's height"
        )
    return _result(posterior, tried[0].problem, people, model, time.perf_counter() - start)


def _result(
    posterior: CameraPosterior, problem: SearchProblem, people: People, model: HumanModel, search_s: float
) -> HumanCalibration:
    found = posterior.fit
    errors = problem.each(found.camera)
    return HumanCalibration(
        camera=found.camera,
        model=model,
        error=float(errors.mean()),
        sample_errors=errors,
        std=camera_deviations(found),
        assessment=assess(posterior, people, model),
        odd=tuple(int(i) for i in np.flatnonzero(found.deviations > ODD_FROM)),
        girth=found.girth,
        stature=found.stature,
        boxes_only=found.prior.boxes_only,
        search_s=search_s,
    )


@dataclass(frozen=True, eq=False)
class _Tried:
    problem: SearchProblem
    fit: GroundCameraFit


def _tried(
    lenses: Sequence[str],
    size: tuple[int, int],
    people: People,
    model: HumanModel,
    known: KnownValues,
    params: HumanCalibrationParams,
) -> list[_Tried]:
    """Fits of every lens and every reading of the samples, the likeliest first."""
    readings = (True,) if only_boxes(people.rows) else (False, True)
    problems = [SearchProblem(people.rows, size, lens, model, known, boxes) for lens in lenses for boxes in readings]
    quick = [t for p in problems for t in _fits(p, people, params)]
    # Fits whose log-evidence is lower by more are not refined further (our choice: one in 10^8).
    rival = max(t.fit.log_evidence for t in quick) - 20.0
    near = [t for t in quick if t.fit.log_evidence >= rival]
    full = [replace(t, fit=refine(t.fit.camera, people, model, t.fit.prior)) for t in near]
    return sorted(full, key=lambda t: -t.fit.log_evidence)


def _fits(problem: SearchProblem, people: People, params: HumanCalibrationParams) -> list[_Tried]:
    """The best fit of every way in which boxes may end, with people who vary as much as expected."""
    candidates, _ = search(problem, params)
    cameras = [problem.camera(candidate) for candidate in _distinct(candidates)]
    ends = (False,) if problem.boxes_only else (True,) if level_ends(people.rows) else (False, True)
    tried = []
    for level in ends:
        prior = prior_of(cameras[0], problem.known, problem.boxes_only, level)
        refined = [refine(camera, people, problem.model, prior, variation=1.0) for camera in cameras]
        tried.append(_Tried(problem, max(refined, key=lambda r: r.log_evidence)))
    return tried


def _distinct(candidates: F64) -> list[F64]:
    """The best few of (m, 3) sorted candidates that lie in different valleys."""
    kept: list[F64] = []
    for candidate in candidates:
        if all(np.abs(candidate - other).max() > 0.05 for other in kept):
            kept.append(candidate)
    # So many distinct results of the search are refined (our choice).
    return kept[:3]
