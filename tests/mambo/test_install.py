"""Installation on a stand-in for the drone's FTP and telnet: nothing is lost, and there is a way back."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from mambo.drone_access import DroneError
from mambo.image import DIGEST_BYTES, HEADER_BYTES, digest
from mambo.install import Access, fetch, install, restore, start
from protocol.session import session_start_ns
from tests.mambo.fake_drone import FakeDrone, fake_drone

ELF = b"\x7fELF\x01\x01" + bytes(12) + (40).to_bytes(2, "little")
THEIRS, OURS, NEWER = b"the drone's own library", ELF + b"ours", ELF + b"newer"


def image_of(size: int) -> bytes:
    header = b"DMRM" + (1).to_bytes(4, "little") + size.to_bytes(4, "little") + bytes(HEADER_BYTES - 12)
    payload = bytes(size - HEADER_BYTES - DIGEST_BYTES)
    return header + digest(header, payload) + payload


@pytest.fixture
def drone(tmp_path: Path) -> Iterator[FakeDrone]:
    with fake_drone(tmp_path / "drone") as one:
        (one.folder / "librsedu.so").write_bytes(THEIRS)
        yield one


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    library, image = tmp_path / "ours.so", tmp_path / "dmrac.bin"
    library.write_bytes(OURS)
    image.write_bytes(image_of(100))
    return library, image, tmp_path / "saved"


def access(drone: FakeDrone) -> Access:
    return Access("127.0.0.1", drone.ftp_port, drone.telnet_port, "/data")


def on(drone: FakeDrone, name: str) -> bytes:
    return (drone.folder / name).read_bytes()


def test_install_saves_first_and_prints_every_step(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    said: list[str] = []
    install(access(drone), *files, said.append)
    assert on(drone, "librsedu.so") == OURS
    assert on(drone, "librsedu.so.original") == THEIRS
    assert (files[2] / "librsedu.so.original").read_bytes() == THEIRS
    assert on(drone, "dmrac.bin") == image_of(100)
    saved = next(index for index, line in enumerate(said) if line.startswith("save librsedu.so"))
    written = said.index(f"write librsedu.so.new ({len(OURS)} bytes)")
    assert saved < written
    assert not [one.name for one in drone.folder.iterdir() if one.name.endswith(".new")]


def test_a_second_installation_keeps_the_drones_own(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    install(access(drone), *files, print)
    files[0].write_bytes(NEWER)
    install(access(drone), *files, print)
    assert on(drone, "librsedu.so") == NEWER
    assert on(drone, "librsedu.so.original") == THEIRS


def test_the_way_back(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    install(access(drone), *files, print)
    restore(access(drone), files[2], print)
    assert on(drone, "librsedu.so") == THEIRS
    (drone.folder / "librsedu.so").write_bytes(OURS)
    (drone.folder / "librsedu.so.original").unlink()
    restore(access(drone), files[2], print)
    assert on(drone, "librsedu.so") == THEIRS


def test_nothing_to_restore(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    with pytest.raises(DroneError, match="nothing to restore"):
        restore(access(drone), files[2], print)


@pytest.mark.parametrize("name", ["librsedu.so.original.new", "dmrac.bin.new", "librsedu.so.new"])
def test_a_transfer_that_arrives_damaged_changes_nothing(
    drone: FakeDrone, files: tuple[Path, Path, Path], name: str
) -> None:
    drone.spoil = {name}
    with pytest.raises(DroneError, match="is not what was sent"):
        install(access(drone), *files, print)
    assert on(drone, "librsedu.so") == THEIRS


def test_another_library_saved_on_this_machine_stops_it(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    files[2].mkdir()
    (files[2] / "librsedu.so.original").write_bytes(b"of another drone")
    with pytest.raises(DroneError, match="another file is saved there already"):
        install(access(drone), *files, print)
    assert on(drone, "librsedu.so") == THEIRS


def test_wrong_files_are_refused_before_the_drone_is_touched(files: tuple[Path, Path, Path]) -> None:
    nowhere = Access("127.0.0.1", 1, 1, "/")
    library, image, saved = files
    library.write_bytes(b"\x7fELF\x02\x01" + bytes(12) + (62).to_bytes(2, "little"))
    with pytest.raises(DroneError, match="not a library for the drone's processor"):
        install(nowhere, library, image, saved, print)
    library.write_bytes(OURS)
    image.write_bytes(b"DMRM")
    with pytest.raises(DroneError, match="not a configuration image"):
        install(nowhere, library, image, saved, print)
    for damaged in (image_of(100)[:-1], image_of(100)[:-1] + b"x", image_of(100) + b"x"):
        image.write_bytes(damaged)
        with pytest.raises(DroneError, match="the image is damaged"):
            install(nowhere, library, image, saved, print)


def test_no_drone_is_named(files: tuple[Path, Path, Path]) -> None:
    with pytest.raises(DroneError, match=r"ftp://127\.0\.0\.1:1: "):
        install(Access("127.0.0.1", 1, 1, "/"), *files, print)


def test_start_writes_a_session_and_restarts(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    with pytest.raises(DroneError, match=r"no dmrac\.bin: run dmrac mambo install first"):
        start(access(drone), "restart it", print)
    install(access(drone), *files, print)
    start(access(drone), "restart it", print)
    assert drone.ran == ["restart it"]
    assert session_start_ns(int(on(drone, "dmrac.session"))) > 1_700_000_000_000_000_000


def test_a_command_that_fails_is_named(drone: FakeDrone, files: tuple[Path, Path, Path]) -> None:
    install(access(drone), *files, print)
    drone.status = 127
    with pytest.raises(DroneError, match="restart it: ended with status 127"):
        start(access(drone), "restart it", print)


def test_the_log_is_fetched_and_never_overwritten(drone: FakeDrone, tmp_path: Path) -> None:
    with pytest.raises(DroneError, match="the library has not run"):
        fetch(access(drone), tmp_path / "record", print)
    (drone.folder / "dmrac.rec").write_bytes(b"one")
    (drone.folder / "dmrac.log").write_bytes(b"started")
    assert [path.name for path in fetch(access(drone), tmp_path / "record", print)] == ["dmrac.rec", "dmrac.log"]
    (drone.folder / "dmrac.rec").write_bytes(b"two")
    with pytest.raises(DroneError, match="another file is saved there already"):
        fetch(access(drone), tmp_path / "record", print)
    assert (tmp_path / "record" / "dmrac.rec").read_bytes() == b"one"
