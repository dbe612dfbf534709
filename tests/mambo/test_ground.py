"""The library's ground station link against pymavlink: telemetry, commands, signatures, and the kill."""

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from experiments.flights.scenario import resolve
from mambo.build import Built
from mambo.config import library_config
from mambo.image import image, write_image
from onboard.flight.modes import FlightMode
from protocol.mavlink.frames import Frame, FrameReader, FrameWriter, Message
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import HEARTBEAT, SYSTEM_STATUS, encode_heartbeat
from tests.mambo.rig import GROUND_OWN_PORT, OWN_PORT, Rig, board

KEY = bytes(range(1, 33))
ATTITUDE, POSITION = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
ANSWER, TEXT = mavlink.MAVLINK_MSG_ID_COMMAND_ACK, mavlink.MAVLINK_MSG_ID_STATUSTEXT
SENT = (HEARTBEAT, SYSTEM_STATUS, ATTITUDE, POSITION, ANSWER, TEXT)
TERMINATE = mavlink.MAV_CMD_DO_FLIGHTTERMINATION
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
UTC_NS = 1_800_000_000 * 10**9


class Station:
    """A ground station beside the library."""

    def __init__(self, built: Built, folder: Path, key: bytes | None) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        link = {
            "offboard": (127, 0, 0, 1),
            "ground": (127, 0, 0, 1),
            "ground_port": self.socket.getsockname()[1],
            "own_port": OWN_PORT,
            "ground_own_port": GROUND_OWN_PORT,
        }
        onboard = resolve("hover").onboard
        settings = library_config(board(link=link), onboard, cleared=True)
        write_image(folder / "dmrac.bin", image(settings, onboard, None, key))
        (folder / "dmrac.session").write_text(f"{(UTC_NS // 10**6) << 20}\n")
        self.rig = Rig(built, folder)
        self.writer = FrameWriter(255, 190, key, SigningClock(UTC_NS))
        self.reader = FrameReader(SENT, key, SigningClock(UTC_NS))
        self.frames: list[Frame] = []

    def send(self, message: Message) -> bytes:
        frame = self.writer.write(message, self.rig.now_ns)
        self.send_bytes(frame)
        return frame

    def send_bytes(self, frame: bytes) -> None:
        self.socket.sendto(frame, ("127.0.0.1", GROUND_OWN_PORT))

    def run(self, calls: int) -> FlightMode:
        answer = None
        for _ in range(calls):
            answer = self.rig.call()
            try:
                while True:
                    self.frames += self.reader.read(self.socket.recv(2048), self.rig.now_ns)
            except BlockingIOError:
                pass
        assert answer is not None
        return FlightMode(answer.view["mode"])

    def of(self, message: int) -> list[Frame]:
        return [frame for frame in self.frames if frame.message_id == message]

    def answers(self) -> list[tuple[int, int]]:
        """Command and result of each answer."""
        return [(frame.fields[0], frame.fields[1]) for frame in self.of(ANSWER)]


def command(number: int, first: float = 0.0, second: float = 0.0, target: int = 1) -> Message:
    fields = (first, second, 0.0, 0.0, 0.0, 0.0, 0.0, number, target, 1, 0)  # in the order of the wire
    return Message(mavlink.MAVLink_command_long_message, fields)


@pytest.fixture(params=[None, KEY], ids=["unsigned", "signed"])
def station(native: Built, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Station]:
    one = Station(native, tmp_path, request.param)
    with one.rig.process, one.socket:
        yield one


def test_telemetry_comes_at_its_rates(station: Station) -> None:
    station.run(400)  # 2 s
    assert dict(station.reader.rejected) == {}
    assert [len(station.of(message)) for message in (ATTITUDE, POSITION, HEARTBEAT, SYSTEM_STATUS)] == [20, 20, 2, 4]
    (_, w, x, y, z, *_) = station.of(ATTITUDE)[-1].fields
    assert (w**2 + x**2 + y**2 + z**2) == pytest.approx(1.0, abs=1e-5)
    assert station.of(SYSTEM_STATUS)[-1].fields[4] == 4000  # mV
    assert station.of(SYSTEM_STATUS)[-1].fields[12] == 90  # per cent
    pieces = [frame.fields[1].rstrip(b"\0") for frame in station.of(TEXT)[:2]]
    assert b"".join(pieces) == b"before arming: calls and sensors are not judged yet"
    assert [frame.fields[3] for frame in station.of(TEXT)[:2]] == [0, 1]


def test_the_kill_stops_the_motors_for_good(station: Station) -> None:
    station.run(10)
    station.send(command(TERMINATE, 1.0))
    assert station.run(5) is FlightMode.TERMINATED
    assert station.answers() == [(TERMINATE, mavlink.MAV_RESULT_ACCEPTED)]
    assert station.run(200) is FlightMode.TERMINATED


def test_a_refused_command_gets_its_reason(station: Station) -> None:
    station.run(300)
    station.send(command(ARM, 1.0))
    station.run(10)
    assert station.answers() == [(ARM, mavlink.MAV_RESULT_TEMPORARILY_REJECTED)]
    assert "refused" in str(station.of(TEXT)[-1].fields)


def test_what_is_not_for_it_changes_nothing(station: Station) -> None:
    station.run(10)
    station.send(command(TERMINATE, 1.0, target=7))
    station.send(command(TERMINATE, 0.0))
    station.send(command(mavlink.MAV_CMD_NAV_WAYPOINT))
    station.send(encode_heartbeat(0, 8, 0, False, 4))
    assert station.run(20) is FlightMode.BOOT
    assert {result for _, result in station.answers()} == {mavlink.MAV_RESULT_UNSUPPORTED}


def test_a_damaged_frame_changes_nothing(station: Station) -> None:
    station.run(10)
    frame = station.writer.write(command(TERMINATE, 1.0), station.rig.now_ns)
    for at in range(len(frame)):
        station.send_bytes(frame[:at] + bytes([frame[at] ^ 1]) + frame[at + 1 :])
        station.run(1)
    for size in range(len(frame)):
        station.send_bytes(frame[:size])
        station.run(1)
    assert station.run(5) is FlightMode.BOOT


def test_with_a_key_unsigned_old_and_repeated_frames_are_refused(native: Built, tmp_path: Path) -> None:
    station = Station(native, tmp_path, KEY)
    with station.rig.process, station.socket:
        station.run(10)
        kill = command(TERMINATE, 1.0)
        station.send_bytes(FrameWriter(255, 190).write(kill, 0))
        station.send_bytes(FrameWriter(255, 190, bytes(32), SigningClock(UTC_NS)).write(kill, 0))
        for off_s in (-3600, 3600):
            station.send_bytes(FrameWriter(255, 190, KEY, SigningClock(UTC_NS + off_s * 10**9)).write(kill, 0))
        assert station.run(10) is FlightMode.BOOT
        heartbeat = station.send(encode_heartbeat(0, 8, 0, False, 4))
        unsupported = station.send(command(mavlink.MAV_CMD_NAV_WAYPOINT))
        station.run(5)
        assert len(station.answers()) == 1
        for frame in (unsupported, heartbeat, unsupported):
            station.send_bytes(frame)
        station.run(5)
        assert len(station.answers()) == 1  # a repeated frame is not answered
