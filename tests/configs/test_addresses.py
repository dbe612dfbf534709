"""Addresses of a flight: what is refused, and how it is said."""

from pathlib import Path

import pytest

from configs.addresses import ADDRESSES, LINK_KEYS, RESERVED_PORTS, Addresses, SerialLine, load_network, serial_line
from configs.flight_tree import numbered
from configs.loader import ConfigError, fill
from experiments.flights.scenario import Choices, resolve

DEFAULTS = Addresses().model_dump()


def changed(**values: object) -> Addresses:
    return fill(Addresses, {**DEFAULTS, **values}, "test.yaml", "network.")


def test_the_default_addresses_differ_and_avoid_the_reserved_ports() -> None:
    network = changed()
    bound = network.bound_by_sim() | network.bound_by_onboard() | network.bound_by_offboard()
    assert len(set(bound.values())) == len(bound) == 7
    assert not {int(address.rpartition(":")[2]) for address in bound.values()} & set(RESERVED_PORTS)


def test_vehicles_of_all_numbers_stand_beside_one_another() -> None:
    taken: set[str] = set()
    for number in range(1, 101):
        flight = resolve("hover", Choices(vehicle=number))
        network = flight.network
        bound = network.bound_by_sim() | network.bound_by_onboard() | network.bound_by_offboard()
        assert not taken & set(bound.values())
        taken |= set(bound.values())
        assert flight.onboard.vehicle_id == flight.offboard.vehicle_id == number
    given = resolve(
        "hover", Choices(vehicle=2, assignments=("network.vehicle=10.0.0.2:14560", "network.vehicle_key_file=key"))
    )
    assert given.network.vehicle == "10.0.0.2:14560", "what is set by name stays"
    real = resolve("hover", Choices(vehicle=2, real=True)).network
    assert (real.vehicle, real.ground) == (DEFAULTS["vehicle"], DEFAULTS["ground"]), "these are not ours to choose"
    assert real.onboard_link == "127.0.0.1:14671"
    without_port = {"vehicle": "serial:///dev/ttyUSB0?baud=9", "key_file": "flight.key", "ground_key_file": None}
    assert numbered({"onboard": {}, "offboard": {}, "network": without_port}, 2)["network"] == without_port


@pytest.mark.parametrize("address", ["14560", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", "127.0.0.1:x", ":14560"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match=r"network\.vehicle: .*expected HOST:PORT"):
        changed(vehicle=address)


@pytest.mark.parametrize("port", RESERVED_PORTS)
def test_the_firmwares_ports_are_refused(port: int) -> None:
    with pytest.raises(ConfigError, match="reserved by the Mambo"):
        changed(onboard_vehicle=f"127.0.0.1:{port}")


def test_two_sockets_on_one_address_are_refused() -> None:
    with pytest.raises(ConfigError, match="vehicle and onboard_vehicle are both"):
        changed(onboard_vehicle=DEFAULTS["vehicle"])


def test_without_radio_two_names_are_one_address() -> None:
    network = changed(radio_onboard=DEFAULTS["offboard_link"], radio_offboard=DEFAULTS["onboard_link"])
    assert network.radio_onboard == network.offboard_link


@pytest.mark.parametrize("name", ["radio_onboard", "onboard_link", "radio_offboard", "offboard_link"])
@pytest.mark.parametrize("host", ["192.168.3.1", "0.0.0.0", "drone.local", "localhost.evil.example"])
def test_without_a_key_the_link_stays_on_this_machine(name: str, host: str) -> None:
    with pytest.raises(ConfigError, match=r"without key_file only 127\.0\.0\.0/8"):
        changed(**{name: f"{host}:15000"})
    assert changed(**{name: f"{host}:15000", "key_file": "/etc/key"}).key_file == "/etc/key"


@pytest.mark.parametrize(
    ("link", "name", "setting"),
    [
        ("vehicle", "vehicle", "vehicle_key_file"),
        ("vehicle", "onboard_vehicle", "vehicle_key_file"),
        ("ground", "ground", "ground_key_file"),
        ("motion_capture", "motion_capture", "capture_key_file"),
        ("offboard", "onboard_link", "key_file"),
    ],
)
def test_a_link_leaves_this_machine_with_its_key_or_if_it_is_said_to_be_insecure(
    link: str, name: str, setting: str
) -> None:
    away = {name: "192.168.3.1:15000"}
    others = {key.setting: "key" for key in LINK_KEYS.values() if key.setting != setting}
    with pytest.raises(ConfigError, match=rf"without {setting} only .* --insecure {link} "):
        changed(**away, **others)
    with pytest.raises(ConfigError, match=rf"without {setting} only"):
        changed(**away, insecure=tuple(other for other in LINK_KEYS if other != link))
    assert changed(**away, **{setting: "key"}).insecure_links == ""
    assert changed(**away, insecure=(link,)).insecure_links == link
    assert changed(insecure=(link,)).insecure_links == "", "on this machine nothing is insecure"
    with pytest.raises(ConfigError, match="insecure"):
        changed(insecure=("everything",))


def test_a_serial_line_is_no_network() -> None:
    assert changed(vehicle="serial:///dev/ttyUSB0").insecure_links == ""


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "localhost"])
def test_this_machine_needs_no_key(host: str) -> None:
    assert changed(onboard_link=f"{host}:15000").key_file is None


def test_options_are_laid_over_the_file_and_named_in_faults(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    lines = "".join(f"  {name}: {DEFAULTS[name]}\n" for name in ADDRESSES)
    path.write_text(f"network:\n{lines}", encoding="utf-8")
    network = load_network(path, {"vehicle": "127.0.0.1:15001", "ground": None})
    assert (network.vehicle, network.ground) == ("127.0.0.1:15001", DEFAULTS["ground"])
    with pytest.raises(ConfigError, match=r"config\.yaml with vehicle from options: network\.vehicle"):
        load_network(path, {"vehicle": "nonsense"})


@pytest.mark.parametrize(
    ("given", "kept", "line"),
    [
        ("192.168.3.1:14560", "192.168.3.1:14560", None),
        ("udp://192.168.3.1:14560", "192.168.3.1:14560", None),
        ("serial:///dev/ttyUSB0", "serial:///dev/ttyUSB0", SerialLine("/dev/ttyUSB0", 921600)),
        ("serial:///dev/ttyS1?baud=57600", "serial:///dev/ttyS1?baud=57600", SerialLine("/dev/ttyS1", 57600)),
    ],
)
def test_a_vehicle_is_named_by_address_or_url(given: str, kept: str, line: SerialLine | None) -> None:
    network = changed(vehicle=given, vehicle_key_file="key")
    assert network.vehicle == kept
    assert serial_line(network.vehicle) == line
    assert ("vehicle" in network.bound_by_sim()) == (line is None)


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("tcp://127.0.0.1:1", "expected HOST:PORT, udp://HOST:PORT or serial"),
        ("serial://ttyUSB0", "expected serial:///dev/DEVICE"),
        ("serial:///dev/ttyUSB0?baud=fast", "whole number"),
        ("serial:///dev/ttyUSB0?speed=9600", "whole number"),
        ("udp://127.0.0.1:26061", "reserved by the Mambo"),
        ("udp://127.0.0.1", "expected HOST:PORT"),
    ],
)
def test_bad_urls_of_a_vehicle_are_refused(url: str, said: str) -> None:
    with pytest.raises(ConfigError, match=r"network\.vehicle: .*" + said):
        changed(vehicle=url)
