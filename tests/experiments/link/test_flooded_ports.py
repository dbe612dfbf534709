"""`dmrac bench flood`: the flood carries its peer's address, and the vehicle flies on as if it were not there."""

import os
import socket
from pathlib import Path

import numpy as np
import pytest

from experiments.flights.scenario import Choices, resolve
from experiments.link.flood import Flooded, as_json, measure, port_towards, table
from experiments.link.flood_sender import FORGED_BYTES, flood, headed, payloads
from runtime.errors import StartError
from runtime.sockets import DatagramSocket
from tests.experiments.processes import on_ports

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root: it writes the peer's address into datagrams")
RECORDED = [bytes([index]) * 40 for index in range(5)]
RMSE_RATIO_MAX = 1.2


def test_a_packet_has_the_given_addresses_and_length() -> None:
    packet = headed(b"hello", ("127.0.0.1", 1234), ("127.0.0.9", 4321))
    assert len(packet) == int.from_bytes(packet[2:4], "big") == 33
    assert (packet[12:16], packet[16:20]) == (socket.inet_aton("127.0.0.1"), socket.inet_aton("127.0.0.9"))
    assert packet[20:24] == bytes.fromhex("04d210e1")
    assert packet[28:] == b"hello"


def test_a_flood_has_noise_recordings_and_forgeries() -> None:
    found = list(payloads(RECORDED, np.random.default_rng(1)))
    assert len(set(found[0::3])) > 300
    assert set(found[1::3]) == set(RECORDED)
    forged = found[2::3]
    assert {one[:-FORGED_BYTES] for one in forged} == {one[:-FORGED_BYTES] for one in RECORDED}
    assert not set(forged) & set(RECORDED)


def test_without_a_recording_a_flood_is_noise() -> None:
    assert len(set(payloads([], np.random.default_rng(1)))) > 1000


@needs_root
def test_a_connected_socket_receives_the_flood_as_from_its_peer() -> None:
    peer = DatagramSocket("peer", "127.0.0.1:0", None)
    flooded = DatagramSocket("flooded", "127.0.0.1:0", peer.local_address)
    try:
        assert port_towards(peer.local_address) == flooded.local_address
        sent = flood(flooded.local_address, peer.local_address, 2000.0, 0.2)
        assert sent > 0
        assert len(flooded.receive(10_000)) == sent
    finally:
        peer.close()
        flooded.close()


def test_a_peer_that_nobody_talks_to_is_an_error() -> None:
    with pytest.raises(StartError, match=r"connected to 127\.0\.0\.1:9"):
        port_towards("127.0.0.1:9")


def test_a_flight_is_a_row_and_a_record() -> None:
    flights = [
        Flooded("", 0.0, True, 0.02, 0.0, 900.0, {}),
        Flooded("ground", 1e3, False, 0.5, 0.1, 1e3, {"refused": 7}),
    ]
    assert [list(column.cells) for column in table(flights).columns][2] == ["alive", "lost"]
    assert as_json(flights)[1]["dropped"] == {"refused": 7}


@needs_root
@pytest.mark.full
@pytest.mark.realtime
@pytest.mark.parametrize("port", ["vehicle", "offboard", "ground", "onboard"])
def test_a_flooded_vehicle_flies_as_a_quiet_one(port: str, tmp_path: Path) -> None:
    config = on_ports(resolve("figure8_wind", Choices("mrac", 1, 12.0)), 17680)
    quiet, slow, fast = measure(config, [port], [5_000, 20_000], print)
    for flooded in (slow, fast):
        assert flooded.survived
        assert sum(flooded.dropped.values()) > 10_000, "the flood arrived"
        assert flooded.rmse_m < RMSE_RATIO_MAX * quiet.rmse_m
