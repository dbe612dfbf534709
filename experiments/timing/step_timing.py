"""Times the onboard step: a recorded flight is replayed into a new core, block by block, back to back or paced."""

import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.flights.lockstep_flight import ONBOARD_SESSION, build
from experiments.flights.lockstep_log import datagram_record
from experiments.flights.scenario import FlightConfig
from flight_log.writer import FlightLogWriter
from onboard.core import OnboardCore, OnboardOutput
from onboard.process import LOOP
from onboard.record.datagram_log import TOPIC, DatagramLogWriter
from onboard.record.tick import TICK
from runtime.pace import PaceKeeper
from sim_vehicle.lockstep import OnboardOutput as LockstepOutput

STEP: Final = "whole tick"
BLOCKS: Final = (
    ("MAVLink in", "_vehicle_link.receive"),
    ("msgpack in", "_receive_offboard"),
    ("estimator", "_estimate"),
    ("supervisor", "_supervise"),
    ("guidance", "_guide"),
    ("feature swap", "_swap_features"),
    ("controller", "_control"),
    ("mixer", "_mix"),
    ("samples out", "_sample"),
    ("status, ground", "_report"),
)
"""Name of each block, and its method of onboard.core.OnboardCore."""
LAW: Final = "adaptive law"
"""The augmentations of both channels, with features and adaptation; part of the controller."""
BOUND: Final = "live bound"
"""Of both channels; part of the controller."""
LOG: Final = "flight log"
"""The log of a tick: tick record, loop record and every datagram. Not included in the whole tick."""
Quantiles = tuple[float, float, float]
"""p50, p99 and max, us."""
TURN_S: Final = 2.5
"""The loop and the bare loop run in turns of this length."""


@dataclass(slots=True)
class RecordedTicks:
    """The datagrams that onboard received in each tick of a flight."""

    now_ns: list[int] = field(default_factory=list)
    vehicle: list[list[bytes]] = field(default_factory=list)
    offboard: list[list[bytes]] = field(default_factory=list)


@dataclass(slots=True)
class Stopwatch:
    """Sums the time spent in wrapped methods over each tick."""

    now: dict[str, int] = field(default_factory=dict)
    ticks: dict[str, list[int]] = field(default_factory=dict)

    def expect(self, name: str) -> None:
        """Add a sum of this name to each tick."""
        self.now[name] = 0
        self.ticks[name] = []

    def wrap(self, owner: object, method: str, name: str) -> None:
        """Time every call of `owner.method`, on this one object."""
        inner: Callable[..., Any] = getattr(owner, method)
        clock, spent = time.perf_counter_ns, self.now
        self.expect(name)

        def timed(*arguments: Any, **named: Any) -> Any:
            start = clock()
            try:
                return inner(*arguments, **named)
            finally:
                spent[name] += clock() - start

        setattr(owner, method, timed)

    def end_tick(self) -> None:
        """Store the sums of a tick."""
        for name, spent in self.now.items():
            self.ticks[name].append(spent)
            self.now[name] = 0

    def quantiles_us(self, name: str) -> Quantiles:
        """Return p50, p99 and max of a tick's sum, us."""
        return quantiles_us(self.ticks[name])


def quantiles_us(durations_ns: Iterable[int]) -> Quantiles:
    """Return p50, p99 and max, us."""
    p50, p99, highest = np.quantile(np.fromiter(durations_ns, dtype=np.float64), (0.5, 0.99, 1.0)) * 1e-3
    return float(p50), float(p99), float(highest)


Observer = Callable[[LockstepOutput], None]


def record_flight(config: FlightConfig, seconds: float, observe: Observer = lambda output: None) -> RecordedTicks:
    """Record the datagrams that onboard receives in the first `seconds` of a lockstep flight with an offboard side.

    `observe` is called with onboard's output of each tick.
    """
    lockstep, *_ = build(config)
    recording = RecordedTicks()
    for _ in range(round(seconds * 1e9 / config.onboard.period_ns)):
        result = lockstep.step()
        recording.vehicle.append(list(result.from_vehicle))
        recording.offboard.append(list(result.from_offboard))
        recording.now_ns.append(result.now_ns)
        observe(result.onboard)
    return recording


class Replay:
    """Replays a recording into a new onboard core, tick by tick, and times it; `log` receives the log of each tick."""

    def __init__(
        self, config: FlightConfig, recording: RecordedTicks, blocks: bool, log: FlightLogWriter | None = None
    ) -> None:
        self._core = OnboardCore(config.onboard, ONBOARD_SESSION, None)
        self._recording = recording
        self._next = 0
        self._log = log
        self._datagrams = DatagramLogWriter()
        self._loop_record = np.zeros(len(LOOP.fields))
        self.observe: Observer | None = None
        """Called with the output of each tick."""
        self.watch = Stopwatch()
        if blocks:
            for name, method in BLOCKS:
                owner, _, method = method.rpartition(".")
                self.watch.wrap(attrgetter(owner)(self._core) if owner else self._core, method, name)
            self.watch.expect(LAW)  # a controller of another build may have none of these two
            self.watch.expect(BOUND)
            if hasattr(self._core.controller, "bounds"):
                self.watch.wrap(self._core.controller.bounds, "step", BOUND)
            for augmentation in getattr(self._core.controller, "augmentations", ()):
                self.watch.wrap(augmentation, "step", LAW)
        self.watch.wrap(self, "tick", STEP)
        self.watch.wrap(self, "write_log", LOG)

    @property
    def left(self) -> int:
        """Number of ticks that are left."""
        return len(self._recording.now_ns) - self._next

    def step(self) -> None:
        """Run and log one tick, with timing."""
        output = self.tick()
        if self._log is not None:
            self.write_log(output, self._log)
        self._next += 1
        self.watch.end_tick()

    def tick(self) -> OnboardOutput:
        """Run one tick as the process does, without sockets and log."""
        recording, index = self._recording, self._next
        output = self._core.tick(recording.now_ns[index], recording.vehicle[index], recording.offboard[index])
        if self.observe is not None:
            self.observe(output)
        return output

    def write_log(self, output: OnboardOutput, log: FlightLogWriter) -> None:
        """Log a tick as the process does."""
        now, index = self._recording.now_ns[self._next], self._next
        log.write(TICK, now, output.tick)
        for time_ns, text in output.events:
            log.event(time_ns, text)
        inputs = self._recording.vehicle[index], self._recording.offboard[index]
        log.write_bytes(TOPIC, now, datagram_record(self._datagrams, now, *inputs, output))
        log.write(LOOP, now, self._loop_record)


def run_hot(replay: Replay) -> None:
    """Run all ticks back to back."""
    while replay.left:
        replay.step()


def run_paced(replay: Replay, period_ns: int, spin_ns: int) -> tuple[list[int], list[int]]:
    """Run all ticks at the loop's pace, in turns with an empty loop; return the lateness of both, ns."""
    ours: list[int] = []
    bare: list[int] = []
    turn = round(TURN_S * 1e9 / period_ns)
    while replay.left:
        pace = PaceKeeper(period_ns, spin_ns, time.monotonic_ns() + period_ns)
        for _ in range(min(turn, replay.left)):
            pace.wait()
            replay.step()
            ours.append(pace.lateness_ns)
        pace = PaceKeeper(period_ns, spin_ns, time.monotonic_ns() + period_ns)
        for _ in range(turn):
            pace.wait()
            bare.append(pace.lateness_ns)
    return ours, bare


def measure_step(
    config: FlightConfig, recording: RecordedTicks
) -> tuple[dict[str, dict[str, Quantiles]], dict[str, Quantiles]]:
    """Return {block: {"paced", "hot": (p50, p99, max)}} and the lateness of the loop and of the bare loop, us.

    The whole tick and its log are timed without the blocks' stopwatches, which cost a few us themselves.
    """
    blocks = (*(name for name, _ in BLOCKS), LAW, BOUND)
    whole, lateness = _timed(config, recording, blocks=False)
    parts, _ = _timed(config, recording, blocks=True)
    steps = {STEP: whole[STEP], **{name: parts[name] for name in blocks}, LOG: whole[LOG]}
    return steps, lateness


def _timed(
    config: FlightConfig, recording: RecordedTicks, blocks: bool
) -> tuple[dict[str, dict[str, Quantiles]], dict[str, Quantiles]]:
    """Replay the recording once back to back and once paced, with the log of a flight."""
    period_ns, spin_ns = config.onboard.period_ns, config.onboard.realtime.spin_us * 1000
    with tempfile.TemporaryDirectory(prefix="dmrac_bench_") as folder:
        with FlightLogWriter(Path(folder) / "hot.mcap", "onboard") as log:
            run_hot(hot := Replay(config, recording, blocks, log))
        with FlightLogWriter(Path(folder) / "paced.mcap", "onboard") as log:
            ours, bare = run_paced(paced := Replay(config, recording, blocks, log), period_ns, spin_ns)
    steps = {
        name: {"paced": paced.watch.quantiles_us(name), "hot": hot.watch.quantiles_us(name)}
        for name in paced.watch.ticks
    }
    return steps, {"onboard loop": quantiles_us(ours), "bare loop": quantiles_us(bare)}
