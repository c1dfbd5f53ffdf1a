"""Configurations that Optuna proposes from the results so far (extra ``study``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from calib.errors import InputError
from planview.sweep.figures import FIGURES
from planview.sweep.ranking import ranked
from planview.sweep.results import JobResult
from planview.sweep.space import Configuration, Range, Space, configuration
from planview.sweep.study import Study

BATCH = 4
"""Proposals made together. Not the number of processes: the same study proposes the same on any machine, so that what
is done is found again."""


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
        self._left, self._told, self._known = study.samples, 0, 0

    def extremes(self) -> list[Configuration]:
        """Every choice and both ends of every range, one parameter at a time: to be checked before anything runs."""
        spaces = self._study.parameters.items()
        return [configuration({name: value}) for name, space in spaces for value in _ends(space)]

    def ask(self) -> list[Configuration]:
        """The next configurations; none when all samples are taken or no run has the objective."""
        count = min(BATCH, self._left)
        if self._told and not self._known:
            return []
        self._left -= count
        trials = [self._optuna.ask() for _ in range(count)]
        self._asked = [(trial, configuration(self._values(trial))) for trial in trials]
        return list(dict.fromkeys(proposed for _, proposed in self._asked))

    def tell(self, results: Sequence[JobResult]) -> None:
        """The runs of the configurations asked last; one that failed makes its configuration fail."""
        objective = self._study.objective
        means = {
            r.configuration: r.figures[objective].mean
            for r in ranked(results, objective)
            if objective in r.figures and not r.failed
        }
        for trial, proposed in self._asked:
            mean = means.get(proposed, math.nan)
            self._told += 1
            if math.isnan(mean):
                self._optuna.tell(trial, state=self._failed)
            else:
                self._known += 1
                self._optuna.tell(trial, mean)

    def _values(self, trial: Any) -> dict[str, Any]:
        return {name: _suggested(trial, name, space) for name, space in self._study.parameters.items()}


def _suggested(trial: Any, name: str, space: Space) -> Any:
    if not isinstance(space, Range):
        return space[trial.suggest_categorical(name, list(range(len(space))))]
    if space.whole:
        return trial.suggest_int(name, space.min, space.max, step=int(space.step or 1), log=space.log)
    return float(f"{trial.suggest_float(name, space.min, space.max, step=space.step, log=space.log):.6g}")


def _ends(space: Space) -> list[Any]:
    return [space.min, space.max] if isinstance(space, Range) else space
