"""The golden replay: a new core gets the inputs that onboard received, and must give the same outputs bit for bit.

The datagram log in onboard's log contains the time and the missed ticks of each tick, every datagram that it received,
and every datagram that it sent. A core has no clock and no randomness of its own. So a new core with the same
configuration, session number and key must give the same motor datagrams, datagrams to offboard and ground, and tick
records. This needs the same machine, or one with the same numpy and processor family: others round differently. So does
the other core (onboard.cores): it must decide the same, and command the same but for rounding.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from configs.loader import ConfigError
from experiments.flights.carried_experience import learns, start_from
from experiments.replays.judges import MOTOR_DIFFERENCE_MAX, OUTPUTS, Finding, Judge, Row, SameBits, SameDecisions
from experiments.replays.recorded_flight import RecordedFlight
from flight_log.log_file import LogFile
from onboard.core import OnboardOutput
from onboard.cores import AnyCore, build_core
from onboard.preflight.certificate import Clearance
from onboard.record.datagram_log import TOPIC, Entry, LoggedTick, read_tick
from onboard.record.tick import TICK
from protocol.keys import LinkKeys, load_keys


@dataclass(frozen=True)
class Difference:
    """The first difference between the logged and the replayed flight."""

    tick: int
    time_s: float
    """Since the first tick of the log."""
    field: str
    logged: str
    replayed: str

    def __str__(self) -> str:
        """Return one line."""
        return f"tick {self.tick} at {self.time_s:.3f} s: {self.field}: {self.logged} logged, {self.replayed} replayed"


@dataclass(frozen=True)
class CheckResult:
    """The check of one run of the onboard process."""

    name: str
    ticks: int
    """Ticks compared, up to the first difference."""
    rows: int
    """Tick records compared."""
    datagrams_in: int
    datagrams_out: int
    failed_steps: int
    """Steps that raised, both in the flight and in the replay."""
    difference: Difference | None
    incomplete: str
    """Reason why the log was not checked to its end; "" if it was."""
    verdict: str = SameBits.verdict
    """What a log without difference has shown."""
    motor_difference: float = 0.0
    """Largest of a motor command before the first difference, as a share of the maximum thrust."""

    @property
    def equal(self) -> bool:
        """Whether the complete log was checked and there is no difference."""
        return self.difference is None and not self.incomplete

    def __str__(self) -> str:
        """Return one line: what was compared, and the first difference if there is one."""
        line = f"{self.name}: {self.ticks} ticks, {self.datagrams_in} datagrams in, {self.datagrams_out} out"
        line += f", {self.failed_steps} failed steps" if self.failed_steps else ""
        if self.difference is None:
            line += f": {self.verdict}, {self.rows} tick records included"
        else:
            line += f"; FIRST DIFFERENCE: {self.difference}"
        return f"{line}; NOT CHECKED further: {self.incomplete}" if self.incomplete else line


def check_flight(
    flight: RecordedFlight, key_file: Path | None = None, core: str | None = None, precision: str = "double"
) -> list[CheckResult]:
    """Check every run of the onboard process of a flight.

    Parameters
    ----------
    key_file: the link's key; None: the one in the flight's configuration.
    core: one of onboard.cores.CORES; None: the one that flew, which must give the same bits.
    precision: of the C core, one of onboard.cores.PRECISIONS.

    Raises
    ------
    ConfigError
        If there is nothing to check, a key is needed and missing, or the core cannot fly this flight.
    """
    if not flight.onboard_logs:
        raise ConfigError(f"{flight.path}: holds no log of onboard")
    return [check_log(flight, log, key_file, core, precision) for log in flight.onboard_logs]


def check_log(
    flight: RecordedFlight, log: LogFile, key_file: Path | None, core: str | None = None, precision: str = "double"
) -> CheckResult:
    """Check one log. Raises ConfigError as `check_flight` does."""
    if TOPIC not in log.raw:
        raise ConfigError(f"{log.path}: holds no {TOPIC}, so there is nothing to compare with")
    flew = log.metadata.get("core", "numpy")
    name = core or flew
    same = name == flew and precision == "double"
    judge = SameBits(log) if same else SameDecisions(log, MOTOR_DIFFERENCE_MAX[precision])
    return _Check(log, _fresh_core(flight, log, key_file, name, precision), judge).run()


def _fresh_core(flight: RecordedFlight, log: LogFile, key_file: Path | None, name: str, precision: str) -> AnyCore:
    session = log.metadata.get("session", "")
    if not session.isdigit():
        raise ConfigError(f"{log.path}: does not name its session")
    keys = LinkKeys(None, None, None)
    if log.metadata.get("keyed") == "True":
        network = flight.config.network
        named = str(key_file) if key_file is not None else network.key_file
        keys = load_keys(named, network.vehicle_key_file, network.ground_key_file)
    clearance = Clearance(log.metadata.get("arming_bar", ""), log.metadata.get("notice", ""))
    core = build_core(name, flight.config.onboard, int(session), keys, clearance, precision)
    over_link = learns(core.controller) and flight.with_offboard
    if flight.experience is not None and not over_link:
        start_from(flight.experience, core, None)
    return core


INPUTS: Final = (Entry.FROM_VEHICLE, Entry.FROM_OFFBOARD, Entry.FROM_GROUND, Entry.LAND_REQUEST)


class _Check:
    """One pass over one datagram log."""

    def __init__(self, log: LogFile, core: AnyCore, judge: Judge) -> None:
        self._log = log
        self._core = core
        self._judge = judge
        self._last: LoggedTick | None = None
        self._ticks = self._rows = self._in = self._out = self._failed = 0
        self._start_ns = 0
        self._incomplete = ""
        self._row_of = self._rows_by_time()

    def run(self) -> CheckResult:
        difference = None
        for tick in self._datagrams():
            self._last = tick
            difference = self._compare(tick)
            if difference is not None:
                break
        if difference is None and not self._incomplete and self._last is not None:
            difference = self._difference(self._last, self._judge.at_end())
        return CheckResult(
            self._log.path.name,
            self._ticks,
            self._rows,
            self._in,
            self._out,
            self._failed,
            difference,
            self._incomplete,
            self._judge.verdict,
            self._judge.motor_difference,
        )

    def _rows_by_time(self) -> dict[int, Row]:
        topic = self._log.vectors.get(TICK.topic)
        if topic is None:
            return {}
        if topic.record_type.names != TICK.names:
            raise ConfigError(f"{self._log.path}: its tick records belong to another version of this project")
        return dict(zip(topic.times_ns.tolist(), topic.values, strict=True))

    def _datagrams(self) -> Iterator[LoggedTick]:
        for expected, (_, record) in enumerate(self._log.raw[TOPIC]):
            try:
                tick = read_tick(record)
            except ValueError as error:
                self._incomplete = str(error)
                return
            if tick.number != expected:
                self._incomplete = f"the log lost the ticks {expected} to {tick.number - 1}"
                return
            if expected == 0:
                self._start_ns = tick.now_ns
            yield tick

    def _compare(self, tick: LoggedTick) -> Difference | None:
        output, failed = self._step(tick)
        self._ticks += 1
        self._failed += failed
        if failed != tick.failed:
            raised = ("raised" if it else "done" for it in (tick.failed, failed))
            return self._difference(tick, Finding("step", *raised))
        row = self._row_of.get(tick.now_ns)
        self._rows += row is not None
        self._out += sum(len(getattr(output, attribute)) for _, _, attribute in OUTPUTS)
        return self._difference(tick, self._judge.compare(tick, row, output))

    def _step(self, tick: LoggedTick) -> tuple[OnboardOutput, bool]:
        """One tick as the process does it; the safe output if it raises."""
        vehicle, offboard, ground, land = map(tick.arrivals, INPUTS)
        self._in += len(vehicle) + len(offboard) + len(ground) + len(land)
        try:
            return self._core.tick(tick.now_ns, vehicle, offboard, ground, bool(land), tick.missed_ticks), False
        except Exception:
            with contextlib.suppress(Exception):
                return self._core.safe_output(tick.now_ns), True
            return OnboardOutput(), True

    def _difference(self, tick: LoggedTick, found: Finding | None) -> Difference | None:
        return None if found is None else Difference(tick.number, (tick.now_ns - self._start_ns) * 1e-9, *found)
