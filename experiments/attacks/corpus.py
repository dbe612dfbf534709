"""Flies the corpus of bad learners, and the law without learnt features beside it for comparison."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.attacks.attack_flight import AttackOutcome, fly_attack
from experiments.attacks.cases import SILENT
from experiments.campaigns.worker_pools import LocalPool
from experiments.flights.scenario import Choices, resolve
from onboard.cores import NUMPY, check_core

COMPARED: Final = "bias"
"""The controller without learnt features, which no version reaches."""


@dataclass(frozen=True)
class CorpusRow:
    """All flights of a case."""

    case: str
    flights: int
    lost: int
    error_ratio_to_bias: float
    """Median over the flights of the RMS error from the attack on, over that of `bias` with the same seed."""
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
        numbers = (str(self.flights), str(self.lost), f"{self.error_ratio_to_bias:.2f}", f"{self.worst_m:.3f}")
        return self.case, *numbers, str(self.accepted), refused


def fly_corpus(
    cases: Sequence[str],
    seeds: Iterable[int],
    scenario: str,
    controller: str,
    assignments: tuple[str, ...],
    workers: int,
    core: str = NUMPY,
) -> list[CorpusRow]:
    """Fly every case with every seed, with one of onboard.cores.CORES. Raises ConfigError."""
    for flown in dict.fromkeys((controller, COMPARED)):
        check_core(core, resolve(scenario, Choices(flown)).onboard)
    numbers = list(seeds)
    own = tuple(one for one in assignments if not one.startswith("onboard.controller"))
    pool = LocalPool(workers)
    try:
        executor = pool.open()
        plain = {
            seed: executor.submit(fly_attack, SILENT, seed, scenario, assignments=own, controller=COMPARED, core=core)
            for seed in numbers
        }
        flights = {
            case: [
                executor.submit(
                    fly_attack, case, seed, scenario, assignments=assignments, controller=controller, core=core
                )
                for seed in numbers
            ]
            for case in cases
        }
        errors = [plain[seed].result().error_m for seed in numbers]
        return [_row(case, [flight.result() for flight in flights[case]], errors) for case in cases]
    finally:
        pool.close()


def _row(case: str, outcomes: list[AttackOutcome], errors: list[float]) -> CorpusRow:
    ratios = [one.error_m / error for one, error in zip(outcomes, errors, strict=True)]
    return CorpusRow(
        case,
        len(outcomes),
        sum(bool(one.lost) for one in outcomes),
        float(np.median(ratios)),
        max(one.worst_m for one in outcomes),
        sum(one.swaps for one in outcomes),
        Counter(reason for one in outcomes for reason in one.refused.values()),
    )
