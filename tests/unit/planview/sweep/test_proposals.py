from pathlib import Path

from planview.sweep.results import JobResult
from planview.sweep.study import Configuration, Range, RecordingEntry, Study
from planview.sweep.sweep import Proposals

STUDY = Study(
    recordings=[RecordingEntry(path=Path("a"))], method="optuna", samples=24, objective="mota", search_seed=1,
    parameters={"a.x": Range(min=0.0, max=1.0), "a.c": ["p", "q"]},
)  # fmt: skip


def score(configuration: Configuration) -> float:
    """Best, 1, at x = 0.7 and c = q."""
    return 1.0 - (float(configuration.value("a.x")) - 0.7) ** 2 - 0.5 * (configuration.value("a.c") != '"q"')


def asked() -> list[Configuration]:
    proposals, all_of_them = Proposals(STUDY), list[Configuration]()
    while batch := proposals.ask():
        proposals.record([JobResult("a", c, 0, figures={"mota": score(c)}) for c in batch])
        all_of_them += batch
    return all_of_them


def test_proposals_come_near_the_best_and_are_the_same_every_time() -> None:
    found = asked()
    assert len(found) == 24
    assert max(map(score, found)) > 0.98
    assert found == asked()


def test_proposals_end_when_no_run_has_the_objective() -> None:
    proposals = Proposals(STUDY)
    proposals.record([JobResult("a", c, 0, error="no truth") for c in proposals.ask()])
    assert proposals.ask() == []


def test_both_ends_of_ranges_and_all_choices_are_checked_first() -> None:
    labels = [c.label for c in Proposals(STUDY).extremes()]
    assert labels == ["a.x=0.0", "a.x=1.0", 'a.c="p"', 'a.c="q"']
