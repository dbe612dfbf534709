"""Searches a controller's gains on training seeds, with the same flights, common parameters and budget for all of them.

The search uses Optuna's tree-structured Parzen estimator. A trial flies every case of the tuning campaign once for each
seed: some on the nominal vehicle, some on drawn ones. Its value is the mean cost of these flights:

    cost = RMSE / reference of the case                  if the vehicle survived, at most `crash_cost`,
    cost = crash_cost (2 - share of the flight flown)    if it crashed,

so a crash always costs more than a large error, and an early crash more than a late one. The case names the window of
the RMSE. Gains whose predicted loops miss the campaign's margins, on the nominal vehicle or at a corner, are not flown:
their cost is above that of any flight, and grows with what is missing. They are not part of the budget.

The first trial uses the values of the controller file, the next ones those with the campaign's `starts`; each of these
is moved to the nearest gains that have the margins. Of the others, one in four comes from the estimator, over the whole
ranges, and three are steps of random size from the best so far, shortened until they have the margins. A trial is
stopped early if its mean cost is `HOPELESS` times that of the best trial at the same number of seeds (after every case
was flown once). The search ends after `trials` flown trials if the last third improved the best cost by less than
`CONVERGED`; otherwise it goes on until that is so, to at most twice the budget.

A search is stored in a journal file and can be continued: trial n uses a generator seeded with (seed, n).
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import optuna
from pydantic import Field, model_validator

from configs.flight_tree import DEFAULT_SCENARIO, read_scenario
from configs.loader import ConfigError, ConfigRecord, load
from experiments.campaigns.campaign import CampaignConfig, Case, Seeds, campaign_file
from experiments.campaigns.flight_jobs import FlightJob, flights_of_seed
from experiments.campaigns.nearest_gains import nearest, shortened
from experiments.campaigns.search_space import Parameter, assignments, present_values, shares, step_from, values_at
from experiments.campaigns.worker import FlightResult, fly_job
from experiments.flights.scenario import Choices, resolve
from experiments.margins.requirement import Corner, MarginRequirement
from onboard.cores import NUMPY, check_core, core_option

TRAINING_SEEDS: Final = range(1000)
"""Seeds of tuning; the others are for evaluation."""
CONVERGED: Final = 0.02
"""Share of the best cost by which the last third of a search may improve it, when the search ends."""
NOT_FLOWN_MAX: Final = 5000
"""Sets of gains without the margins, after which a search gives up."""
FLOWN: Final = "flown"
NOMINAL: Final = "nominal"
STEEPEST_MAP: Final = "steepest_map"
HOPELESS: Final = 1.15
GLOBAL_EVERY: Final = 4
ENDED: Final = (optuna.trial.TrialState.COMPLETE, optuna.trial.TrialState.PRUNED)


Window = Literal["settled_rmse_m", "position_rmse_m", "after_onset_rmse_m", "settled_after_onset_rmse_m"]


class TuneCase(ConfigRecord):
    """A case of the tuning campaign, with the reference of its error."""

    case: Case
    window: Window
    reference_m: Annotated[float, Field(gt=0)]


class TuneConfig(ConfigRecord):
    """A tuning campaign."""

    description: str
    cases: tuple[TuneCase, ...] = Field(min_length=1)
    seeds: Seeds
    crash_cost: Annotated[float, Field(gt=1)]
    margins: MarginRequirement
    """Least predicted margins of every loop, on the nominal vehicle."""
    corners: tuple[Corner, ...] = ()
    """Other vehicles, each with its least predicted margins."""
    steepest_map: MarginRequirement | None = None
    """Least predicted margins of the position loop with the steepest map that the guard accepts."""
    common: tuple[Parameter, ...]
    """Parameters of every controller, with the same ranges."""
    own: dict[str, tuple[Parameter, ...]]
    """Own gains of each controller, by its name."""
    starts: tuple[dict[str, float], ...] = ()
    """Values of common parameters for the first trials of every search; other parameters as in the file."""

    @model_validator(mode="after")
    def _training_seeds(self) -> Self:
        if self.seeds.first + self.seeds.count - 1 not in TRAINING_SEEDS:
            raise ValueError("seeds: tuning uses seeds below 1000, evaluation those above")
        return self

    @model_validator(mode="after")
    def _names_of_corners(self) -> Self:
        names = [NOMINAL, STEEPEST_MAP, *(corner.name for corner in self.corners)]
        if len(set(names)) < len(names):
            raise ValueError(
                f"corners: {names[2:]}: expected different names, none of them {NOMINAL} or {STEEPEST_MAP}"
            )
        return self

    @model_validator(mode="after")
    def _known_starts(self) -> Self:
        ranges = {one.name: one for one in self.common}
        for name, value in (item for start in self.starts for item in start.items()):
            if name not in ranges or not ranges[name].low <= value <= ranges[name].high:
                raise ValueError(f"starts: {name}: {value} is not a common parameter within its range")
        return self

    def space(self, controller: str) -> tuple[Parameter, ...]:
        """Return the parameters of a controller. Raises ConfigError if none are declared."""
        name = Path(controller).stem
        if name not in self.own:
            raise ConfigError(f"no search space for controller {name!r}: declared are {', '.join(sorted(self.own))}")
        return (*self.common, *self.own[name])


@dataclass(frozen=True)
class Search:
    """One search: controller, campaign and budget."""

    config: TuneConfig
    name: str
    """Name of the campaign."""
    controller: str
    trials: int
    """Flown trials, before the search may end."""
    seed: int = 0
    core: str = NUMPY
    """The onboard core of all flights, one of onboard.cores.CORES."""

    @property
    def label(self) -> str:
        """Name of its study and journal: searches with two cores are never mixed."""
        name = Path(self.controller).stem
        return name if self.core == NUMPY else f"{name}_core_{self.core}"


def load_tuning(name: str) -> tuple[TuneConfig, Path]:
    """Load a tuning campaign by name or file; return it and its path. Raises ConfigError."""
    path = campaign_file(name)
    return load(TuneConfig, path), path


def cost(row: dict[str, Any], window: str, reference_m: float, crash_cost: float) -> float:
    """Return the cost of one flight, defined at the head of this file."""
    if row["error"]:
        return 2.0 * crash_cost
    if not row["survived"]:
        share = float(row["flown_s"]) / max(float(row["duration_s"]), 1e-9)
        return crash_cost * (2.0 - min(share, 1.0))
    error = float(row[window])
    return min(error / reference_m, crash_cost) if math.isfinite(error) else crash_cost


def trial_jobs(search: Search, values: dict[str, float], number: int) -> list[tuple[TuneCase, FlightJob]]:
    """Return the flights of the number-th seed with these gains, by parameter name."""
    campaign = CampaignConfig(
        description=search.config.description,
        controllers=(search.controller,),
        cases=tuple(tuned.case for tuned in search.config.cases),
        seeds=search.config.seeds,
    )
    seed = search.config.seeds.first + number
    gains = assignments(search.config.space(search.controller), values)
    jobs = []
    for tuned in search.config.cases:
        case = tuned.case.model_copy(update={"set": gains | tuned.case.set})
        jobs += [
            (tuned, replace(job, core=search.core))
            for job in flights_of_seed(campaign, search.name, case, seed, number, False)
        ]
    return jobs


def margin_shortfalls(search: Search, values: dict[str, float]) -> dict[str, float]:
    """The share that these gains miss of the predicted margins, by name: nominal, corners, with the steepest map."""
    gains = assignments(search.config.space(search.controller), values)
    choices = Choices(search.controller, assignments=tuple(f"{path}={value}" for path, value in gains.items()))
    flight, vehicle = resolve(choices=choices), read_scenario(DEFAULT_SCENARIO).vehicle
    missing = {NOMINAL: search.config.margins.shortfall(flight)}
    missing |= {one.name: one.shortfall(flight, vehicle) for one in search.config.corners}
    if search.config.steepest_map is not None:
        missing[STEEPEST_MAP] = search.config.steepest_map.shortfall_with_the_steepest_map(flight)
    return missing


def margin_shortfall(search: Search, values: dict[str, float]) -> float:
    """The sum of these shares; 0 for gains that miss nothing."""
    return sum(margin_shortfalls(search, values).values())


def fly_trial(
    search: Search, values: dict[str, float], executor: Executor, after_seed: Callable[[int, float], bool]
) -> float:
    """Return the mean cost of one set of gains.

    Parameters
    ----------
    after_seed: called with the number of the seed and the mean so far; returns True to stop the trial.
    """
    costs: list[float] = []
    for number in range(search.config.seeds.count):
        flights = trial_jobs(search, values, number)
        futures = [(tuned, executor.submit(fly_job, job)) for tuned, job in flights]
        for tuned, future in futures:
            result: FlightResult = future.result()
            if result.row["error"]:  # a flight that failed gives no information about the gains
                raise ConfigError(f"{result.row['error']}\n  repeat with: {result.row['command']}")
            costs.append(cost(result.row, tuned.window, tuned.reference_m, search.config.crash_cost))
        mean = sum(costs) / len(costs)
        if after_seed(number, mean):
            raise optuna.TrialPruned()
    return sum(costs) / len(costs)


def open_study(search: Search, folder: Path) -> optuna.Study:
    """Open the study of a search, new or from its file; trials that were interrupted are repeated.

    Raises
    ------
    ConfigError
        If the controller has no search space, or the core cannot fly it.
    """
    check_core(search.core, resolve(choices=Choices(search.controller)).onboard)
    folder.mkdir(parents=True, exist_ok=True)
    backend = optuna.storages.journal.JournalFileBackend(str(folder / f"{search.label}.journal"))
    study = optuna.create_study(
        study_name=f"{search.name}/{search.label}",
        storage=optuna.storages.JournalStorage(backend),
        direction="minimize",
        load_if_exists=True,
    )
    if not study.trials:
        space = search.config.space(search.controller)
        start = present_values(space, search.controller)
        for number, (values, origin) in enumerate(
            [(start, "as it stood"), *((start | one, "starts") for one in search.config.starts)]
        ):
            rng = np.random.default_rng([search.seed, number])
            study.enqueue_trial(with_margins(search, values, rng), user_attrs={"origin": origin})
    for left in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):  # by a killed search
        study.tell(left.number, state=optuna.trial.TrialState.FAIL)
        study.enqueue_trial(left.params)
    return study


def _flown_trials(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    return [one for one in study.get_trials(deepcopy=False, states=ENDED) if one.user_attrs.get(FLOWN)]


def _complete_cost(trial: optuna.trial.FrozenTrial) -> float:
    """The cost of a trial; infinite if it was stopped early."""
    return trial.value if trial.value is not None and trial.state is optuna.trial.TrialState.COMPLETE else math.inf


def flown_values(study: optuna.Study) -> list[float]:
    """The best cost so far, after each flown trial."""
    return list(accumulate(map(_complete_cost, _flown_trials(study)), min))


def is_done(best_so_far: Sequence[float], trials: int) -> bool:
    """Whether a search may end: its budget is flown and its last third gained little, or twice the budget is flown."""
    if len(best_so_far) < trials:
        return False
    before = best_so_far[2 * len(best_so_far) // 3 - 1] if len(best_so_far) > 1 else math.inf
    return len(best_so_far) >= 2 * trials or best_so_far[-1] > (1.0 - CONVERGED) * before


def run_search(
    search: Search, study: optuna.Study, executor: Executor, report: Callable[[optuna.Study], None]
) -> optuna.Study:
    """Fly trials until the search is done; trials of earlier runs count.

    Raises
    ------
    ConfigError
        If a flight fails, or if no gains with the campaign's margins are found.
    """
    space = search.config.space(search.controller)
    not_flown = 0
    while not is_done(flown_values(study), search.trials):
        done = len(study.get_trials(deepcopy=False, states=ENDED))
        study.sampler = optuna.samplers.TPESampler(
            seed=search.seed * 100_003 + done, n_startup_trials=7, multivariate=True
        )
        waiting = study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.WAITING,))
        if done % GLOBAL_EVERY and not waiting:
            study.enqueue_trial(
                step_with_margins(search, study.best_params, np.random.default_rng([search.seed, done]))
            )
        trial = study.ask()
        values = {one.name: trial.suggest_float(one.name, one.low, one.high, log=one.log) for one in space}
        missing = margin_shortfall(search, values)
        trial.set_user_attr(FLOWN, missing == 0.0)
        if missing > 0.0:
            study.tell(trial, 2.0 * search.config.crash_cost * (1.0 + missing))
            not_flown += 1
            if not_flown > NOT_FLOWN_MAX:
                raise ConfigError(f"{search.controller}: of {not_flown} sets of gains, none has the campaign's margins")
            continue
        not_flown = 0
        _fly(search, study, trial, values, executor)
        report(study)
    return study


def _fly(
    search: Search, study: optuna.Study, trial: optuna.Trial, values: dict[str, float], executor: Executor
) -> None:
    """Fly one trial and tell the study. A trial that is interrupted is the first when the search goes on."""
    complete = [one for one in _flown_trials(study) if _complete_cost(one) < math.inf]
    best = min(complete, key=_complete_cost, default=None)

    def give_up(number: int, mean: float) -> bool:
        trial.report(mean, number)
        last = number + 1 == search.config.seeds.count
        return best is not None and not last and mean > HOPELESS * best.intermediate_values[number]

    try:
        value = fly_trial(search, values, executor, give_up)
    except optuna.TrialPruned:
        study.tell(trial, state=optuna.trial.TrialState.PRUNED)
    except BaseException:
        study.tell(trial, state=optuna.trial.TrialState.FAIL)
        study.enqueue_trial(values)
        raise
    else:
        study.tell(trial, value)


def with_margins(search: Search, values: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """The nearest gains to these that have the campaign's margins, or these if none were found."""
    space = search.config.space(search.controller)
    start = shares(space, values)
    found = nearest(start, lambda point: margin_shortfall(search, values_at(space, point)), rng)
    return values if found is None or found == start else values_at(space, found)


def step_with_margins(search: Search, values: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """A random step from these values, shortened until it has the campaign's margins."""
    space = search.config.space(search.controller)
    to = shares(space, step_from(space, values, rng))
    point = shortened(shares(space, values), to, lambda point: margin_shortfall(search, values_at(space, point)))
    return values_at(space, point)


def search_record(search: Search, study: optuna.Study) -> list[str]:
    """Return the lines for the head of the controller file: search and result."""
    config = search.config
    last = config.seeds.first + config.seeds.count - 1
    flown = len(flown_values(study))
    cases = ", ".join(one.case.name for one in config.cases)
    count = len(config.space(search.controller))
    core = "".join(f" {word}" for word in core_option(search.core))
    return [
        f"dmrac tune {search.name} --controller {Path(search.controller).stem} --trials {search.trials}{core}",
        f"cases {cases}; seeds {config.seeds.first} to {last}; {count} parameters; sampler seed {search.seed}",
        f"best mean cost {study.best_value:.4f} of {flown} flown trials (cost: experiments/campaigns/tuning.py)",
    ]


def tuned_values(search: Search, study: optuna.Study) -> dict[str, float]:
    """Return the best values by path in the controller file."""
    best = study.best_params
    return {path: best[one.name] for one in search.config.space(search.controller) for path in one.paths}
