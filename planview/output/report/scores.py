"""The scores of a run against truth, where there is one."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter, ValidationError

from calib.errors import InputError, WorkError
from calib.params import first_problem
from planview.evaluation.significant import SignificantError
from planview.output.scene.results import RunResults, read_object

ROWS_MAX = 60_000
"""Longer runs are scored on request only (``planview evaluate``), since scoring takes longer than the page (our
choice)."""


def scores_of(results: RunResults) -> dict[str, Any]:
    """``evaluation.json`` of the folder, else the scores of the frames that were tracked; empty without truth."""
    written = read_object(results.folder / "evaluation.json")
    truth = results.truth
    if written or truth is None or not results.has_run or len(results.tracks) + len(truth) > ROWS_MAX:
        return written
    from planview.evaluation.evaluate import evaluate_tracks  # brings scipy

    try:
        return evaluate_tracks(results.tracks, truth, None, (0, max(0, results.n_frames - 1))).to_json()
    except (InputError, WorkError):
        return {}  # truth in another world, or without positions: the page does without


def errors_of(evaluation: dict[str, Any]) -> list[SignificantError]:
    """The significant errors of an evaluation.

    Raises:
        InputError: errors that are not what they should be.
    """
    try:
        return _ERRORS.validate_python(evaluation.get("significant_error_list") or [])
    except ValidationError as error:
        raise InputError(f"evaluation.json: expected significant errors: {first_problem(error)}") from error


_ERRORS = TypeAdapter(list[SignificantError])
