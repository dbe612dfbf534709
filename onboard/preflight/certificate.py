"""What a preflight check found, as a file: `dmrac preflight` writes it; onboard arms a real vehicle only on a good one.

Onboard can judge the stream, the sensors at rest and the pose by itself (link_health.py, pose_health.py). Signs in a
tilt, motor order and the bridge's time-out need a person; for these it asks for the record. Its digest keeps a file
that was edited or cut from counting; it is no signature.
"""

import hashlib
import json
import re
from typing import Final, Literal, NamedTuple

from configs.addresses import serial_line
from configs.loader import ConfigError, ConfigRecord, fill
from onboard.preflight.checks import Check, Result

AGE_MAX_S: Final = 24 * 3600
"""A day of flying; after that, or a change to vehicle or bridge, it has to be done again."""
FUTURE_MAX_S: Final = 300
"""Clocks of two machines may differ by so much."""


class Clearance(NamedTuple):
    """What stands against arming from the beginning on, and what is said of it."""

    bar: str = ""
    """Why the vehicle must not be armed; "" for no reason."""
    notice: str = ""
    """Said at the start, to log and ground station."""


CLEAR: Final = Clearance()


class RecordedCheck(ConfigRecord):
    """One row of the table."""

    name: str
    result: Literal["pass", "FAIL", "not done", "absent"]
    measured: str


class PreflightRecord(ConfigRecord):
    """A preflight check of one vehicle."""

    format: Literal[1] = 1
    vehicle: str
    """udp://HOST:PORT or serial:///dev/DEVICE."""
    utc_s: int
    """When it ended, since 1970."""
    with_pose: bool
    """Whether the motion capture's pose was checked too."""
    checks: tuple[RecordedCheck, ...]
    digest: str
    """SHA-256 of all the rest."""

    @property
    def failed(self) -> list[str]:
        """Names of the checks that failed."""
        return [check.name for check in self.checks if check.result == Result.FAIL.value]

    @property
    def left_out(self) -> list[str]:
        """Names of the checks that were not done."""
        return [check.name for check in self.checks if check.result == Result.SKIPPED.value]


def vehicle_url(address: str) -> str:
    """A vehicle's name in a record: its plain address as a URL, a serial line without its speed."""
    line = serial_line(address)
    return f"udp://{address}" if line is None else f"serial://{line.device}"


def record_name(address: str) -> str:
    """The file that a vehicle's record stands in when nothing else is said."""
    return f"preflight_{re.sub(r'[^A-Za-z0-9.]+', '_', vehicle_url(address).partition('://')[2]).strip('_')}.json"


def write_record(address: str, utc_s: int, with_pose: bool, checks: list[Check]) -> bytes:
    """The record of a check of the vehicle at `address` as the content of a file."""
    rows = tuple(RecordedCheck(name=row.name, result=row.result.value, measured=row.measured) for row in checks)
    record = PreflightRecord(vehicle=vehicle_url(address), utc_s=utc_s, with_pose=with_pose, checks=rows, digest="")
    record = record.model_copy(update={"digest": _digest(record)})
    return json.dumps(record.model_dump(mode="json"), indent=1).encode() + b"\n"


def read_record(content: bytes, source: str) -> PreflightRecord:
    """A record from its file.

    Raises
    ------
    ConfigError
        If it is none, naming `source`.
    """
    try:
        tree = json.loads(content)
    except ValueError:
        tree = None
    if not isinstance(tree, dict):
        raise ConfigError(f"{source}: is no preflight record")
    return fill(PreflightRecord, tree, source)


def objection(record: PreflightRecord, address: str, needs_pose: bool, utc_s: float) -> str:
    """Why the vehicle at `address` may not be armed on this record; "" when it may."""
    if record.digest != _digest(record):
        return "preflight record was changed after it was written: repeat dmrac preflight"
    if record.vehicle != vehicle_url(address):
        return f"preflight was of {record.vehicle}, not of {vehicle_url(address)}"
    if record.failed:
        return f"preflight failed: {_listed(record.failed)}"
    if record.left_out or not record.checks:
        return f"preflight is not complete: {_listed(record.left_out) or 'no checks'}"
    if needs_pose and not record.with_pose:
        return "preflight was done without the pose: repeat it with --pose"
    age_s = utc_s - record.utc_s
    if age_s > AGE_MAX_S:
        return f"preflight is {age_s / 3600:.0f} h old, at most {AGE_MAX_S // 3600} h count: repeat it"
    if age_s < -FUTURE_MAX_S:
        return "preflight has a date in the future: set the clock, or repeat it"
    return ""


def _listed(names: list[str]) -> str:
    """The first of some names, and how many more there are."""
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "") if names else ""


def _digest(record: PreflightRecord) -> str:
    tree = record.model_dump(mode="json", exclude={"digest"})
    return hashlib.sha256(json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
