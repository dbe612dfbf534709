"""A stand-in with a scripted vehicle: acquisitions without a simulator."""

import os
import socket
from pathlib import Path
from typing import Any

import numpy as np

from experiments.flights.scenario import resolve
from mambo.board import board_config
from mambo.build import Built
from mambo.config import BoardConfig, library_config
from mambo.fake.firmware_process import FirmwareProcess
from mambo.fake.wire import NO_FLOW, Answer, Calls, FlowCall, Sensors, encode_request
from mambo.image import image, write_image
from onboard.config import OnboardConfig

PERIOD_NS = 5_000_000
GRAVITY = 9.80665


def _free_ports(count: int) -> tuple[int, ...]:
    """UDP ports that nobody has, other ones in each process of the tests: two tests may run at the same time."""
    found: list[int] = []
    for port in range(20000 + 3 * (os.getpid() % 4000), 32768):  # below those that the kernel hands out
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                continue
        found.append(port)
        if len(found) == count:
            return tuple(found)
    raise RuntimeError("no free port below 32768")


OWN_PORT, GROUND_OWN_PORT = _free_ports(2)
"""The library's ports, towards offboard and towards the ground station."""


def board(mode: str = "fly", **values: Any) -> BoardConfig:
    link = {"offboard": (127, 0, 0, 1), "own_port": OWN_PORT, "ground_port": 0}
    return board_config(values={"mode": mode, "link": link, **values})


def write(folder: Path, settings: BoardConfig, onboard: OnboardConfig | None = None, cleared: bool = True) -> Path:
    onboard = onboard or resolve("hover").onboard
    path = folder / "dmrac.bin"
    write_image(path, image(library_config(settings, onboard, cleared), onboard, None, None))
    return path


class Rig:
    """Calls the library as the firmware does. Sensors are those of a vehicle at rest, with noise."""

    def __init__(self, built: Built, folder: Path, seed: int = 1) -> None:
        self.process = FirmwareProcess(built, folder)
        self.now_ns = 0
        self.spent_ns = 0
        self.rng = np.random.default_rng(seed)
        self.force = (0.0, 0.0, -GRAVITY)
        self.rates = (0.0, 0.0, 0.0)
        self.altitude_m = 0.44
        self.battery_v = 4.0
        self.events: list[str] = []

    def sensors(self) -> Sensors:
        force = np.array(self.force) + 0.2 * self.rng.standard_normal((5, 3))
        rates = np.array(self.rates) + 0.01 * self.rng.standard_normal((5, 3))
        pressure_pa = 101325.0 + self.rng.standard_normal()
        return Sensors(force, rates, pressure_pa, self.altitude_m, self.battery_v, 90)

    def call(self, gap_ns: int = PERIOD_NS, calls: Calls = Calls.CONTROL, flow: FlowCall | None = None) -> Answer:
        self.now_ns += gap_ns
        calls |= Calls.FLOW if flow else Calls(0)
        request = encode_request(self.now_ns, 0, self.spent_ns, calls, self.sensors(), flow or NO_FLOW)
        answer = self.process.call(request)
        self.events += [text for _, text in answer.events]
        return answer

    def run(self, count: int, **arguments: Any) -> Answer:
        for _ in range(count - 1):
            self.call(**arguments)
        return self.call(**arguments)
