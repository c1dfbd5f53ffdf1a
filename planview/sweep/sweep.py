"""A whole study: plan, run what is not done, rank, write the page."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from planview.output.folder import folder_lock, write_result
from planview.sweep.jobs import Planned, Planner, Refused, RunJob, StudyJob
from planview.sweep.pools import Pool
from planview.sweep.proposals import Proposals
from planview.sweep.ranking import Ranked, ranked
from planview.sweep.results import JobResult, summary_csv
from planview.sweep.schedule import Task, run_tasks
from planview.sweep.space import grid, random_draws
from planview.sweep.study import Study
from planview.sweep.work import is_done, kept_figures, remove_stale_attempts, track, track_and_score

STUDY_FILE, SUMMARY_FILE, PAGE_FILE = "study.json", "summary.csv", "report.html"


class StudyWatch(Protocol):
    """Is told what happens."""

    def planned(self, runs: int, maps: int) -> None:
        """So many runs and plan-view recordings are to be made, those that are done included."""

    def recorded(self, error: str) -> None:
        """A plan-view recording is made, or failed."""

    def ended(self, result: JobResult) -> None:
        """A run is done, or failed."""


@dataclass(frozen=True)
class StudyResults:
    """All runs of a study, in its order, and its configurations, best first."""

    study: Study
    runs: list[JobResult]
    ranking: list[Ranked]

    @property
    def failed(self) -> list[JobResult]:
        return [run for run in self.runs if run.error]


def run_study(
    study: Study, names: Sequence[str], out: Path, open_pool: Callable[[], Pool], watch: StudyWatch
) -> StudyResults:
    """Run all that is not done and write study.json, summary.csv and report.html.

    Args:
        study: with absolute paths.
        names: of the recordings, all different.
        out: folder for results; of earlier studies in it, what has the same input, configuration and version is kept.
        open_pool: called when there is something to run.
    Raises:
        InputError: a setting that is no parameter, a cluster that cannot be reached, or another study in the folder.
        WorkError: the folder cannot be written.
    """
    batches = _batches(study, Planner(study, out, names))
    batch: list[Planned] | None = next(batches)
    with folder_lock(out), closing(_Runner(open_pool, watch)) as runner:
        remove_stale_attempts(out)
        write_result(out / STUDY_FILE, study.model_dump_json(indent=2) + "\n")
        runs: list[JobResult] = []
        while batch:
            done = runner.run(batch)
            runs += done
            batch = _next_batch(batches, done)
        remove_stale_attempts(out)
        results = StudyResults(study, runs, ranked(runs, study.objective))
        _write(results, out)
    return results


Batches = Generator[list[Planned], list[JobResult], None]


def _batches(study: Study, planner: Planner) -> Batches:
    """Jobs to run together, for the results of the batch before."""
    if study.method == "grid":
        yield planner.jobs(grid(study.parameters))
    elif study.method == "random":
        yield planner.jobs(random_draws(study.parameters, study.samples, study.search_seed))
    else:
        proposals = Proposals(study)
        planner.jobs(proposals.extremes())
        while configurations := proposals.ask():
            proposals.tell((yield planner.jobs(configurations)))


def _next_batch(batches: Batches, results: list[JobResult]) -> list[Planned] | None:
    try:
        return batches.send(results)
    except StopIteration:
        return None


class _Runner:
    """Runs batches on a pool that is opened when it is needed."""

    def __init__(self, open_pool: Callable[[], Pool], watch: StudyWatch) -> None:
        self._open_pool, self._watch = open_pool, watch
        self._pool: Pool | None = None

    def run(self, batch: Sequence[Planned]) -> list[JobResult]:
        """Results in the order of the batch."""
        early = {i: result for i, job in enumerate(batch) if (result := _early(job)) is not None}
        waiting: dict[str, list[int]] = {}
        for i, job in enumerate(batch):
            if i not in early and isinstance(job, StudyJob):
                waiting.setdefault(job.key, []).append(i)
        jobs = [job for indices in waiting.values() if isinstance(job := batch[indices[0]], StudyJob)]
        maps = {job.maps.key: job.maps for job in jobs if job.maps and not is_done(job.maps)}
        self._watch.planned(len(batch), len(maps))
        for result in early.values():
            self._watch.ended(result)
        results = early
        for key, value, error in self._done(jobs, maps):
            for i in waiting[key]:
                results[i] = _result(batch[i], value, error)
                self._watch.ended(results[i])
        return [results[i] for i in range(len(batch))]

    def _done(
        self, jobs: Sequence[StudyJob], maps: dict[str, RunJob]
    ) -> Generator[tuple[str, dict[str, float], str], None, None]:
        if not jobs:
            return
        tasks = [Task(key, track, job) for key, job in maps.items()]
        for job in jobs:
            after = job.maps.key if job.maps and job.maps.key in maps else None
            tasks.append(Task(job.key, track_and_score, job, after))
        self._pool = self._pool or self._open_pool()
        for done in run_tasks(tasks, self._pool):
            if done.key in maps:
                self._watch.recorded(done.error)
            else:
                yield done.key, done.value or {}, done.error

    def close(self) -> None:
        if self._pool is not None:
            self._pool.close()


def _early(job: Planned) -> JobResult | None:
    """What is known without work: a run that is done, or one that cannot begin."""
    if isinstance(job, Refused):
        return JobResult(job.name, job.configuration, job.seed, error=job.error)
    figures = kept_figures(job)
    return None if figures is None else _result(job, figures, "", reused=True)


def _result(job: Planned, figures: dict[str, float], error: str, *, reused: bool = False) -> JobResult:
    assert isinstance(job, StudyJob)
    folder = None if error else job.run.folder
    return JobResult(job.name, job.configuration, job.seed, folder, figures, error, reused, job.maps is not None)


def _write(results: StudyResults, out: Path) -> None:
    """summary.csv, and the page anew where a run was made or failed."""
    summary, page = out / SUMMARY_FILE, out / PAGE_FILE
    text = summary_csv(results.runs)
    unchanged = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
    if unchanged and all(run.reused for run in results.runs):
        return
    from planview.sweep.page import study_page

    write_result(summary, text)
    write_result(page, study_page(results.study, results.runs, results.ranking, out))
