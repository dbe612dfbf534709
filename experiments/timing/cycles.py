"""Cycles of the drone's processor, call by call and block by block, in a flight with everything that belongs to it.

    python -m experiments.timing.cycles figure8_wind --duration 30

One call is one tick of 5 ms: 2.08 million cycles of 416 MHz. Caches are not modelled (mambo/cycles/count.c).
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from experiments.flights.lockstep_flight import OFFBOARD_SESSION, build_offboard
from experiments.flights.scenario import Choices, FlightConfig, resolve, with_pose_wait
from mambo.cycles.blocks import BLOCKS
from mambo.cycles.measure import PERIOD_CYCLES, build_counter
from mambo.fake.firmware_core import FirmwareCore
from mambo.vehicles import RADIO
from offboard.training.job import TrainingResult
from onboard.record.tick import OFFSET
from protocol.conventions import Array
from protocol.keys import LinkKeys
from protocol.session import session_start_ns
from sim_vehicle.link.radio import RADIO_STREAM, Radio
from sim_vehicle.lockstep import Lockstep
from sim_vehicle.vehicle import SimVehicle

PERCENTILES: Final = (50.0, 99.0, 100.0)


class CycleRecord(NamedTuple):
    """The calls of a flight."""

    blocks: Array
    """[calls, blocks] cycles, in the order of BLOCKS."""
    instructions: Array
    """[calls]."""
    swapped: Array
    """[calls], whether the call swapped in a feature version."""

    @property
    def total(self) -> Array:
        """[calls] cycles."""
        total: Array = self.blocks.sum(axis=1)
        return total


def count_cycles(config: FlightConfig, with_offboard: bool = True) -> CycleRecord:
    """Fly in lockstep with a stand-in that counts.

    Raises
    ------
    BuildError, ConfigError
        Without compilers or qemu.
    """
    config = config if with_offboard else with_pose_wait(config)
    with TemporaryDirectory() as folder:
        counter = build_counter(Path(folder))
        core = FirmwareCore("mambo-qemu", config.onboard, LinkKeys(None, None, None), command=counter.command)
        vehicle = SimVehicle(config.vehicle, config.seed)
        vehicle.start_capture(session_start_ns(OFFBOARD_SESSION))
        radio = Radio(config.radio, np.random.default_rng([config.seed, RADIO_STREAM]))
        offboard = build_offboard(config, OFFBOARD_SESSION) if with_offboard else None
        period_ns = config.onboard.period_ns
        lockstep: Lockstep[TrainingResult] = Lockstep(
            vehicle, radio, core, offboard, period_ns, round(config.training_time_s * 1e9)
        )
        ticks = [lockstep.step().onboard.tick for _ in range(round(config.duration_s * 1e9 / period_ns))]
        core.close()
        cycles = counter.cycles()
    versions = np.array([tick[OFFSET["feature_version"]] for tick in ticks])[-len(cycles) :]
    swapped = np.diff(versions, prepend=versions[0]) != 0
    return CycleRecord(cycles[:, :-1], cycles[:, -1], swapped)


def table(record: CycleRecord) -> str:
    """Cycles and share of the period by block, as Markdown: all calls, and those that swapped a version."""
    names = [f"p{level:g}" if level < 100 else "most" for level in PERCENTILES]
    lines = [f"| block | mean | {' | '.join(names)} | share of the period, p99 |", f"|---|{'---|' * (len(names) + 2)}"]
    rows = [*zip(BLOCKS, record.blocks.T, strict=True), ("**whole call**", record.total)]
    if record.swapped.any():
        rows.append(("whole call, of those that swap a version", record.total[record.swapped]))
    for name, cycles in rows:
        levels = [np.percentile(cycles, level) for level in PERCENTILES]
        numbers = " | ".join(f"{value / 1e3:.1f} k" for value in (cycles.mean(), *levels))
        lines.append(f"| {name} | {numbers} | {levels[1] / PERIOD_CYCLES:.1%} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table of a flight."""
    parser = argparse.ArgumentParser(description="cycles of the drone's processor by block")
    parser.add_argument("scenario", nargs="?", default="figure8_wind")
    parser.add_argument("--controller", default="dmrac")
    parser.add_argument("--duration", type=float, default=30.0, metavar="S")
    parser.add_argument("--no-offboard", action="store_true")
    arguments = parser.parse_args()
    config = resolve(arguments.scenario, Choices(arguments.controller, duration_s=arguments.duration, radio=RADIO))
    record = count_cycles(config, not arguments.no_offboard)
    print(table(record))
    print(f"\n{len(record.total)} calls, {record.swapped.sum()} swaps, {record.instructions.mean():.0f} instructions")


if __name__ == "__main__":
    main()
