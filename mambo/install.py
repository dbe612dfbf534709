"""Installs the library on a drone, starts it, and takes it away again. What was there is saved first."""

import time
from pathlib import Path
from typing import Final, NamedTuple

from mambo.build import LIBRARY
from mambo.drone_access import DroneError, Files, Say, Shell, keep
from mambo.image import DIGEST_BYTES, HEADER_BYTES, MAGIC, digest
from protocol.session import session_number

IMAGE: Final = "dmrac.bin"
SESSION: Final = "dmrac.session"
RECORDING: Final = "dmrac.rec"
LOG: Final = "dmrac.log"
ORIGINAL: Final = f"{LIBRARY}.original"
"""On the drone: the library that was there before the first installation."""
ELF: Final = b"\x7fELF\x01\x01"
ARM: Final = 40
"""Machine of an ELF file."""


class Access(NamedTuple):
    """How to reach a drone."""

    host: str
    ftp_port: int
    telnet_port: int
    folder: str
    """Of the library, as the FTP server names it."""


def check_library(path: Path) -> bytes:
    """The content of a library for the drone. Raises DroneError for another file."""
    content = path.read_bytes()
    if content[:6] != ELF or int.from_bytes(content[18:20], "little") != ARM:
        raise DroneError(f"{path}: is not a library for the drone's processor; make it with dmrac mambo build")
    return content


def check_image(path: Path) -> bytes:
    """The content of a configuration image. Raises DroneError for another file and for a damaged one."""
    content = path.read_bytes()
    header, rest = content[:HEADER_BYTES], content[HEADER_BYTES:]
    if header[:4] != MAGIC or len(rest) < DIGEST_BYTES:
        raise DroneError(f"{path}: is not a configuration image; make it with dmrac mambo config")
    if digest(header, rest[DIGEST_BYTES:]) != rest[:DIGEST_BYTES]:
        raise DroneError(f"{path}: the image is damaged; make it again with dmrac mambo config")
    return content


def install(access: Access, library: Path, image: Path, saved: Path, say: Say) -> None:
    """Install library and image. The library that was there is saved on this machine and on the drone first.

    saved: folder on this machine. Raises DroneError; the drone's own library is then still there or under ORIGINAL.
    """
    new_library, new_image = check_library(library), check_image(image)
    files = Files(access.host, access.ftp_port, access.folder, say)
    try:
        names = files.names()
        if ORIGINAL in names:
            say(f"{ORIGINAL} is there already: it stays the way back")
        elif LIBRARY in names:
            original = files.read(LIBRARY)
            say(f"save {LIBRARY} as {saved / ORIGINAL}")
            keep(saved / ORIGINAL, original)
            files.write(ORIGINAL, original)
        else:
            say(f"no {LIBRARY} on the drone: nothing to save")
        files.write(IMAGE, new_image)
        files.write(LIBRARY, new_library)
    finally:
        files.close()
    say("installed; start it with dmrac mambo start")


def restore(access: Access, saved: Path, say: Say) -> None:
    """Put the drone's own library back. Raises DroneError."""
    files = Files(access.host, access.ftp_port, access.folder, say)
    try:
        if ORIGINAL in files.names():
            original = files.read(ORIGINAL)
        elif (saved / ORIGINAL).exists():
            say(f"the drone has no {ORIGINAL}: take {saved / ORIGINAL}")
            original = (saved / ORIGINAL).read_bytes()
        else:
            raise DroneError(f"no {ORIGINAL} on the drone, and none in {saved}: nothing to restore")
        files.write(LIBRARY, original)
    finally:
        files.close()
    say("the drone's own library is back; switch the drone off and on")


def start(access: Access, command: str, say: Say) -> None:
    """Give the library a session number, the newest of all, and restart the firmware. Raises DroneError.

    command: that restarts the firmware, in the drone's shell.
    """
    files = Files(access.host, access.ftp_port, access.folder, say)
    try:
        names = files.names()
        missing = [name for name in (LIBRARY, IMAGE) if name not in names]
        if missing:
            raise DroneError(f"the drone has no {' and no '.join(missing)}: run dmrac mambo install first")
        files.write(SESSION, f"{session_number(time.time_ns(), 0)}\n".encode())
    finally:
        files.close()
    shell = Shell(access.host, access.telnet_port, say)
    try:
        shell.run(command)
    finally:
        shell.close()
    say("started")


def fetch(access: Access, into: Path, say: Say) -> list[Path]:
    """Fetch recording and log into a folder on this machine; returns the files. Raises DroneError."""
    files, fetched = Files(access.host, access.ftp_port, access.folder, say), []
    try:
        names = files.names()
        for name in (RECORDING, LOG):
            if name in names:
                path = into / name
                keep(path, files.read(name))
                fetched.append(path)
    finally:
        files.close()
    if not fetched:
        raise DroneError(f"the drone has neither {RECORDING} nor {LOG}: the library has not run")
    return fetched
