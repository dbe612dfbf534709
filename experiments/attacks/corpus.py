"""Flies the corpus of bad learners, and the law without learnt features beside it for comparison."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from experiments.attacks.attack_flight import AttackFlight, AttackOutcome
from experiments.attacks.cases import SILENT
from experiments.attacks.conditions import condition_assignments
from experiments.attacks.journal import Journal
from experiments.campaigns.worker_pools import LocalPool
from experiments.flights.scenario import Choices, resolve
from onboard.cores import check_core

COMPARED: Final = "bias"
"""The controller without learnt features, which no version reaches."""
OF_THE_CONTROLLER: Final = "onboard.controller"


@dataclass(frozen=True)
class CorpusRow:
    """All flights of a case."""

    case: str
    flights: int
    lost: int
    error_ratio_to_bias: float
    """Median over the flights of the RMS error from the attack on, over that of `bias` in the same air and seed."""
    largest_ratio: float
    worst_m: float
    accepted: int
    refused: Counter[str]

    def summary(self) -> dict[str, object]:
        """What `--json` prints."""
        ratio = round(self.error_ratio_to_bias, 3)
        return {"case": self.case, "flights": self.flights, "lost": self.lost, "error_ratio_to_bias": ratio}

    def cells(self) -> tuple[str, ...]:
        """The row of the table."""
        refused = ", ".join(f"{reason} {count}" for reason, count in self.refused.most_common())
        ratios = f"{self.error_ratio_to_bias:.2f}", f"{self.largest_ratio:.2f}"
        return self.case, str(self.flights), str(self.lost), *ratios, f"{self.worst_m:.3f}", str(self.accepted), refused


def plain_flight(flight: AttackFlight) -> AttackFlight:
    """The flight of `bias` that one of a bad learner is compared with: the same air, seed and vehicle."""
    own = tuple(one for one in flight.assignments if not one.startswith(OF_THE_CONTROLLER))
    return replace(flight, case=SILENT, controller=COMPARED, assignments=own)


def check(flights: Iterable[AttackFlight]) -> None:
    """Raise ConfigError for a condition that the scenario cannot have, or a core that cannot fly the controllers."""
    wanted = list(flights)
    both = [*map(plain_flight, wanted), *wanted]
    for scenario, condition, controller, core in {(f.scenario, f.condition, f.controller, f.core) for f in both}:
        condition_assignments(condition, scenario)
        check_core(core, resolve(scenario, Choices(controller)).onboard)


def fly_corpus(
    flights: Iterable[AttackFlight],
    journal: Journal,
    workers: int,
    report: Callable[[AttackFlight, AttackOutcome], None] = lambda _flight, _outcome: None,
) -> list[CorpusRow]:
    """Fly what the journal lacks, store it there, and return one row for each case.

    report: called with each flight that was flown now, those of `bias` included.
    """
    wanted = list(dict.fromkeys(flights))
    both = list(dict.fromkeys([*map(plain_flight, wanted), *wanted]))
    pool = LocalPool(workers, recycle=False)
    try:
        executor = pool.open()
        futures = {executor.submit(one.fly): one for one in both if journal.find(one) is None}
        for future in as_completed(futures):
            flight, outcome = futures[future], future.result()
            journal.add(flight, outcome)
            report(flight, outcome)
    finally:
        pool.close()
    return [_row(case, [one for one in wanted if one.case == case], journal) for case in _cases(wanted)]


def _cases(flights: Sequence[AttackFlight]) -> list[str]:
    return list(dict.fromkeys(one.case for one in flights))


def error_ratio(flight: AttackFlight, journal: Journal) -> float:
    """RMS error of a flight from the attack on, over that of `bias`. Both must have been flown."""
    attacked, plain = journal.find(flight), journal.find(plain_flight(flight))
    assert attacked is not None
    assert plain is not None
    return attacked.error_m / plain.error_m


def _row(case: str, flights: Sequence[AttackFlight], journal: Journal) -> CorpusRow:
    found = [journal.find(flight) for flight in flights]
    outcomes = [one for one in found if one is not None]
    ratios = [error_ratio(flight, journal) for flight in flights]
    return CorpusRow(
        case,
        len(outcomes),
        sum(bool(one.lost) for one in outcomes),
        float(np.median(ratios)),
        max(ratios),
        max(one.worst_m for one in outcomes),
        sum(one.swaps for one in outcomes),
        Counter(reason for one in outcomes for reason in one.refused.values()),
    )
