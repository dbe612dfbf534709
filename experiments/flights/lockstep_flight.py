"""Flies in lockstep: builds the cores, runs them on one virtual clock and returns the trace."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from experiments.flights.carried_experience import dump_learnt, read_experience, start_from
from experiments.flights.metrics import TARGET_DISTANCE_MAX_M
from experiments.flights.scenario import FlightConfig, with_pose_wait
from experiments.flights.trace import Columns, FlightTrace
from flight_log.schema import RecordType
from offboard.core import OffboardCore
from offboard.training.fleet import Fleet
from offboard.training.job import TrainingResult
from onboard.cores import CORES, NUMPY, AnyCore, build_core
from onboard.flight.supervisor import FlightMode
from onboard.record.tick import OFFSET, TICK
from protocol.conventions import Array
from protocol.keys import LinkKeys, load_key, load_keys
from protocol.session import session_start_ns
from sim_vehicle.link.radio import DIRECTIONS, RADIO_STREAM, Delivery, Direction, Radio, RecordedDeliveries
from sim_vehicle.lockstep import Lockstep, TickResult, Training, train_at_once
from sim_vehicle.records import TRUTH
from sim_vehicle.vehicle import SimVehicle

ONBOARD_SESSION = 1
OFFBOARD_SESSION = 2
_TARGET = OFFSET["target_n"]
"""The first of its three axes."""
_MODE = OFFSET["mode"]
_FOLLOWING = (FlightMode.FLYING.value, FlightMode.HOLD.value)

Deliveries = Mapping[Direction, Sequence[Delivery]]
Observer = Callable[[TickResult], None]
"""Called after every tick; the next tick overwrites its argument."""


@dataclass
class LockstepOutcome:
    """The result of a lockstep flight."""

    trace: FlightTrace
    crash_reason: str
    """Empty if the vehicle survived."""
    onboard: dict[str, Any]
    """onboard.cores.AnyCore.summary()."""
    offboard: dict[str, Any] | None
    radio: dict[str, dict[str, int]]
    trace_sha256: str
    events: list[tuple[int, str, str]] = field(default_factory=list)
    """(time_ns, process, text)."""
    offboard_records: list[tuple[RecordType, int, Array]] = field(default_factory=list)
    deliveries: Deliveries = field(default_factory=dict)
    """Delivery of each datagram of the link, by direction."""
    recordings: dict[Direction, RecordedDeliveries] = field(default_factory=dict)
    """How many of the recorded deliveries, if any, were used."""
    learnt: bytes = b""
    """Experience for another flight (experiments.flights.carried_experience)."""
    log_faults: list[str] = field(default_factory=list)
    """Why the flight's logs are incomplete, one line each."""


def build(
    config: FlightConfig,
    with_offboard: bool = True,
    recorded: Deliveries | None = None,
    fleet: Fleet | None = None,
    core: str = NUMPY,
    train: Training[TrainingResult] = train_at_once,
) -> tuple[Lockstep[TrainingResult], AnyCore, OffboardCore | None, Radio]:
    """Return the connected cores of a flight: lockstep, onboard, offboard (None if absent) and radio.

    with_offboard: without it no pose comes, and the vehicle is armed without one.
    recorded: deliveries that replace those of the configured radio.
    fleet: other vehicles of the same trainer.
    core: the onboard side, as of build_onboard.
    train: how rounds of training are run (experiments.flights.training_worker).
    """
    config = config if with_offboard else with_pose_wait(config)
    network = config.network
    keys = load_keys(network.key_file, network.vehicle_key_file, network.ground_key_file)
    vehicle = SimVehicle(config.vehicle, config.seed, keys.vehicle, load_key(network.capture_key_file))
    vehicle.start_capture(session_start_ns(OFFBOARD_SESSION))
    radio = Radio(config.radio, np.random.default_rng([config.seed, RADIO_STREAM]), recorded=recorded)
    onboard = build_onboard(core, config, keys)
    offboard = build_offboard(config, OFFBOARD_SESSION, fleet) if with_offboard else None
    training_ns = round(config.training_time_s * 1e9)
    cores = vehicle, radio, onboard, offboard
    return Lockstep(*cores, config.onboard.period_ns, training_ns, train), onboard, offboard, radio


def build_onboard(core: str, config: FlightConfig, keys: LinkKeys) -> AnyCore:
    """Return the onboard side: a core of onboard.cores.CORES, or the drone's library, by a name of mambo's VEHICLES."""
    if core in CORES:
        return build_core(core, config.onboard, ONBOARD_SESSION, keys)
    from mambo.fake.firmware_core import FirmwareCore  # nothing else needs its compilers

    return FirmwareCore(core, config.onboard, keys)


def build_offboard(config: FlightConfig, session: int, fleet: Fleet | None = None) -> OffboardCore:
    """Return the offboard core; its first round of training imports torch."""
    network = config.network
    return OffboardCore(config.offboard, session, load_key(network.key_file), fleet, load_key(network.capture_key_file))


def fly_lockstep(
    config: FlightConfig,
    observers: tuple[Observer, ...] = (),
    with_offboard: bool = True,
    experience: bytes | None = None,
    recorded: Deliveries | None = None,
    fleet: Fleet | None = None,
    core: str = NUMPY,
    train: Training[TrainingResult] = train_at_once,
) -> LockstepOutcome:
    """Fly a scenario in virtual time, until its duration is over or the vehicle crashes.

    Parameters
    ----------
    experience: what an earlier flight learnt (carried_experience); None: the file in the configuration, if any.
    recorded: deliveries of an earlier flight, by direction, for the datagrams of this one
        (sim_vehicle.link.radio.RecordedDeliveries).
    fleet: the vehicles of the same trainer, which have flown before; this one joins them.
    core, train: as of `build`. The flight is the same however its rounds are run.

    Raises
    ------
    ConfigError
        If the experience cannot be read, or does not fit this flight, or the core cannot fly it.
    """
    lockstep, onboard, offboard, radio = build(config, with_offboard, recorded, fleet, core, train)
    experience = read_experience(config) if experience is None else experience
    if experience is not None:
        start_from(experience, onboard, offboard, config.offboard.experience.mode == "frozen")
    ticks_max = round(config.duration_s / (period_s := config.onboard.period_ns * 1e-9))
    ticks: Array = np.zeros((ticks_max, len(TICK.fields)))
    truths: Array = np.zeros((ticks_max, len(TRUTH.fields)))
    events: list[tuple[int, str, str]] = []
    records: list[tuple[RecordType, int, Array]] = []
    crash, flown = "", 0
    while flown < ticks_max and not crash:
        result = lockstep.step()
        ticks[flown], truths[flown] = tick, truth = result.onboard.tick, result.truth
        _note(result, events, records)
        for observe in observers:
            observe(result)
        crash = lockstep.crash_reason or _too_far(tick, truth)
        flown += 1
        if crash:
            events.append((result.now_ns, "sim_vehicle", f"vehicle lost: {crash}"))
    time_s = np.arange(flown, dtype=np.float64) * period_s
    trace = FlightTrace(time_s, Columns(TICK, ticks[:flown]), Columns(TRUTH, truths[:flown]))
    return LockstepOutcome(
        trace,
        crash,
        onboard.summary(),
        None if offboard is None else offboard.summary(),
        {direction: _counts(radio, direction) for direction in DIRECTIONS},
        lockstep.trace_sha256,
        events,
        records,
        radio.deliveries,
        {direction: radio.recording(direction) for direction in DIRECTIONS},
        dump_learnt(onboard, offboard),
    )


def _note(result: TickResult, events: list[tuple[int, str, str]], records: list[tuple[RecordType, int, Array]]) -> None:
    """Add the events and offboard's records of a tick."""
    onboard, offboard = result.onboard, result.offboard
    if onboard.events:
        events += [(when, "onboard", text) for when, text in onboard.events]
    if offboard is not None:
        if offboard.events:
            events += [(when, "offboard", text) for when, text in offboard.events]
        records += offboard.records


def _too_far(tick: Array, truth: Array) -> str:
    if tick.item(_MODE) not in _FOLLOWING:
        return ""
    north, east, down = truth.item(0), truth.item(1), truth.item(2)
    target_n, target_e, target_d = tick.item(_TARGET), tick.item(_TARGET + 1), tick.item(_TARGET + 2)
    squared = (north - target_n) ** 2 + (east - target_e) ** 2 + (down - target_d) ** 2
    far = squared > TARGET_DISTANCE_MAX_M**2
    return f"more than {TARGET_DISTANCE_MAX_M} m from the target" if far else ""


def _counts(radio: Radio, direction: Direction) -> dict[str, int]:
    counts = radio.counts(direction)
    return {"sent": counts.sent, "delivered": counts.delivered, "lost": counts.lost}
