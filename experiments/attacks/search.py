"""Looks for the worst feature versions that the guard accepts: an optimiser over experiments.attacks.strategies.

Each trial flies a strategy through the whole guard, on tuning seeds. Its value is the mean error ratio to `bias`; a
lost vehicle counts LOST_VALUE, and more the sooner it is lost. The optimiser is optuna's multivariate TPE. Its study is
a file: the same command goes on where it was stopped.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import optuna

from configs.loader import ConfigError
from experiments.attacks.attack_flight import AttackFlight, AttackOutcome, fly_attack
from experiments.attacks.cases import ATTACK_S
from experiments.attacks.conditions import condition_assignments
from experiments.attacks.corpus import check, plain_flight
from experiments.attacks.strategies import RANGES, Strategy, strategy_case
from experiments.campaigns.tuning import TRAINING_SEEDS
from experiments.campaigns.worker_pools import LocalPool
from runtime.files import write_atomically

LOST_VALUE: Final = 20.0
KEPT: Final = 3
"""Finds that go into the corpus."""
APART_MIN: Final = 0.15
"""Root mean square distance of two finds, in shares of the ranges: not the same one twice."""
STUDY: Final = "attack search"
JOURNAL: Final = "search.journal"
_NEUTRAL: Final = {name: 0.0 if low < 0.0 else 0.5 * (low + high) for name, (low, high, _) in RANGES.items()}
_PLAIN: Final = _NEUTRAL | {"delay_s": 0.0, "period_s": 1.0, "alternate": 1.0, "share": 1.0, "step_ahead_m": 0.3}
STARTS: Final[tuple[Strategy, ...]] = (
    _PLAIN | {"position_honest": -1.0, "attitude_honest": -1.0},
    _PLAIN | {"position_place": 1.0, "position_motion": 1.0},
    _PLAIN | {"position_step": -1.0, "attitude_step_across": 1.0, "period_s": 0.5},
    _PLAIN | {"position_place_swirl": 1.0, "attitude_motion_swirl": 1.0},
)
"""What is tried first: the honest map's opposite, stiffness and damping taken away, a step ahead, a swirl."""


@dataclass(frozen=True)
class Search:
    """An optimiser's flights and budget."""

    flights: tuple[AttackFlight, ...]
    """Of one trial: seeds and conditions."""
    trials: int
    """In all; those of earlier runs count."""
    folder: Path

    def __post_init__(self) -> None:
        """Raise ConfigError for seeds that are not for tuning."""
        for flight in self.flights:
            if flight.seed not in TRAINING_SEEDS:
                raise ConfigError(
                    f"--search: seed {flight.seed} is for evaluation; allowed are 0 to {TRAINING_SEEDS.stop - 1}"
                )


@dataclass(frozen=True)
class Find:
    """A strategy, and what it did."""

    value: float
    strategy: Strategy
    lost: int
    accepted: int
    trial: int

    def entry(self) -> dict[str, Any]:
        """The find as it is kept in the corpus."""
        rounded = {name: float(f"{self.strategy[name]:.5g}") for name in RANGES}
        return {"trial": self.trial, "value": round(self.value, 3), "lost": self.lost, "strategy": rounded}


def fly_strategy(flight: AttackFlight, strategy: Strategy) -> AttackOutcome:
    """Fly a strategy in place of the flight's case."""
    assignments = (*condition_assignments(flight.condition, flight.scenario), *flight.assignments)
    return fly_attack(
        *(flight.case, flight.seed, flight.scenario, flight.duration_s, assignments, flight.controller, flight.core),
        partial(strategy_case, strategy, ATTACK_S),
    )


def value_of(outcomes: Sequence[AttackOutcome], plain_m: Sequence[float]) -> float:
    """Mean over the flights of the error ratio to `bias`, whose errors are plain_m; a lost vehicle counts more."""
    values = [
        LOST_VALUE + math.exp(-outcome.lost_after_s) if outcome.lost else outcome.error_m / plain
        for outcome, plain in zip(outcomes, plain_m, strict=True)
    ]
    return float(np.mean(values))


def open_study(search: Search) -> optuna.Study:
    """The study of a search, new or from its file. Raises ConfigError if the file is of other flights."""
    search.folder.mkdir(parents=True, exist_ok=True)
    path = search.folder / JOURNAL
    study = optuna.create_study(
        study_name=STUDY,
        storage=optuna.storages.JournalStorage(optuna.storages.journal.JournalFileBackend(str(path))),
        direction="maximize",
        load_if_exists=True,
    )
    flights = [json.dumps(vars(flight)) for flight in search.flights]
    if study.user_attrs.setdefault("flights", flights) != flights:
        raise ConfigError(f"{path}: a search over other flights; choose another --out")
    study.set_user_attr("flights", flights)
    if not study.trials:
        for start in STARTS:
            study.enqueue_trial(dict(start))
    for left in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):  # by a killed search
        study.tell(left.number, state=optuna.trial.TrialState.FAIL)
        if left.params:
            study.enqueue_trial(left.params)
    return study


def run_search(search: Search, workers: int, report: Callable[[str], None]) -> optuna.Study:
    """Fly the trials that are left. report: called with a line for each one."""
    check(search.flights)
    study, pool = open_study(search), LocalPool(workers, recycle=False)
    complete = (optuna.trial.TrialState.COMPLETE,)
    flown = len(study.get_trials(deepcopy=False, states=complete))
    try:
        executor = pool.open()
        if flown < search.trials and "plain_m" not in study.user_attrs:
            plain = [executor.submit(plain_flight(flight).fly) for flight in search.flights]
            study.set_user_attr("plain_m", [one.result().error_m for one in plain])
        while flown < search.trials:
            study.sampler = optuna.samplers.TPESampler(seed=flown, multivariate=True, constant_liar=True)
            trials = [study.ask() for _ in range(min(workers, search.trials - flown))]
            waiting = [
                [executor.submit(fly_strategy, flight, _suggested(trial)) for flight in search.flights]
                for trial in trials
            ]
            for trial, futures in zip(trials, waiting, strict=True):
                outcomes = [future.result() for future in futures]
                value = value_of(outcomes, study.user_attrs["plain_m"])
                trial.set_user_attr("lost", sum(bool(one.lost) for one in outcomes))
                trial.set_user_attr("accepted", sum(one.swaps for one in outcomes))
                study.tell(trial, value)
                report(f"trial {trial.number}: {value:.2f}, best {study.best_value:.2f}")
            flown = len(study.get_trials(deepcopy=False, states=complete))
    finally:
        pool.close()
    return study


def _suggested(trial: optuna.Trial) -> Strategy:
    return {name: trial.suggest_float(name, low, high, log=log) for name, (low, high, log) in RANGES.items()}


def best(study: optuna.Study, count: int = KEPT) -> list[Find]:
    """The worst strategies for the vehicle, none like another; only such of which a version was accepted."""
    finds: list[Find] = []
    trials = study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,))
    for trial in sorted(trials, key=lambda one: one.values[0], reverse=True):
        accepted = int(trial.user_attrs["accepted"])
        if accepted and all(_distance(trial.params, other.strategy) >= APART_MIN for other in finds):
            lost = int(trial.user_attrs["lost"])
            finds.append(Find(trial.values[0], dict(trial.params), lost, accepted, trial.number))
        if len(finds) == count:
            break
    return finds


def _distance(one: Strategy, other: Strategy) -> float:
    apart = [(one[name] - other[name]) / (high - low) for name, (low, high, _) in RANGES.items()]
    return float(np.sqrt(np.mean(np.square(apart))))


def keep(study: optuna.Study, command: str, path: Path) -> None:
    """Write the best finds into a file of the corpus, with the command that found them. Raises OSError."""
    finds = [find.entry() for find in best(study)]
    write_atomically(path, (json.dumps({"command": command, "finds": finds}, indent=1) + "\n").encode())
