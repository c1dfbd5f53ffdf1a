"""A whole study: plan, run what is not done, rank, write the page."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from calib.errors import InputError
from planview.output.folder import folder_lock, write_result
from planview.sweep.jobs import Planned, Planner, StudyJob
from planview.sweep.results import JobResult, Ranked, ranked, summary_csv
from planview.sweep.study import FIGURES, Configuration, Range, Space, Study, configuration, grid, random_draws
from planview.sweep.work import Done, Pool, earlier_figures, is_done, remove_attempts, run_tasks, track, track_and_score

STUDY_FILE, SUMMARY_FILE, PAGE_FILE = "study.json", "summary.csv", "report.html"


class Proposals:
    """Asks Optuna's tree-structured Parzen estimator (Bergstra et al. 2011) for configurations.

    Args:
        study: with its parameters, samples, objective and search seed.
    Raises:
        InputError: Optuna is not installed.
    """

    def __init__(self, study: Study) -> None:
        try:
            import optuna
        except ImportError as error:
            raise InputError('method "optuna": expected the package optuna; install planview[study]') from error
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._failed = optuna.trial.TrialState.FAIL
        self._optuna = optuna.create_study(
            direction="maximize" if FIGURES[study.objective].better > 0 else "minimize",
            sampler=optuna.samplers.TPESampler(seed=study.search_seed),
        )
        self._study = study
        self._asked: list[tuple[Any, Configuration]] = []
        self._left, self._recorded, self._known = study.samples, 0, 0

    def extremes(self) -> list[Configuration]:
        """Every choice and both ends of every range, one parameter at a time: to be checked before anything runs."""
        spaces = self._study.parameters.items()
        ends = {name: [space.min, space.max] if isinstance(space, Range) else space for name, space in spaces}
        return [configuration({name: value}) for name, values in ends.items() for value in values]

    def ask(self) -> list[Configuration]:
        """The next configurations; none when all samples are taken or no run has the objective."""
        # Proposals made together. Not the number of processes: the same study proposes the same on any
        # machine, so that what is done is found again.
        count = min(4, self._left)
        if self._recorded and not self._known:
            return []
        self._left -= count
        trials = [self._optuna.ask() for _ in range(count)]
        spaces = self._study.parameters
        self._asked = [
            (trial, configuration({name: _suggested(trial, name, space) for name, space in spaces.items()}))
            for trial in trials
        ]
        return list(dict.fromkeys(proposed for _, proposed in self._asked))

    def record(self, results: Sequence[JobResult]) -> None:
        """The runs of the configurations asked last; one that failed makes its configuration fail."""
        objective = self._study.objective
        means = {
            r.configuration: r.figures[objective].mean
            for r in ranked(results, objective)
            if objective in r.figures and not r.failed
        }
        for trial, proposed in self._asked:
            mean = means.get(proposed, math.nan)
            self._recorded += 1
            if math.isnan(mean):
                self._optuna.tell(trial, state=self._failed)
            else:
                self._known += 1
                self._optuna.tell(trial, mean)


def _suggested(trial: Any, name: str, space: Space) -> Any:
    if not isinstance(space, Range):
        return space[trial.suggest_categorical(name, list(range(len(space))))]
    if space.whole:
        return trial.suggest_int(name, space.min, space.max, step=int(space.step or 1), log=space.log)
    return float(f"{trial.suggest_float(name, space.min, space.max, step=space.step, log=space.log):.6g}")


class StudyProgress(Progress):
    """Progress of a whole study on a console."""

    def __init__(self, console: Console) -> None:
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        super().__init__(
            TextColumn("{task.description}"), *columns, TextColumn("{task.fields[state]}"), console=console
        )
        self._runs = self.add_task("runs", total=0, state="")
        self._maps = self.add_task("plan-view recordings", total=0, state="", visible=False)
        self._failed = self._reused = 0

    def planned(self, runs: int, maps: int) -> None:
        """So many runs and plan-view recordings are to be made, those that are done included."""
        for task, more in ((self._runs, runs), (self._maps, maps)):
            self.update(
                task, total=(total := (self.tasks[task].total or 0) + more), visible=task == self._runs or total > 0
            )

    def recorded(self) -> None:
        """A plan-view recording is made, or failed."""
        self.update(self._maps, advance=1)

    def ended(self, result: JobResult) -> None:
        """A run is done, or failed."""
        self._failed += bool(result.error)
        self._reused += result.reused
        parts = [f"{self._reused} done before"] * bool(self._reused) + [f"{self._failed} failed"] * bool(self._failed)
        self.update(self._runs, advance=1, state=", ".join(parts))


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
    study: Study, names: Sequence[str], out: Path, open_pool: Callable[[], Pool], watch: StudyProgress
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
    batches = _batches(study, Planner(study, out, names))
    batch: list[Planned] = next(batches)
    with folder_lock(out), ExitStack() as stack:
        pools: list[Pool] = []

        def pool() -> Pool:
            if not pools:
                pools.append(open_pool())
                stack.callback(pools[0].close)
            return pools[0]

        remove_attempts(out)
        write_result(out / STUDY_FILE, study.model_dump_json(indent=2) + "\n")
        runs: list[JobResult] = []
        with suppress(StopIteration):
            while batch:
                runs += (done := _run(batch, pool, watch))
                batch = batches.send(done)
        remove_attempts(out)
        results = StudyResults(study, runs, ranked(runs, study.objective))
        # The page is written anew where a run was made or failed.
        summary, page, text = out / SUMMARY_FILE, out / PAGE_FILE, summary_csv(runs)
        written = page.is_file() and summary.is_file() and summary.read_text(encoding="utf-8") == text
        if not written or not all(run.reused for run in runs):
            from planview.sweep.page import study_page

            write_result(summary, text)
            write_result(page, study_page(study, runs, results.ranking, out))
    return results


def _batches(study: Study, planner: Planner) -> Generator[list[Planned], list[JobResult], None]:
    """Jobs to run together, for the results of the batch before."""
    if study.method == "grid":
        yield planner.jobs(grid(study.parameters))
    elif study.method == "random":
        yield planner.jobs(random_draws(study.parameters, study.samples, study.search_seed))
    else:
        proposals = Proposals(study)
        planner.jobs(proposals.extremes())
        while configurations := proposals.ask():
            proposals.record((yield planner.jobs(configurations)))


def _run(batch: Sequence[Planned], pool: Callable[[], Pool], watch: StudyProgress) -> list[JobResult]:
    """Results in the order of the batch; the pool is opened when there is something to run."""
    results: dict[int, JobResult] = {}
    waiting: dict[str, list[tuple[int, StudyJob]]] = {}
    for i, job in enumerate(batch):
        if isinstance(job, JobResult):
            results[i] = job
        elif (figures := earlier_figures(job)) is not None:
            results[i] = _result(job, figures, "", reused=True)
        else:
            waiting.setdefault(job.key, []).append((i, job))
    jobs = {key: group[0][1] for key, group in waiting.items()}
    maps = {job.maps.key: job.maps for job in jobs.values() if job.maps and not is_done(job.maps)}
    watch.planned(len(batch), len(maps))
    for result in results.values():
        watch.ended(result)

    def end(done: Done) -> None:
        for i, job in waiting[done.key]:
            results[i] = _result(job, done.value or {}, done.error)
            watch.ended(results[i])

    errors: dict[str, str] = {}
    for done in run_tasks(track, maps, pool()) if maps else ():
        watch.recorded()
        errors[done.key] = done.error
    for key, job in jobs.items():
        if job.maps and (error := errors.get(job.maps.key)):
            end(Done(key, error=error))
    ready = {key: job for key, job in jobs.items() if not (job.maps and errors.get(job.maps.key))}
    for done in run_tasks(track_and_score, ready, pool()) if ready else ():
        end(done)
    return [results[i] for i in range(len(batch))]


def _result(job: StudyJob, figures: dict[str, float], error: str, *, reused: bool = False) -> JobResult:
    folder = None if error else job.run.folder
    return JobResult(job.name, job.configuration, job.seed, folder, figures, error, reused, job.maps is not None)
