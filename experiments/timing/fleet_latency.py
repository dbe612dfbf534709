"""`dmrac bench fleet`: how long a sample takes to become weights that fly, with several vehicles on one trainer.

Real: the trainer, a process of its own with torch, and its links, over UDP in real time. Each vehicle is simulated at
200 Hz with the core in C, all of them in this process: sixteen onboard processes need more than two cores.
"""

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.flights.lockstep_flight import build
from experiments.flights.realtime_flight import Child, process_command
from experiments.flights.scenario import Choices, FlightConfig, resolve
from flight_log.reader import open_flight
from flight_log.schema import RecordType
from offboard.records import TRAINING
from offboard.training.job import TrainingJob, TrainingResult
from onboard.record.tick import OFFSET
from protocol.conventions import Array
from runtime.errors import StartError
from runtime.sockets import DatagramSocket
from sim_vehicle.lockstep import Lockstep

FLEETS: Final = (1, 8, 16)
RATIO_MAX: Final = {8: 1.2, 16: 2.0}
"""Of the median latency to that of a single vehicle."""
MEDIAN_MAX_S: Final = 1.5
"""Of a single vehicle."""
SCENARIO: Final = "figure8_wind"
CONTROLLER: Final = "dmrac"
START_LIMIT_S: Final = 60.0
LATE_NS: Final = 5_000_000
"""A round of ticks that begins later than this is late: a whole period."""
DATAGRAMS_MAX: Final = 256
"""Of the trainer, per vehicle and tick."""
_VERSION: Final = OFFSET["feature_version"]


@dataclass
class RemoteOutput:
    """What has come from the trainer. It trains and logs by itself."""

    to_onboard: list[bytes]
    records: list[tuple[RecordType, int, Array]] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)
    job: TrainingJob | None = None


class RemoteOffboard:
    """The trainer's process in the place of a core (sim_vehicle.lockstep.Offboard): its datagrams, over UDP.

    Raises AddressInUseError if onboard's address is taken.
    """

    def __init__(self, config: FlightConfig) -> None:
        network = config.network
        self._link = DatagramSocket("network.onboard_link", network.onboard_link, network.offboard_link)
        self._capture = DatagramSocket("motion capture", "127.0.0.1:0", network.motion_capture)

    def receive_onboard(self, datagram: bytes, now_ns: int) -> None:
        """Send it to the trainer."""
        self._link.send(datagram)

    def receive_motion_capture(self, datagram: bytes, now_ns: int) -> None:
        """Send it to the trainer."""
        self._capture.send(datagram)

    def receive_training(self, result: TrainingResult, now_ns: int) -> None:
        """Results stay in the trainer's process."""
        raise NotImplementedError

    def step(self, now_ns: int) -> RemoteOutput:
        """What the trainer has sent."""
        return RemoteOutput(self._link.receive(DATAGRAMS_MAX))

    def close(self) -> None:
        """Close the sockets."""
        self._link.close()
        self._capture.close()


@dataclass(frozen=True)
class FleetLatency:
    """With so many vehicles. Latencies are from the newest sample of a round to its version in flight."""

    vehicles: int
    seconds: float
    versions: int
    """That flew, of all vehicles."""
    rounds: int
    """Of training, of all vehicles."""
    p50_s: float
    """NaN without a version."""
    p90_s: float
    late: float
    """Share of the ticks that began a period too late."""
    lost: int
    """Vehicles."""


def measure(most: int, seconds: float, show: Callable[[str], None]) -> list[FleetLatency]:
    """Measure with 1, 8 and 16 vehicles, as far as `most` allows, and with `most`.

    Raises
    ------
    StartError
        If the trainer does not start, or an address is taken.
    """
    found = []
    show("vehicles  versions flown   rounds     p50     p90  to one    late  lost")
    for vehicles in sorted({count for count in FLEETS if count <= most} | {most}):
        one = fleet_latency(vehicles, seconds)
        found.append(one)
        ratio = one.p50_s / found[0].p50_s
        show(
            f"{one.vehicles:8d} {one.versions:15d} {one.rounds:8d}  {one.p50_s:4.2f} s  {one.p90_s:4.2f} s"
            f"  {ratio:6.2f} {100.0 * one.late:5.1f} % {one.lost:5d}"
        )
    return found


def fleet_latency(vehicles: int, seconds: float) -> FleetLatency:
    """Fly so many vehicles for so long, with one trainer. Raises StartError as `measure` does."""
    configs = [_config(number, seconds) for number in range(1, vehicles + 1)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        trainer = _start_trainer(configs, out)
        try:
            flown, late, lost = _fly(configs, seconds, trainer)
        finally:
            trainer.end(10.0)
            trainer.tidy()
        folders = [out / f"vehicle_{number}" for number in range(1, vehicles + 1)] if vehicles > 1 else [out]
        tables = [open_flight(one)[TRAINING.topic] for one in folders]
        rounds = sum(json.loads((one / "offboard_summary.json").read_text())["rounds"] for one in folders)
    latencies_s = [
        flown[number][version] - newest
        for number, table in enumerate(tables)
        for version, newest in zip(table["sent_version"].astype(int), table["newest_sample"], strict=True)
        if version > 0 and version in flown[number]
    ]
    p50, p90 = np.percentile(latencies_s, [50, 90]) if latencies_s else (np.nan, np.nan)
    return FleetLatency(vehicles, seconds, len(latencies_s), rounds, float(p50), float(p90), late, lost)


def _config(number: int, seconds: float) -> FlightConfig:
    config = resolve(SCENARIO, Choices(CONTROLLER, seed=number, duration_s=max(seconds, 5.0), vehicle=number))
    direct = {"radio_onboard": config.network.offboard_link, "radio_offboard": config.network.onboard_link}
    return config.model_copy(update={"network": config.network.model_copy(update=direct)})


def _start_trainer(configs: Sequence[FlightConfig], out: Path) -> Child:
    files = [out / f"vehicle_{number}.yaml" for number in range(1, len(configs) + 1)]
    for file, config in zip(files, configs, strict=True):
        file.write_text(config.to_yaml(), encoding="utf-8")
    also = [word for file in files[1:] for word in ("--also", str(file))]
    trainer = Child("offboard", [*process_command("offboard", files[0], out), *also], out)
    limit = time.monotonic() + START_LIMIT_S
    while not trainer.ready and trainer.running and time.monotonic() < limit:
        trainer.lines()
        time.sleep(0.01)
    if not trainer.ready:
        trainer.kill()
        raise StartError(f"the trainer did not start: {trainer.last_error()}")
    return trainer


def _fly(configs: Sequence[FlightConfig], seconds: float, trainer: Child) -> tuple[list[dict[int, float]], float, int]:
    """Per vehicle the time at which each version began to fly, s; share of late ticks; lost vehicles."""
    remotes: list[RemoteOffboard] = []
    try:
        remotes += (RemoteOffboard(config) for config in configs)
        fleet: list[Lockstep[Any]] = [build(config, core="c")[0] for config in configs]
        for vehicle, remote in zip(fleet, remotes, strict=True):
            vehicle.attach_offboard(remote)
        return _paced(fleet, seconds, trainer, configs[0].onboard.period_ns)
    finally:
        for remote in remotes:
            remote.close()


def _paced(
    fleet: Sequence[Lockstep[Any]], seconds: float, trainer: Child, period_ns: int
) -> tuple[list[dict[int, float]], float, int]:
    flown: list[dict[int, float]] = [{} for _ in fleet]
    late, ticks, start_ns = 0, round(seconds * 1e9 / period_ns), time.monotonic_ns() + period_ns
    for tick in range(ticks):
        due_ns = start_ns + tick * period_ns
        wait_ns = due_ns - time.monotonic_ns()
        late += wait_ns < -LATE_NS
        time.sleep(max(wait_ns, 0) * 1e-9)
        for vehicle, versions in zip(fleet, flown, strict=True):
            if not vehicle.crash_reason:
                result = vehicle.step()
                versions.setdefault(int(result.onboard.tick.item(_VERSION)), result.now_ns * 1e-9)
        trainer.lines()
    return flown, late / ticks, sum(bool(vehicle.crash_reason) for vehicle in fleet)


def as_json(found: Sequence[FleetLatency]) -> list[dict[str, Any]]:
    """For JSON: the members of each, and whether its target is met; None where there is no target or no figure."""
    return [asdict(one) | {"met": _met(one, found[0])} for one in found]


def _met(one: FleetLatency, single: FleetLatency) -> bool | None:
    if np.isnan(one.p50_s) or np.isnan(single.p50_s):
        return None
    if one.vehicles == 1:
        return one.p50_s <= MEDIAN_MAX_S
    limit = RATIO_MAX.get(one.vehicles)
    return None if limit is None else one.p50_s <= limit * single.p50_s
