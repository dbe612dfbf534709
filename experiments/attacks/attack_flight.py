"""Flies one bad learner in lockstep."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from configs.loader import CONFIG_DIRECTORY, load
from experiments.attacks.bad_learner import BadLearner, Case
from experiments.attacks.cases import ATTACK_S, CASES
from experiments.attacks.conditions import AS_CONFIGURED, condition_assignments
from experiments.flights.lockstep_flight import OFFBOARD_SESSION, build
from experiments.flights.metrics import TARGET_DISTANCE_MAX_M
from experiments.flights.scenario import Choices, resolve
from onboard.cores import NUMPY
from onboard.flight.modes import FlightMode
from onboard.record.tick import OFFSET
from sim_vehicle.link.radio import RadioConfig

DURATION_S: Final = 14.0
"""About four seconds of it are the attack, two the landing."""
BRISK: Final = tuple(f"onboard.guidance.trajectory.{name}" for name in ("takeoff_s=2.0", "settle_s=0.2", "ramp_s=1.0"))
"""At full speed on the path soon."""
_TARGET: Final = slice(OFFSET["target_n"], OFFSET["target_n"] + 3)
_MODE: Final = OFFSET["mode"]


@dataclass(frozen=True)
class AttackFlight:
    """One flight of a bad learner."""

    case: str
    """Of experiments.attacks.cases."""
    seed: int
    condition: str = AS_CONFIGURED
    """Of experiments.attacks.conditions."""
    scenario: str = "figure8_wind"
    controller: str = "dmrac"
    assignments: tuple[str, ...] = ()
    """After those of the condition."""
    duration_s: float = DURATION_S
    core: str = NUMPY
    """One of onboard.cores.CORES."""

    def fly(self) -> "AttackOutcome":
        """Fly it, over a link that loses nothing. Raises ConfigError."""
        assignments = (*condition_assignments(self.condition, self.scenario), *self.assignments)
        return fly_attack(
            *(self.case, self.seed, self.scenario, self.duration_s, assignments, self.controller, self.core)
        )


@dataclass(frozen=True)
class AttackOutcome:
    """What an attack did."""

    case: str
    seed: int
    lost: str
    """Why the vehicle was lost; empty if it was not."""
    lost_after_s: float
    """s from the beginning of the attack; -1 if it was not lost."""
    error_m: float
    """RMS distance to the path from the beginning of the attack on."""
    worst_m: float
    swaps: int
    refused: dict[int, str]
    """Reason for each version refused."""
    events: list[str]


def fly_attack(
    case: str,
    seed: int,
    scenario: str = "figure8_wind",
    duration_s: float = DURATION_S,
    assignments: tuple[str, ...] = (),
    controller: str = "dmrac",
    core: str = NUMPY,
    case_of: Callable[[], Case] | None = None,
) -> AttackOutcome:
    """Fly a case of experiments.attacks.cases, or what `case_of` makes, over a link that loses nothing.

    core: one of onboard.cores.CORES.
    """
    config = resolve(scenario, Choices(controller, seed, duration_s, (*BRISK, *assignments)))
    perfect = load(RadioConfig, CONFIG_DIRECTORY / "radio" / "perfect.yaml")
    lockstep, onboard, offboard, _ = build(config.model_copy(update={"radio": perfect}), core=core)
    assert offboard is not None
    learner = BadLearner(config, OFFBOARD_SESSION, CASES[case]() if case_of is None else case_of())
    lockstep.attach_offboard(learner)
    period_s = config.onboard.period_ns * 1e-9
    errors: list[float] = []
    events: list[str] = []
    lost, lost_after = "", -1.0
    for _ in range(round(duration_s / period_s)):
        result = lockstep.step()
        events += [f"{when * 1e-9:.2f} {text}" for when, text in result.onboard.events]
        tick = result.onboard.tick
        flying = int(tick[_MODE]) in (FlightMode.FLYING, FlightMode.HOLD, FlightMode.HOLD_LEVEL)
        if learner.view.time_s >= ATTACK_S and flying:
            errors.append(float(np.linalg.norm(result.truth[:3] - tick[_TARGET])))
        lost = lockstep.crash_reason
        if not lost and errors and errors[-1] > TARGET_DISTANCE_MAX_M:
            lost = f"more than {TARGET_DISTANCE_MAX_M} m from the path"
        if lost:
            lost_after = learner.view.time_s - ATTACK_S
            break
    squares = np.square(errors) if errors else np.zeros(1)
    features = onboard.summary()["features"]
    return AttackOutcome(
        *(case, seed, lost, lost_after, float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))),
        features["swaps"],
        dict(learner.view.refused),
        events,
    )
