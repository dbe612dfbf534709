"""Addresses of the three processes of a flight, and the files of the keys that protect their links."""

import ipaddress
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from configs.loader import ConfigRecord, fill, merge, read_tree

RESERVED_PORTS: Final = (24099, 26061)
"""Ports of the Mambo's firmware."""
ONBOARD_VEHICLE_PORT: Final = 14561
ONBOARD_LINK_PORT: Final = 14571
OFFBOARD_LINK_PORT: Final = 14573
MOTION_CAPTURE_PORT: Final = 14574
"""Default ports of the sockets of onboard and offboard."""
WITHOUT_RADIO: Final = ({"radio_onboard", "offboard_link"}, {"radio_offboard", "onboard_link"})
"""Pairs that have the same address when onboard and offboard are connected directly, as with a real vehicle."""


def check_address(address: str) -> str:
    """Return `address` if it is HOST:PORT with an allowed port. Raises ValueError that names what is allowed."""
    host, colon, port = address.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise ValueError("expected HOST:PORT with a port from 1 to 65535")
    if int(port) in RESERVED_PORTS:
        raise ValueError(f"port {port} is reserved by the Mambo's firmware; choose another")
    return address


Address = Annotated[str, AfterValidator(check_address)]
"""An IPv4 address or host name and a UDP port, "host:port"."""


SERIAL_DEFAULT_BAUD: Final = 921600
_SERIAL: Final = re.compile(r"^serial://(?P<device>/[^?#\s]+)(?:\?baud=(?P<baud>[1-9][0-9]{0,7}))?$")


class SerialLine(NamedTuple):
    """A vehicle on a serial line."""

    device: str
    baud: int


def serial_line(address: str) -> SerialLine | None:
    """Parse serial:///dev/ttyX?baud=N; None for an address on the network."""
    match = _SERIAL.match(address)
    return None if match is None else SerialLine(match["device"], int(match["baud"] or SERIAL_DEFAULT_BAUD))


def check_vehicle_address(address: str) -> str:
    """Return a vehicle's address in its plain form: udp://HOST:PORT becomes HOST:PORT, a serial line is unchanged.

    Raises
    ------
    ValueError
        If it is none of them; the message names what is allowed.
    """
    scheme, separator, rest = address.partition("://")
    if not separator:
        return check_address(address)
    if scheme == "udp":
        return check_address(rest)
    if scheme != "serial":
        raise ValueError("expected HOST:PORT, udp://HOST:PORT or serial:///dev/DEVICE?baud=N")
    if serial_line(address) is None:
        raise ValueError("expected serial:///dev/DEVICE?baud=N with a whole number N")
    return address


VehicleAddress = Annotated[str, AfterValidator(check_vehicle_address)]
"""HOST:PORT, udp://HOST:PORT or serial:///dev/DEVICE?baud=N."""


def is_loopback(address: str) -> bool:
    """Whether the address stays within this machine."""
    host = address.rpartition(":")[0]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


LinkName = Literal["offboard", "vehicle", "ground", "motion_capture"]


class LinkKey(NamedTuple):
    """What protects a link."""

    setting: str
    """Of `Addresses`: the file of its key."""
    option: str
    addresses: tuple[str, ...]
    """Of `Addresses`: a link with one of them off this machine needs the key."""


LINK_KEYS: Final[dict[LinkName, LinkKey]] = {
    "offboard": LinkKey("key_file", "--key-file", ("radio_onboard", "onboard_link", "radio_offboard", "offboard_link")),
    "vehicle": LinkKey("vehicle_key_file", "--vehicle-key-file", ("vehicle", "onboard_vehicle")),
    "ground": LinkKey("ground_key_file", "--ground-key-file", ("ground",)),
    "motion_capture": LinkKey("capture_key_file", "--capture-key-file", ("motion_capture",)),
}


def keyless_fault(link: LinkName, address: str) -> str:
    """Why a link without a key is refused at an address that is not on this machine, and what to do."""
    key = LINK_KEYS[link]
    return (
        f"{address} leaves this machine, and without {key.setting} only 127.0.0.0/8 is accepted; "
        f"make a key with dmrac keygen and give it with {key.option}, "
        f"or say --insecure {link} (network.insecure: [{link}])"
    )


class Addresses(ConfigRecord):
    """Who binds what. Each process binds its own addresses and sends from there to its peer's.

    By default all three processes are on this machine. For three machines give each address by the name or number of
    the machine that binds it, and the file of a key for each link between them.
    """

    vehicle: VehicleAddress = Field(
        default="127.0.0.1:14560",
        description="the vehicle's MAVLink socket, or the serial line it is on: motor commands go there",
    )
    onboard_vehicle: Address = Field(
        default=f"127.0.0.1:{ONBOARD_VEHICLE_PORT}", description="onboard's socket towards the vehicle, for its sensors"
    )
    radio_onboard: Address = Field(
        default="127.0.0.1:14570", description="the vehicle radio's side towards onboard; without radio, offboard"
    )
    onboard_link: Address = Field(
        default=f"127.0.0.1:{ONBOARD_LINK_PORT}", description="onboard's socket towards the radio"
    )
    radio_offboard: Address = Field(
        default="127.0.0.1:14572", description="the vehicle radio's side towards offboard; without radio, onboard"
    )
    offboard_link: Address = Field(
        default=f"127.0.0.1:{OFFBOARD_LINK_PORT}", description="offboard's socket towards the radio"
    )
    motion_capture: Address = Field(
        default=f"127.0.0.1:{MOTION_CAPTURE_PORT}", description="offboard's socket for the motion capture's ODOMETRY"
    )
    ground: Address = Field(default="127.0.0.1:14550", description="the ground station onboard reports to")
    key_file: str | None = Field(
        default=None,
        description="file with the key shared by onboard and offboard, made by dmrac keygen, not in the log",
    )
    vehicle_key_file: str | None = Field(
        default=None, description="file with the key of the vehicle's MAVLink: sign, and take signed frames only"
    )
    ground_key_file: str | None = Field(
        default=None, description="file with the key of the ground station's MAVLink: sign, take signed frames only"
    )
    capture_key_file: str | None = Field(
        default=None, description="file with the key of the motion capture's MAVLink: take signed frames only"
    )
    insecure: tuple[LinkName, ...] = Field(
        default=(), description="links that may leave this machine without a key; anybody can then fly the vehicle"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        bound = self.bound_by_sim() | self.bound_by_onboard() | self.bound_by_offboard()
        taken: dict[str, str] = {}
        for name, address in bound.items():
            if address in taken and {taken[address], name} not in WITHOUT_RADIO:
                raise ValueError(f"{taken[address]} and {name} are both {address}")
            taken[address] = name
        for link in self._open_links():
            if link not in self.insecure:
                raise ValueError(keyless_fault(link, self._leaving(link)[0]))
        return self

    @property
    def insecure_links(self) -> str:
        """The links that leave this machine without a key, for the status lines; "" if there is none."""
        return ", ".join(self._open_links())

    def _open_links(self) -> list[LinkName]:
        """Links that leave this machine without a key."""
        keyless = [link for link, key in LINK_KEYS.items() if getattr(self, key.setting) is None]
        return [link for link in keyless if self._leaving(link)]

    def _leaving(self, link: LinkName) -> list[str]:
        """The addresses of a link that are not on this machine. A serial line is a wire of this machine."""
        addresses: list[str] = [getattr(self, name) for name in LINK_KEYS[link].addresses]
        if serial_line(self.vehicle) is not None and link == "vehicle":
            return []
        return [address for address in addresses if not is_loopback(address)]

    def bound_by_sim(self) -> dict[str, str]:
        """Addresses that the simulation binds, by name; without the vehicle's if it is on a serial line."""
        vehicle = {"vehicle": self.vehicle} if serial_line(self.vehicle) is None else {}
        return {**vehicle, "radio_onboard": self.radio_onboard, "radio_offboard": self.radio_offboard}

    def bound_by_onboard(self) -> dict[str, str]:
        """Addresses that the onboard process binds, by name."""
        return {"onboard_vehicle": self.onboard_vehicle, "onboard_link": self.onboard_link}

    def bound_by_offboard(self) -> dict[str, str]:
        """Addresses that the offboard process binds, by name."""
        return {"offboard_link": self.offboard_link, "motion_capture": self.motion_capture}


ADDRESSES: Final = tuple(
    sorted(name for name, field in Addresses.model_fields.items() if isinstance(field.default, str))
)
"""Names of the settings that are addresses."""


def load_network(path: Path, options: Mapping[str, Any]) -> Addresses:
    """The addresses of a resolved configuration, overruled by those given as options.

    Raises
    ------
    ConfigError
        Naming the file, the address and what is allowed.
    """
    return network_of(read_tree(path), str(path), options)


def network_of(tree: Mapping[str, Any], source: str, options: Mapping[str, Any]) -> Addresses:
    """The addresses of a flight's plain tree, overruled by those given as options. Raises ConfigError."""
    section = tree.get("network")
    given = {name: value for name, value in options.items() if value not in (None, ())}
    source = f"{source} with {', '.join(given)} from options" if given else source
    return fill(Addresses, merge(section if isinstance(section, dict) else {}, given), source, at="network.")


def seen_from_onboard(options: Mapping[str, str | None]) -> dict[str, str | None]:
    """All addresses without a radio, derived from those of vehicle and offboard where none is given."""
    offboard = options["radio_onboard"] or ""
    vehicle = options["vehicle"] or ""
    onboard_link = options.get("onboard_link") or own_address(offboard, ONBOARD_LINK_PORT)
    facing = own_address("localhost:0" if serial_line(vehicle) else vehicle, ONBOARD_VEHICLE_PORT)
    implied = {"onboard_vehicle": facing, "onboard_link": onboard_link}
    implied |= {"offboard_link": offboard, "radio_offboard": onboard_link}
    return {**implied, **{name: address for name, address in options.items() if address is not None}}


def seen_from_offboard(options: Mapping[str, str | None]) -> dict[str, str | None]:
    """All addresses without a radio, derived from onboard's where none is given."""
    onboard = options["radio_offboard"] or ""
    offboard_link = options.get("offboard_link") or own_address(onboard, OFFBOARD_LINK_PORT)
    open_to = onboard if options.get("capture_key_file") else "localhost:0"  # without a key: from this machine only
    implied = {"offboard_link": offboard_link, "motion_capture": own_address(open_to, MOTION_CAPTURE_PORT)}
    implied |= {"onboard_link": onboard, "radio_onboard": offboard_link}
    return {**implied, **{name: address for name, address in options.items() if address is not None}}


def own_address(peer: str, port: int) -> str:
    """The default address to receive from `peer` at; it is open to this machine only if the peer is on it."""
    return f"127.0.0.1:{port}" if is_loopback(peer) else f"0.0.0.0:{port}"
