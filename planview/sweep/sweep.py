"""A whole study: plan, run what is not done, rank, write the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from planview.output.folder import folder_lock, write_result
from planview.sweep.jobs import Planned, StudyJob, planned
from planview.sweep.results import JobResult, Ranked, ranked, summary_csv
from planview.sweep.study import Study, grid, random_draws
from planview.sweep.work import Done, Pool, earlier_figures, is_done, remove_attempts, run_tasks, track, track_and_score

STUDY_FILE, SUMMARY_FILE, PAGE_FILE = "study.json", "summary.csv", "report.html"


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
    study: Study, names: Sequence[str], out: Path, open_pool: Callable[[], Pool], console: Console
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
    study.refuse_many()
    configurations = (
        grid(study.parameters)
        if study.method == "grid"
        else random_draws(study.parameters, study.samples, study.search_seed)
    )
    jobs = planned(study, out, names, configurations)
    with folder_lock(out):
        remove_attempts(out)
        write_result(out / STUDY_FILE, study.model_dump_json(indent=2) + "\n")
        runs = _run(jobs, open_pool, console)
        remove_attempts(out)
        results = StudyResults(study, runs, ranked(runs, study.objective))
        # The page is written again where a run was made or failed.
        summary, page, text = out / SUMMARY_FILE, out / PAGE_FILE, summary_csv(runs)
        written = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
        if not written or not all(run.reused for run in runs):
            from planview.sweep.page import study_page

            write_result(summary, text)
            write_result(page, study_page(study, runs, results.ranking, out.name))
    return results


def _run(study_jobs: Sequence[Planned], open_pool: Callable[[], Pool], console: Console) -> list[JobResult]:
    """Results in the order of the jobs."""
    results: dict[int, JobResult] = {}
    waiting: dict[str, list[tuple[int, StudyJob]]] = {}
    for i, job in enumerate(study_jobs):
        if isinstance(job, JobResult):
            results[i] = job
        elif (figures := earlier_figures(job)) is not None:
            results[i] = _result(job, figures, "", reused=True)
        else:
            waiting.setdefault(job.key, []).append((i, job))
    jobs = {key: group[0][1] for key, group in waiting.items()}
    maps = {job.maps.key: job.maps for job in jobs.values() if job.maps and not is_done(job.maps)}
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
    )  # fmt: skip
    with ExitStack() as stack:
        watch = stack.enter_context(Progress(*columns, console=console))
        bar = watch.add_task("runs", total=len(study_jobs), state="")
        recording = watch.add_task("plan-view recordings", total=len(maps), state="", visible=bool(maps))
        counts = {"done before": 0, "failed": 0}

        def show(ended: Iterable[JobResult]) -> None:
            for result in ended:
                counts["done before"] += result.reused
                counts["failed"] += bool(result.error)
            parts = (f"{number} {how}" for how, number in counts.items() if number)
            watch.update(bar, completed=len(results), state=", ".join(parts))

        def end(done: Done) -> None:
            mine = {i: _result(job, done.value or {}, done.error) for i, job in waiting[done.key]}
            results.update(mine)
            show(mine.values())

        show(results.values())
        if not jobs:
            return [results[i] for i in range(len(study_jobs))]
        pool = open_pool()
        stack.callback(pool.close)
        errors: dict[str, str] = {}
        for done in run_tasks(track, maps, pool):
            watch.advance(recording)
            errors[done.key] = done.error
        ready = {}
        for key, job in jobs.items():
            if job.maps and (error := errors.get(job.maps.key)):
                end(Done(key, error=error))
            else:
                ready[key] = job
        for done in run_tasks(track_and_score, ready, pool):
            end(done)
    return [results[i] for i in range(len(study_jobs))]


def _result(job: StudyJob, figures: dict[str, float], error: str, *, reused: bool = False) -> JobResult:
    folder = None if error else job.run.folder
    return JobResult(job.name, job.configuration, job.seed, folder, figures, error, reused, job.maps is not None)
