"""5,000 bad datagrams per second arrive at onboard's socket towards offboard, and it misses no tick.

The socket is connected: the kernel drops what other addresses send. So the flood comes from the one address that is
heard: a relay between radio and onboard adds it to what it relays, as an attacker in the radio's place would.
"""

import select
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from experiments.flights.scenario import Choices, resolve
from experiments.replays.recorded_flight import read_recorded
from experiments.replays.replay_check import check_flight
from onboard.flight.modes import FlightMode
from runtime.sockets import DatagramSocket
from tests.experiments.processes import Processes, on_ports

pytestmark = [pytest.mark.realtime, pytest.mark.full]

FLOOD_HZ = 5_000
DURATION_S = 14.0
FLOOD_S = 9.0
ONBOARD, RELAY = "127.0.0.1:17671", "127.0.0.1:17675"


class FloodingRelay(threading.Thread):
    """Relays between radio and onboard, and adds bad datagrams while `flooding` is set."""

    def __init__(self, radio: str, in_place_of_onboard: str) -> None:
        super().__init__(daemon=True)
        self._radio = DatagramSocket("relay towards the radio", in_place_of_onboard, radio)
        self._onboard = DatagramSocket("relay towards onboard", RELAY, ONBOARD)
        self.flooding = threading.Event()
        self.ended = threading.Event()
        self.flooded = 0
        self._overheard: list[bytes] = []

    def run(self) -> None:
        rng = np.random.default_rng(1)
        next_s = time.monotonic()
        while not self.ended.is_set():
            select.select((self._radio, self._onboard), (), (), 0.001)
            for datagram in self._radio.receive(64):
                self._onboard.send(datagram)
                self._overheard = [*self._overheard[-20:], datagram]
            for datagram in self._onboard.receive(64):
                self._radio.send(datagram)
            now_s = time.monotonic()
            if not self.flooding.is_set():
                next_s = now_s
            while next_s < now_s:
                self._onboard.send(self._bad(rng))
                self.flooded += 1
                next_s += 1.0 / FLOOD_HZ
        self._radio.close()
        self._onboard.close()

    def _bad(self, rng: np.random.Generator) -> bytes:
        """Noise, a forged datagram of the right form, and a recorded one."""
        kind = self.flooded % 3
        if kind == 0 or not self._overheard:
            return rng.bytes(int(rng.integers(1, 1400)))
        old = self._overheard[int(rng.integers(len(self._overheard)))]
        return old if kind == 1 else old[:-16] + rng.bytes(16)


def test_a_real_flood_costs_no_tick(tmp_path: Path) -> None:
    config = on_ports(resolve("hover", Choices("mrac", 2, DURATION_S)), 17660)
    path = tmp_path / "config.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    relay = FloodingRelay(config.network.radio_onboard, config.network.onboard_link)
    relay.start()
    with Processes(tmp_path) as processes:
        processes.start("sim", path)
        processes.start("offboard", path)
        processes.start("onboard", path, "--bind-link", ONBOARD, "--offboard", RELAY)
        time.sleep(3.0)
        relay.flooding.set()
        time.sleep(FLOOD_S)
        relay.flooding.clear()
        assert processes.wait("sim", DURATION_S + 30.0) == 0
        processes.end("onboard", "offboard")
        sim, onboard = processes.summary("sim"), processes.summary("onboard")
    relay.ended.set()
    relay.join(5.0)
    assert relay.flooded > 0.9 * FLOOD_HZ * FLOOD_S
    assert sim["survived"], sim["crash_reason"]
    flight = read_recorded(tmp_path)
    assert flight.trace is not None
    tick = flight.trace.tick
    during = (flight.trace.time_s > 5.0) & (flight.trace.time_s < 2.0 + FLOOD_S) & flight.trace.on_path
    duplicates = relay.flooded / 3  # a recorded datagram counts as a duplicate, not as rejected
    rejected = sum(onboard["rejected"].values())
    print(f"{relay.flooded} sent, {rejected} rejected, {onboard['missed']} of {onboard['ticks']} ticks missed")
    print(f"tick {onboard['tick_us']} us, lateness {onboard['lateness_us']} us")
    assert rejected > 0.9 * (relay.flooded - duplicates), "all of it was looked at: no queue had to overflow"
    assert onboard["escapes"] == 0
    assert onboard["missed"] <= 0.005 * onboard["ticks"]
    assert np.quantile(tick["pose_age"][during], 0.99) < 0.1, "and the poses among it were heard"
    assert set(tick["mode"][during].astype(int)) == {FlightMode.FLYING}
    (checked,) = check_flight(flight)
    assert checked.difference is None, "what was taken in is all on the datagram log"
