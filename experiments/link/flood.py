"""Flies in real time while one port is flooded, port by port and rate by rate, and compares with a quiet flight."""

import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from rich.table import Table

from configs.addresses import LINK_KEYS, Addresses
from experiments.flights import realtime_flight
from experiments.flights.logged_flight import read_trace
from experiments.flights.metrics import flight_metrics
from experiments.flights.scenario import FlightConfig
from protocol.keys import write_key
from runtime.errors import StartError


class Port(NamedTuple):
    """A port that can be flooded."""

    process: str
    """"onboard" or "offboard", whose port it is."""
    target: str
    """Its address, of `network`; "" for onboard's port towards the ground station, which is any free one."""
    peer: str
    """Whose address the flood carries, of `network`; the motion capture may send from any."""
    rejected: str
    """In the summary of the process: what its core rejected on this port, by reason; "" if it is not there."""


PORTS: Final = {
    "vehicle": Port("onboard", "onboard_vehicle", "vehicle", "vehicle_rejected"),
    "offboard": Port("onboard", "onboard_link", "radio_onboard", "rejected"),
    "ground": Port("onboard", "", "ground", ""),
    "motion capture": Port("offboard", "motion_capture", "motion_capture", "poses_rejected"),
    "onboard": Port("offboard", "offboard_link", "radio_offboard", "rejected"),
}
"""By the name of the port in the reports."""
RATES_HZ: Final = (1_000, 10_000, 50_000)
KEYS: Final = tuple(key.setting for key in LINK_KEYS.values())
END_LIMIT_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class Flooded:
    """One flight."""

    port: str
    """"" for the quiet flight."""
    rate_hz: float
    """Datagrams sent per second, as measured."""
    survived: bool
    rmse_m: float
    missed_share: float
    """Of onboard's ticks."""
    tick_p99_us: float
    dropped: dict[str, int]
    """By the flooded process, by reason: what its intake dropped, and what its core rejected."""


def keyed(config: FlightConfig, folder: Path) -> FlightConfig:
    """The flight with a new key on every link, in files in `folder`."""
    for name in KEYS:
        write_key(folder / name)
    files = {name: str(folder / name) for name in KEYS}
    network = Addresses.model_validate(config.network.model_dump() | files)
    return config.model_copy(update={"network": network})


def measure(
    config: FlightConfig, ports: Sequence[str], rates_hz: Sequence[int], show: Callable[[str], None]
) -> list[Flooded]:
    """A quiet flight, then one with each rate at each port. Raises StartError without root."""
    with TemporaryDirectory(prefix="flood") as name:
        folder = Path(name)
        flight = keyed(config, folder)
        flights = [fly(flight, folder / "quiet")]
        for port in ports:
            for rate_hz in rates_hz:
                flights.append(fly(flight, folder / f"{port}_{rate_hz}", port, rate_hz))
                show(_line(flights[-1]))
    return flights


def fly(config: FlightConfig, out: Path, port: str = "", rate_hz: int = 0) -> Flooded:
    """One flight; the flood begins when the vehicle flies, and lasts to its end."""
    out.mkdir()
    path = out / "config.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    flooder = _Flooder(config, port, rate_hz)
    try:
        result = realtime_flight.run(config.network, path, config.duration_s, out, flooder.note)
    finally:
        sent_hz = flooder.end()
    onboard, sim = result.onboard or {}, result.sim or {}
    trace = read_trace(out)
    survived = bool(sim.get("survived")) and trace is not None
    error = flight_metrics(trace, config.onboard.guidance.trajectory).position_rmse_m if trace else float("nan")
    dropped = _dropped(port, {"onboard": onboard, "offboard": result.offboard or {}})
    share = onboard.get("missed", 0) / max(1, onboard.get("ticks", 1))
    return Flooded(port, sent_hz, survived, error, share, onboard.get("tick_us", {}).get("p99", float("nan")), dropped)


def _dropped(port: str, summaries: dict[str, dict[str, Any]]) -> dict[str, int]:
    """What the flooded process did not use, by reason; nothing if no port was flooded."""
    if port not in PORTS:
        return {}
    summary = summaries[PORTS[port].process]
    counts = Counter(summary.get("dropped", {}).get(port, {}))
    counts.update(summary.get(PORTS[port].rejected, {}))
    return dict(counts)


class _Flooder:
    """Starts the sender when onboard reports that it flies."""

    def __init__(self, config: FlightConfig, port: str, rate_hz: int) -> None:
        self._config = config
        self._port = port
        self._rate_hz = rate_hz
        self._process: subprocess.Popen[str] | None = None

    def note(self, entry: dict[str, Any]) -> None:
        """Receive a status line of a process."""
        flies = entry.get("process") == "onboard" and entry.get("mode") == "FLYING"
        if not flies or self._process is not None or not self._port:
            return
        command = flood_command(self._config, self._port, self._rate_hz, self._config.duration_s)
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def end(self) -> float:
        """The rate that was sent, Hz. Raises StartError if the sender failed."""
        if self._process is None:
            return 0.0
        output, _ = self._process.communicate(timeout=self._config.duration_s + END_LIMIT_S)
        if self._process.returncode:
            raise StartError("the flood needs root: it writes the peer's address into the datagrams")
        return int(output) / self._config.duration_s


def flood_command(config: FlightConfig, port: str, rate_hz: int, seconds: float) -> list[str]:
    """Return the command that floods a port, one of PORTS, of a flight that is under way. Raises StartError."""
    flooded = PORTS[port]
    there: str = getattr(config.network, flooded.peer)
    here: str = getattr(config.network, flooded.target) if flooded.target else port_towards(there)
    return [sys.executable, "-m", "experiments.link.flood_sender", here, there, str(rate_hz), str(seconds)]


def port_towards(peer: str) -> str:
    """The local address of the socket that is connected to `peer` on this machine. Raises StartError if none is."""
    host, port = peer.split(":")
    wanted = f"{int.from_bytes(bytes(map(int, host.split('.'))), 'little'):08X}:{int(port):04X}"
    for line in Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]:
        _, local, remote, *_ = line.split()
        if remote == wanted:
            address, number = local.split(":")
            return f"{'.'.join(map(str, int(address, 16).to_bytes(4, 'little')))}:{int(number, 16)}"
    raise StartError(f"no socket of this machine is connected to {peer}")


def table(flights: Sequence[Flooded]) -> Table:
    """The flights, one a row."""
    shown = Table(title="flooded ports, real time", box=None, pad_edge=False, title_justify="left")
    for name in (
        "port",
        "sent /s",
        "vehicle",
        "RMSE mm",
        "ticks missed",
        "tick p99 us",
        "dropped by onboard or offboard",
    ):
        shown.add_column(name, justify="left" if name in ("port", "vehicle") else "right")
    for one in flights:
        shown.add_row(*_cells(one))
    return shown


def _cells(one: Flooded) -> tuple[str, ...]:
    dropped = ", ".join(f"{count} {reason}" for reason, count in one.dropped.items() if count)
    alive = "alive" if one.survived else "lost"
    numbers = (f"{1e3 * one.rmse_m:.1f}", f"{one.missed_share:.2%}", f"{one.tick_p99_us:.0f}")
    return (one.port or "none", f"{one.rate_hz:,.0f}", alive, *numbers, dropped or "-")


def _line(one: Flooded) -> str:
    return "  ".join(_cells(one))


def as_json(flights: Sequence[Flooded]) -> list[dict[str, Any]]:
    """The numbers."""
    return [{name: getattr(one, name) for name in Flooded.__slots__} for one in flights]
