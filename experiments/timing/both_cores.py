"""Times a tick of both onboard cores in one process, in turns, on the datagrams of one flight.

    python -m experiments.timing.both_cores CONTROLLER ...

It needs a C compiler.
"""

import sys
import time
from typing import Any, Final

from experiments.flights.lockstep_flight import ONBOARD_SESSION
from experiments.flights.scenario import Choices, resolve
from experiments.timing.step_timing import Quantiles, RecordedTicks, quantiles_us, record_flight
from onboard.cores import CORES, AnyCore, build_core
from protocol.keys import LinkKeys

INSIDE: Final = "calls of C"
"""The part of a tick of the C core that is C."""
SECONDS: Final = 7.0
ROUNDS: Final = 3


class _Stopwatch:
    """A library whose functions of the core are timed."""

    def __init__(self, library: Any) -> None:
        self._library = library
        self.spent_ns = 0

    def __getattr__(self, name: str) -> Any:
        function = getattr(self._library, name)
        if not name.startswith("core_"):
            return function

        def timed(*arguments: Any) -> Any:
            start = time.perf_counter_ns()
            try:
                return function(*arguments)
            finally:
                self.spent_ns += time.perf_counter_ns() - start

        return timed


def measure_cores(controller: str, seconds: float = SECONDS, rounds: int = ROUNDS) -> dict[str, Quantiles]:
    """Return p50, p99 and max of a tick, us, of each core and of the calls of C in it, on a flight of figure8_wind.

    Raises
    ------
    ConfigError
        If there is no such controller, or the C core cannot be built or does not have it.
    """
    config = resolve("figure8_wind", Choices(controller, 3, seconds + 5.0))  # the landing comes later
    recording = record_flight(config, seconds)
    spent: dict[str, list[int]] = {name: [] for name in (*CORES, INSIDE)}
    for _ in range(rounds):
        cores = {name: build_core(name, config.onboard, ONBOARD_SESSION, LinkKeys(None, None, None)) for name in CORES}
        for index in range(len(recording.now_ns)):
            for name in CORES if index % 2 else reversed(CORES):
                spent[name].append(_timed_tick(cores[name], recording, index))
    spent[INSIDE] = _inside(build_core("c", config.onboard, ONBOARD_SESSION, LinkKeys(None, None, None)), recording)
    return {name: quantiles_us(durations) for name, durations in spent.items()}


def _timed_tick(core: AnyCore, recording: RecordedTicks, index: int) -> int:
    start = time.perf_counter_ns()
    core.tick(recording.now_ns[index], recording.vehicle[index], recording.offboard[index])
    return time.perf_counter_ns() - start


def _inside(core: Any, recording: RecordedTicks) -> list[int]:
    watch = core._library = _Stopwatch(core._library)
    spent = []
    for index in range(len(recording.now_ns)):
        watch.spent_ns = 0
        _timed_tick(core, recording, index)
        spent.append(watch.spent_ns)
    return spent


def main(controllers: list[str]) -> None:
    """Print a table of the medians."""
    print(f"| controller | {' | '.join((*CORES, INSIDE))} |\n|---|---|---|---|")
    for controller in controllers:
        medians = (f"{p50:.0f} us" for p50, _, _ in measure_cores(controller).values())
        print(f"| {controller} | {' | '.join(medians)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
