"""Flies in lockstep through the drone's library: the stand-in for the firmware in place of the onboard process.

The interface of onboard.cores.AnyCore. The vehicle's MAVLink becomes the firmware's structures and flow calls; the
motor commands become MAVLink again. Datagrams of offboard pass through real sockets on this machine: those that the
radio delivers are sent before the call, those that the library sends are read after it.
"""

import socket
import weakref
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError, merge
from mambo.board import board_config
from mambo.build import Built, build, run_command
from mambo.config import library_config
from mambo.fake.firmware_process import Command, FirmwareProcess
from mambo.fake.sensors import FirmwareSensors
from mambo.fake.wire import NO_FLOW, REFUSED, Answer, Calls, encode_request
from mambo.image import image, write_image
from mambo.vehicles import VEHICLES
from onboard.c.compile import BuildError
from onboard.config import OnboardConfig
from onboard.core import OnboardOutput
from onboard.flight.modes import AIRBORNE, FlightMode
from onboard.links.vehicle import VehicleLink
from protocol.arrival import Datagrams, at_times
from protocol.feature_set import FeatureSet
from protocol.keys import LinkKeys
from protocol.statistics import REJECTIONS
from runtime.errors import StartError

LOOPBACK: Final = (127, 0, 0, 1)
DATAGRAM_BYTES: Final = 2048
JITTER_S: Final = 0.0005
"""A call of the firmware comes up to this much late. C: a SCHED_RR thread."""
RUN, START = 3, 1


class FirmwareCore:
    """The drone's library in the stand-in.

    Parameters
    ----------
    vehicle: one of VEHICLES.
    config, keys: as of onboard.core.OnboardCore.
    board: values over configs/mambo.yaml.
    jitter_s: of the calls.
    command: that runs the stand-in.

    Raises
    ------
    ConfigError
        If compiler or qemu are missing, or the controller is not written in C.
    StartError
        If the library refuses its configuration.
    """

    def __init__(
        self,
        vehicle: str,
        config: OnboardConfig,
        keys: LinkKeys,
        board: dict[str, Any] | None = None,
        jitter_s: float = JITTER_S,
        command: Command = run_command,
    ) -> None:
        self._folder = TemporaryDirectory(prefix="mambo-")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._library_port = _free_port()
        link = {
            "offboard": LOOPBACK,
            "offboard_port": self._socket.getsockname()[1],
            "own_port": self._library_port,
            "ground_port": 0,
        }
        settings = board_config(values=merge({"mode": "fly", "link": link}, board or {}))
        data = image(library_config(settings, config, cleared=True), config, keys.offboard, keys.ground)
        write_image(Path(self._folder.name) / "dmrac.bin", data)
        self._order = np.argsort(np.array(settings.motors.order))
        self._command_max = settings.motors.command_max
        self._vehicle_link = VehicleLink(config.vehicle_link, keys.vehicle)
        self._sensors = FirmwareSensors(config.seed, keys.vehicle)
        self._jitter = np.random.default_rng([config.seed, 0xCA11]), jitter_s
        self._process = FirmwareProcess(_built(vehicle), Path(self._folder.name), command)
        self.close: Final = weakref.finalize(self, _close, self._process, self._socket, self._folder)
        """Ends the stand-in."""
        self.controller: Any = RemoteController(config)
        self._output, self._answer = OnboardOutput(), None
        self._started = self._running = False
        self._mode = FlightMode.BOOT
        self._events: list[tuple[int, str]] = []

    _answer: Answer | None

    def tick(
        self,
        now_ns: int,
        from_vehicle: Datagrams = (),
        from_offboard: Datagrams = (),
        from_ground: Datagrams = (),
        land: bool = False,
        missed_ticks: int = 0,
    ) -> OnboardOutput:
        """One call of the firmware (onboard.core.OnboardCore.tick). There is no ground station, and no wish to land."""
        output = self._output.cleared()
        for datagram, arrival_ns in at_times(from_vehicle, now_ns):
            self._sensors.receive(datagram, arrival_ns)
            self._started = True
        for datagram, _ in at_times(from_offboard, now_ns):
            self._socket.sendto(datagram, ("127.0.0.1", self._library_port))
        if not self._started:  # the firmware calls when its IMU has samples
            output.to_vehicle.append(self._vehicle_link.encode_motors((0.0,) * 4, False, now_ns))
            return output
        answer = self._call(now_ns)
        output.tick = answer.tick
        output.events += self._new_events(answer, now_ns)
        output.to_vehicle.append(self._encode_motors(answer, now_ns))
        output.to_offboard += self._sent()
        return output

    def _call(self, now_ns: int) -> Answer:
        sensors, flow = self._sensors.take()
        calls = Calls.CONTROL | (Calls.FLOW | Calls.IMAGE if flow else Calls(0))
        rng, jitter_s = self._jitter
        call_ns = now_ns + int(rng.uniform(0.0, jitter_s) * 1e9)
        self._answer = self._process.call(encode_request(call_ns, 0, 0, calls, sensors, flow or NO_FLOW))
        if self._answer.view["state"] == REFUSED:
            raise StartError(f"the library refuses its configuration: {self._answer.events[-1][1]}")
        return self._answer

    def _new_events(self, answer: Answer, now_ns: int) -> list[tuple[int, str]]:
        events, mode = list(answer.events), FlightMode(answer.view["mode"])
        if mode is not self._mode:
            events.append((now_ns, f"{self._mode.name} -> {mode.name}"))
            self._mode = mode
        return events

    def _encode_motors(self, answer: Answer, now_ns: int) -> bytes:
        """The firmware runs the motors from START on while it gets RUN; its order becomes PX4's."""
        self._running = answer.word == START or (self._running and answer.word == RUN)
        speeds = np.array(answer.speeds, dtype=np.float64)[self._order] / self._command_max
        return self._vehicle_link.encode_motors(speeds, self._running, now_ns)

    def _sent(self) -> list[bytes]:
        """Datagrams that the library has sent."""
        sent = []
        while True:
            try:
                sent.append(self._socket.recv(DATAGRAM_BYTES))
            except BlockingIOError:
                return sent

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off and nothing else."""
        return OnboardOutput(to_vehicle=[self._vehicle_link.encode_motors((0.0,) * 4, False, now_ns)])

    @property
    def airborne(self) -> bool:
        """Whether the flight mode is one of those in the air."""
        return self._mode in AIRBORNE

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""
        view = self._view
        return {"mode": self._mode.name, "feature_version": view["version"], "missed_ticks": view["missed"]}

    @property
    def _view(self) -> dict[str, int]:
        assert self._answer is not None, "no call yet"
        return self._answer.view

    def summary(self) -> dict[str, Any]:
        """Mode, features, and counters, for the flight record."""
        view = self._view
        rejected = {name: view[f"rejected_{name}"] for name in REJECTIONS if view[f"rejected_{name}"]}
        return {
            "mode": self._mode.name,
            "ticks": view["calls"],
            "missed": view["missed"],
            "features": {
                "version": view["version"],
                "swaps": view["swaps"],
                "refused": view["refusals"],
                "taken_back": view["taken_back"],
            },
            "rejected": rejected,
            "samples": {name: view[f"samples_{name}"] for name in ("taken", "dropped", "repeated")},
            "library": {name: view[name] for name in ("twice", "late", "over_budget", "left_out", "stage", "check")},
            "dropped": {name: count for name, count in view.items() if name.startswith("dropped_") and count},
        }


def _built(vehicle: str) -> Built:
    try:
        return build(VEHICLES[vehicle])
    except BuildError as error:
        raise ConfigError(f"--vehicle {vehicle}: {error}") from None


def _close(process: FirmwareProcess, link: socket.socket, folder: TemporaryDirectory[str]) -> None:
    process.close()
    link.close()
    folder.cleanup()


class RemoteController:
    """The controller within the library: whether it takes features. What it has learnt cannot be read."""

    def __init__(self, config: OnboardConfig) -> None:
        twin: Any = config.controller.build(config.airframe, config.features, config.seed)
        self._accepts = bool(getattr(twin, "accepts_features", False))

    @property
    def accepts_features(self) -> bool:
        """Whether a channel has network features."""
        return self._accepts

    def offer_features(self, features: FeatureSet) -> str:
        """Features go over the link alone."""
        raise NotImplementedError("the library takes features from the link only")


def _free_port() -> int:
    """A UDP port that no socket has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
