"""For tests of the link: flights and cores whose peer, clock and datagrams a test may change."""

from typing import Any

import numpy as np

from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import Choices, FlightConfig, resolve
from offboard.core import OffboardCore
from onboard.core import OnboardCore
from onboard.flight.modes import FlightMode
from onboard.record.tick import OFFSET
from onboard.sampling.sampler import NETWORK_BYTES

MS = 1_000_000
S = 1_000_000_000
KEY = bytes(range(32))
UP_FOR_NS = 3_000 * S
"""Offboard's clock is ahead of onboard's by this time."""
LEARNING = (
    "offboard.trainer.minimum_samples=16",
    "offboard.trainer.batches=20",
    "offboard.gate.minimum_validation=2",
    "offboard.gate.trigger=0.0",
    "offboard.gate.margin=0.0",
    "offboard.gate.significance=0.0",
    "features.trained.channels=[position]",
    "onboard.guidance.trajectory.settle_s=0.0",
    "onboard.guidance.land_after_s=60.0",
)


class Shifted:
    """A core with its own clock, which jumps: (when, by how much), ns."""

    def __init__(self, core: Any, ahead_ns: int, *jumps: tuple[int, int]) -> None:
        self.core, self.ahead_ns, self.jumps = core, ahead_ns, jumps

    def at(self, now_ns: int) -> int:
        return now_ns + self.ahead_ns + sum(by for when, by in self.jumps if now_ns >= when)

    def tick(self, now_ns: int, *datagrams: Any) -> Any:
        return self.core.tick(self.at(now_ns), *datagrams)

    def receive_onboard(self, datagram: bytes, now_ns: int) -> None:
        self.core.receive_onboard(datagram, self.at(now_ns))

    def receive_motion_capture(self, datagram: bytes, now_ns: int) -> None:
        self.core.receive_motion_capture(datagram, self.at(now_ns))

    def receive_training(self, result: Any, now_ns: int) -> None:
        self.core.receive_training(result, self.at(now_ns))

    def step(self, now_ns: int) -> Any:
        return self.core.step(self.at(now_ns))


class Flight:
    """A lockstep flight whose parts a test can replace in the air."""

    def __init__(self, controller: str = "dmrac", seed: int = 11, assignments: tuple[str, ...] = LEARNING) -> None:
        self.config: FlightConfig = resolve("figure8_wind", Choices(controller, seed, None, assignments))
        self.lockstep, self.onboard, self.offboard, self.radio = build(self.config)
        self.events: list[str] = []
        self.rows: list[np.ndarray] = []
        self.errors_m: list[float] = []
        self.up: list[tuple[int, int]] = []

    def with_key(self) -> "Flight":
        """Protect the link with a key, before the first tick."""
        self.onboard = self.lockstep._onboard = OnboardCore(self.config.onboard, 1, KEY)
        self.offboard = Side(self.config, 2).core
        self.lockstep.attach_offboard(self.offboard)
        return self

    def fly(self, seconds: float) -> "Flight":
        for _ in range(round(seconds * 200)):
            result = self.lockstep.step()
            row = result.onboard.tick.copy()
            self.rows.append(row)
            self.events += [text for _, text in result.onboard.events]
            if result.offboard is not None:
                self.events += [text for _, text in result.offboard.events]
            target = row[OFFSET["target_n"] : OFFSET["target_n"] + 3]
            self.errors_m.append(float(np.linalg.norm(result.truth[:3] - target)))
            self.up += [(result.now_ns, len(datagram) + NETWORK_BYTES) for datagram in result.onboard.to_offboard]
            assert self.lockstep.crash_reason == ""
        return self

    def last(self, name: str) -> float:
        return float(self.rows[-1][OFFSET[name]])

    @property
    def mode(self) -> FlightMode:
        return FlightMode(int(self.last("mode")))

    def reported(self, words: str) -> list[str]:
        return [event for event in self.events if words in event]


class Side:
    """The offboard core with a key."""

    def __init__(self, config: FlightConfig, session: int) -> None:
        self.core = OffboardCore(config.offboard, session, KEY)


class Wire:
    """Onboard's core on the ground, connected to offboard by a wire that loses nothing and records all datagrams up."""

    def __init__(self, onboard: OnboardCore, offboard: Side) -> None:
        self.onboard, self.offboard = onboard, offboard
        self.sent_up: list[bytes] = []
        self.down: list[bytes] = []

    def run(self, start_ns: int, seconds: float) -> None:
        for now_ns in range(start_ns, start_ns + round(seconds * S), 5 * MS):
            for datagram in self.onboard.tick(now_ns, from_offboard=self.down).to_offboard:
                self.sent_up.append(datagram)
                self.offboard.core.receive_onboard(datagram, now_ns + UP_FOR_NS)
            self.down = self.offboard.core.step(now_ns + UP_FOR_NS).to_onboard
