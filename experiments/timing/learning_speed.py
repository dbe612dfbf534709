"""Measures offboard: a round of training on the samples of a flight, and adding a sample to a full buffer."""

from dataclasses import replace
from time import thread_time
from typing import Any, Final

import numpy as np

from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import FlightConfig
from offboard.training.fleet import Fleet

BATCHES: Final = 100
BATCH_SIZE: Final = 64
CAPACITY: Final = 1000
FEATURES: Final = 39
"""Of both channels."""
INPUTS: Final = 6
FLIGHT_MAX_S: Final = 20.0


def training_round_ms(config: FlightConfig, runs: int = 5) -> float:
    """Return the time of 100 mini-batches of 64, both channels, on a flight's first samples: best of `runs`, core ms.

    Raises
    ------
    RuntimeError
        If the flight gives no samples to train on.
    """
    job = _first_job(config)
    job = replace(job, config=job.config.model_copy(update={"batch_size": BATCH_SIZE, "batches": BATCHES}))
    return min(_timed_ms(job.run) for _ in range(runs))


def fleet_round_ms(config: FlightConfig, vehicles: int, runs: int = 5) -> float:
    """Return the time of a round as configured for so many vehicles with a flight's first samples: best, core ms.

    Raises
    ------
    RuntimeError
        If the flight gives no samples to train on.
    """
    job, fleet = _first_job(config), Fleet()

    def train_all() -> None:
        for entered in [fleet.enter(replace(job, vehicle=number)) for number in range(1, vehicles + 1)]:
            entered.run()

    return min(_timed_ms(train_all) for _ in range(runs))


def _first_job(config: FlightConfig) -> Any:
    lockstep, *_ = build(config)
    for _ in range(round(FLIGHT_MAX_S * 1e9 / config.onboard.period_ns)):
        output = lockstep.step().offboard
        if output is not None and output.job is not None:
            return output.job
    raise RuntimeError(f"{config.scenario} with {config.controller}: nothing to train on in {FLIGHT_MAX_S:g} s")


def admission_ms(samples: int = 100) -> float:
    """Return the time of kernel test, best swap and replacement in a full buffer of 1000: median, ms of a core."""
    from offboard.data.novelty import KernelNovelty, swap_for_largest_sigma_min

    rng = np.random.default_rng(3)
    novelty = KernelNovelty(CAPACITY, INPUTS)
    for slot in range(CAPACITY):
        novelty.add(slot, rng.normal(0.0, 2.0, INPUTS))
    Phi = np.tanh(rng.normal(0.0, 1.0, (CAPACITY, FEATURES)))
    gram = Phi.T @ Phi

    def admit() -> None:
        x = rng.normal(0.0, 2.0, INPUTS)
        novelty.gamma(x)
        novelty.replace(swap_for_largest_sigma_min(Phi, gram, np.tanh(rng.normal(0.0, 1.0, FEATURES))), x)

    return float(np.median([_timed_ms(admit) for _ in range(samples)]))


def _timed_ms(work: Any) -> float:
    start = thread_time()
    work()
    return (thread_time() - start) * 1e3
