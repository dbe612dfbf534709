"""The configuration image: what the library takes, and that every fault is refused by name."""

import stat
import struct
from pathlib import Path

import pytest

from configs.loader import ConfigError
from experiments.flights.scenario import Choices, resolve
from mambo.board import board_config
from mambo.build import Built
from mambo.config import library_config
from mambo.fake.wire import REFUSED
from mambo.image import DIGEST_BYTES, HEADER_BYTES, digest, image, settings_record, write_image
from onboard.c.config_table import HEADER_BYTES as RECORD_HEADER_BYTES
from onboard.c.config_table import size_of
from tests.mambo.rig import Rig, board, write

START = HEADER_BYTES + DIGEST_BYTES


def fault_of(built: Built, folder: Path) -> str:
    """What the library says about the image in a folder; empty if it takes it."""
    rig = Rig(built, folder)
    with rig.process:
        answer = rig.call()
    return rig.events[-1] if answer.view["state"] == REFUSED else ""


def signed(data: bytes) -> bytes:
    """The image with a digest that is right."""
    return data[:HEADER_BYTES] + digest(data[:HEADER_BYTES], data[START:]) + data[START:]


def changed(data: bytes, at: int, number: bytes) -> bytes:
    return signed(data[:at] + number + data[at + len(number) :])


@pytest.fixture
def good(tmp_path: Path) -> bytes:
    return write(tmp_path, board()).read_bytes()


@pytest.mark.parametrize("controller", ["pid", "l1", "mrac", "dmrac"])
def test_the_library_takes_the_image_of_every_controller(native: Built, tmp_path: Path, controller: str) -> None:
    write(tmp_path, board(), resolve("figure8_wind", Choices(controller)).onboard)
    assert fault_of(native, tmp_path) == ""


def test_the_drones_build_takes_the_same_image(qemu: Built, tmp_path: Path, good: bytes) -> None:
    assert fault_of(qemu, tmp_path) == ""


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.6, 0.99])
def test_one_changed_bit_is_found(native: Built, tmp_path: Path, good: bytes, share: float) -> None:
    at = START + int(share * (len(good) - START - 1))
    (tmp_path / "dmrac.bin").write_bytes(good[:at] + bytes([good[at] ^ 4]) + good[at + 1 :])
    assert "digest" in fault_of(native, tmp_path)


@pytest.mark.parametrize(
    ("length", "word"), [(0, "not a configuration image"), (40, "not a"), (500, "longer than the file"), (-1, "longer")]
)
def test_a_short_file_is_refused(native: Built, tmp_path: Path, good: bytes, length: int, word: str) -> None:
    (tmp_path / "dmrac.bin").write_bytes(good[:length])
    assert word in fault_of(native, tmp_path)


def test_a_missing_file_is_named(native: Built, tmp_path: Path) -> None:
    assert fault_of(native, tmp_path) == f"{tmp_path}/dmrac.bin cannot be read"


def test_another_version_is_named(native: Built, tmp_path: Path, good: bytes) -> None:
    (tmp_path / "dmrac.bin").write_bytes(changed(good, 4, struct.pack("<I", 7)))
    assert fault_of(native, tmp_path) == "image of version 7, this library reads version 1"


def test_another_layout_is_named(native: Built, tmp_path: Path, good: bytes) -> None:
    (tmp_path / "dmrac.bin").write_bytes(changed(good, START + 4, b"otherlay"))
    assert "another version of this library" in fault_of(native, tmp_path)


def test_a_number_out_of_its_range_is_named(native: Built, tmp_path: Path, good: bytes) -> None:
    pressure_at = START + RECORD_HEADER_BYTES + 40  # board.layout.pressure
    (tmp_path / "dmrac.bin").write_bytes(changed(good, pressure_at, struct.pack("<q", 5000)))
    assert fault_of(native, tmp_path) == "board.layout.pressure is 5000, allowed is from 0 to at most 2372"


@pytest.mark.parametrize(
    ("place", "value", "text"),
    [
        (8, struct.pack("<q", 1), "period_ns is 1, allowed is from 1e+06 to at most 5e+07"),
        (32, struct.pack("<d", 0.0), "airframe.mass_kg is 0, allowed is above 0 to at most 3.4e+38"),
        (32, struct.pack("<d", float("nan")), "airframe.mass_kg is nan"),
    ],
)
def test_a_number_of_the_core_is_named(
    native: Built, tmp_path: Path, good: bytes, place: int, value: bytes, text: str
) -> None:
    core_at = START + RECORD_HEADER_BYTES + size_of(settings_record()) + RECORD_HEADER_BYTES
    (tmp_path / "dmrac.bin").write_bytes(changed(good, core_at + place, value))
    assert text in fault_of(native, tmp_path)


def test_without_a_key_the_link_stays_on_this_machine(native: Built, tmp_path: Path) -> None:
    write(tmp_path, board_config(values={"mode": "fly"}))
    assert fault_of(native, tmp_path) == "key: the link to another machine needs one"


def test_the_key_is_in_the_image_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    key, onboard, path = bytes(range(32)), resolve("hover").onboard, tmp_path / "dmrac.bin"
    path.write_text("an older one that everybody could read")
    path.chmod(0o644)
    write_image(path, image(library_config(board(), onboard, True), onboard, key, None))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert key in path.read_bytes()
    assert [one.name for one in tmp_path.iterdir()] == ["dmrac.bin"]


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("layout.pressure=3000", "layout.pressure: 3000"),
        ("sensors.gyroscope_axes=[1, 1, 3]", "each of 1 to 3 once"),
        ("motors.order=[1, 2, 3, 3]", "each of 1 to 4 once"),
        ("link.own_port=24099", "the firmware has"),
        ("mode=glide", "mode: 'glide'"),
        ("speed=3", "speed"),
    ],
)
def test_a_wrong_setting_is_named(assignment: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        board_config(assignments=[assignment])
    assert words in str(caught.value)
    assert "mambo.yaml" in str(caught.value)
