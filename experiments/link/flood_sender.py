"""Floods one port with datagrams that carry the address of its peer.

    python -m experiments.link.flood_sender TARGET PEER RATE SECONDS

The sender writes the peer's address into the IP header, as an attacker in the same network can. This needs root. First
it listens for LISTEN_S; then it sends noise, true datagrams that it has heard, and such with a wrong end, in turn.
"""

import argparse
import socket
import struct
import time
from collections.abc import Iterator
from typing import Final

import numpy as np

from runtime.sockets import split_address

LISTEN_S: Final = 0.5
HEARD_MAX: Final = 200
DATAGRAMS: Final = 1200
"""Different datagrams of a flood."""
NOISE_BYTES_MAX: Final = 1200
FORGED_BYTES: Final = 6
SLICE_S: Final = 0.001
_IP: Final = struct.Struct("!BBHHHBBH4s4s")
_UDP: Final = struct.Struct("!HHHH")


def headed(payload: bytes, source: tuple[str, int], target: tuple[str, int]) -> bytes:
    """An IPv4 packet with a UDP datagram; the kernel fills in the checksum of the IP header."""
    udp = _UDP.pack(source[1], target[1], _UDP.size + len(payload), 0)
    length = _IP.size + len(udp) + len(payload)
    addresses = (socket.inet_aton(source[0]), socket.inet_aton(target[0]))
    return _IP.pack(0x45, 0, length, 0, 0, 64, socket.IPPROTO_UDP, 0, *addresses) + udp + payload


def heard(target: tuple[str, int], seconds: float) -> list[bytes]:
    """What arrives at the target from anybody, newest last."""
    found: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_UDP) as ear:
        ear.settimeout(0.05)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and len(found) < HEARD_MAX:
            try:
                packet = ear.recv(4096)
            except TimeoutError:
                continue
            start = 4 * (packet[0] & 15)
            _, port, _, _ = _UDP.unpack_from(packet, start)
            if port == target[1] and socket.inet_ntoa(packet[16:20]) == target[0]:
                found.append(packet[start + _UDP.size :])
    return found


def payloads(recorded: list[bytes], rng: np.random.Generator) -> Iterator[bytes]:
    """Noise, a recorded datagram, and one with a forged end, in turn; without a recording noise alone."""
    for index in range(DATAGRAMS):
        if index % 3 == 0 or not recorded:
            yield rng.bytes(int(rng.integers(1, NOISE_BYTES_MAX)))
            continue
        old = recorded[int(rng.integers(len(recorded)))]
        yield old if index % 3 == 1 else old[:-FORGED_BYTES] + rng.bytes(FORGED_BYTES)


def flood(target: str, peer: str, rate_hz: float, seconds: float) -> int:
    """Flood; returns the number of datagrams sent. Raises PermissionError without root."""
    here, there = split_address(target), split_address(peer)
    packets = [headed(one, there, here) for one in payloads(heard(here, LISTEN_S), np.random.default_rng(1))]
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW) as mouth:
        start_s = time.monotonic()
        while (now_s := time.monotonic() - start_s) < seconds:
            due = int(now_s * rate_hz)
            for _ in range(sent, due):
                mouth.sendto(packets[sent % DATAGRAMS], here)
                sent += 1
            time.sleep(SLICE_S)
    return sent


def main() -> None:
    """Flood as the command line says, and print the number of datagrams sent."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", metavar="TARGET", help="HOST:PORT to flood, IPv4")
    parser.add_argument("peer", metavar="PEER", help="HOST:PORT that the datagrams seem to come from")
    parser.add_argument("rate", type=float, help="datagrams per second")
    parser.add_argument("seconds", type=float)
    arguments = parser.parse_args()
    print(flood(arguments.target, arguments.peer, arguments.rate, arguments.seconds))


if __name__ == "__main__":
    main()
