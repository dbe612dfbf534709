"""The preflight certificate: the file with the results of `dmrac preflight`.

Onboard arms a real vehicle only with a complete, good and recent certificate. Onboard can check the IMU stream, the
sensors at rest and the pose by itself (links/health.py, estimation/pose_health.py). A person has to check the signs in
a tilt, the motor order and the bridge's time-out. The digest detects a file that was edited or cut; it is not a
signature.
"""

import hashlib
import json
import re
from typing import Final, Literal, NamedTuple

from configs.addresses import serial_line
from configs.loader import ConfigError, ConfigRecord, fill
from onboard.preflight.checks import Check, Result

AGE_MAX_S: Final = 24 * 3600
"""A certificate is valid for one day of flying."""
FUTURE_MAX_S: Final = 300
"""Allowed difference between the clocks of two machines."""


class Clearance(NamedTuple):
    """Whether the vehicle may be armed, as known before the flight."""

    refusal: str = ""
    """Why the vehicle must not be armed; "" if it may be."""
    notice: str = ""
    """Text that is logged and sent to the ground station at the start."""


CLEAR: Final = Clearance()


class CertifiedCheck(ConfigRecord):
    """One row of the table."""

    name: str
    result: Literal["pass", "FAIL", "not done", "absent"]
    measured: str


class Certificate(ConfigRecord):
    """The results of a preflight check of one vehicle."""

    format: Literal[1] = 1
    vehicle: str
    """udp://HOST:PORT or serial:///dev/DEVICE."""
    utc_s: int
    """End of the check, s since 1970."""
    with_pose: bool
    """Whether the pose of the motion capture was checked too."""
    checks: tuple[CertifiedCheck, ...]
    digest: str
    """SHA-256 of all other fields."""

    @property
    def failed(self) -> list[str]:
        """Names of the checks that failed."""
        return [check.name for check in self.checks if check.result == Result.FAIL.value]

    @property
    def left_out(self) -> list[str]:
        """Names of the checks that were not done."""
        return [check.name for check in self.checks if check.result == Result.SKIPPED.value]


def vehicle_url(address: str) -> str:
    """The vehicle's name in a certificate: its address as a URL; for a serial line without the speed."""
    line = serial_line(address)
    return f"udp://{address}" if line is None else f"serial://{line.device}"


def certificate_name(address: str) -> str:
    """The default file name of a vehicle's certificate."""
    return f"preflight_{re.sub(r'[^A-Za-z0-9.]+', '_', vehicle_url(address).partition('://')[2]).strip('_')}.json"


def write_certificate(address: str, utc_s: int, with_pose: bool, checks: list[Check]) -> bytes:
    """The content of the certificate file for the vehicle at `address`."""
    rows = tuple(CertifiedCheck(name=row.name, result=row.result.value, measured=row.measured) for row in checks)
    certificate = Certificate(vehicle=vehicle_url(address), utc_s=utc_s, with_pose=with_pose, checks=rows, digest="")
    certificate = certificate.model_copy(update={"digest": _digest(certificate)})
    return json.dumps(certificate.model_dump(mode="json"), indent=1).encode() + b"\n"


def read_certificate(content: bytes, source: str) -> Certificate:
    """Read a certificate from the content of the file `source`.

    Raises
    ------
    ConfigError
        If the content is not a preflight certificate; the message names `source`.
    """
    try:
        tree = json.loads(content)
    except ValueError:
        tree = None
    if not isinstance(tree, dict):
        raise ConfigError(f"{source}: not a preflight certificate")
    return fill(Certificate, tree, source)


def arming_refusal(certificate: Certificate, address: str, needs_pose: bool, utc_s: float) -> str:
    """Why the vehicle at `address` may not be armed with this certificate; "" if it may."""
    if certificate.digest != _digest(certificate):
        return "preflight certificate was changed after it was written: repeat dmrac preflight"
    if certificate.vehicle != vehicle_url(address):
        return f"preflight was of {certificate.vehicle}, not of {vehicle_url(address)}"
    if certificate.failed:
        return f"preflight failed: {_listed(certificate.failed)}"
    if certificate.left_out or not certificate.checks:
        return f"preflight is not complete: {_listed(certificate.left_out) or 'no checks'}"
    if needs_pose and not certificate.with_pose:
        return "preflight was done without the pose: repeat it with --pose"
    age_s = utc_s - certificate.utc_s
    if age_s > AGE_MAX_S:
        return f"preflight is {age_s / 3600:.0f} h old, the limit is {AGE_MAX_S // 3600} h: repeat it"
    if age_s < -FUTURE_MAX_S:
        return "preflight has a date in the future: set the clock, or repeat it"
    return ""


def _listed(names: list[str]) -> str:
    """The first name, and how many more there are."""
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "") if names else ""


def _digest(certificate: Certificate) -> str:
    tree = certificate.model_dump(mode="json", exclude={"digest"})
    return hashlib.sha256(json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
