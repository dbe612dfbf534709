"""The flight of a process: from a file, or from the addresses of vehicle and peer alone."""

import argparse
from pathlib import Path

import pytest

from configs.addresses import seen_from_offboard, seen_from_onboard
from configs.loader import ConfigError, parse_mapping
from experiments.flights.scenario import Choices, complete, fill_flight, resolve
from offboard import command as offboard_command
from onboard import command as onboard_command
from onboard.config import OnboardConfig
from protocol.feature_config import fill_process
from runtime.flight_options import FlightOptions, flight_of

NEEDED = {"--vehicle": "URL", "--offboard": "HOST:PORT"}


def onboard(*words: str) -> FlightOptions:
    parser = argparse.ArgumentParser()
    onboard_command.add_arguments(parser)
    return flight_of(parser.parse_args(words), onboard_command.OPTIONS, NEEDED, seen_from_onboard)


def offboard(*words: str) -> FlightOptions:
    parser = argparse.ArgumentParser()
    offboard_command.add_arguments(parser)
    options = offboard_command.OPTIONS
    return flight_of(parser.parse_args(words), options, {"--onboard": "HOST:PORT"}, seen_from_offboard)


def test_addresses_alone_make_a_flight_with_the_settings_for_a_real_vehicle() -> None:
    words = ("--vehicle", "udp://192.168.3.1:14560", "--vehicle-key-file", "vehicle.key")
    flight = onboard(*words, "--offboard", "127.0.0.1:14573")
    tree = parse_mapping(flight.text.decode(), "log")
    config = complete(tree, "log")
    expected = resolve("hover", Choices("dmrac", real=True))
    assert config.onboard == expected.onboard
    assert fill_flight(tree, "log").onboard == fill_process(OnboardConfig, flight.tree, "", "onboard")
    assert config.onboard.supervisor.auto_arm is False
    assert config.network == flight.network
    assert flight.network.vehicle == "192.168.3.1:14560"
    assert flight.network.onboard_vehicle == "0.0.0.0:14561"
    assert flight.network.onboard_link == flight.network.radio_offboard == "127.0.0.1:14571"
    assert flight.network.radio_onboard == flight.network.offboard_link == "127.0.0.1:14573"


def test_controller_scenario_and_values_can_be_chosen() -> None:
    words = ("--controller", "pid", "--scenario", "figure8_calm", "--duration", "90")
    words += ("--set", "onboard.airframe.mass_kg=0.068", "--bind-link", "127.0.0.2:1234", "--ground", "127.0.0.1:9")
    flight = onboard("--vehicle", "serial:///dev/ttyS7", "--offboard", "127.0.0.1:14573", *words)
    config = complete(flight.tree, "").onboard
    chosen = Choices("pid", None, 90.0, ("onboard.airframe.mass_kg=0.068",), real=True)
    assert config == resolve("figure8_calm", chosen).onboard
    network = flight.network
    assert (network.vehicle, network.onboard_link, network.ground) == (
        "serial:///dev/ttyS7",
        "127.0.0.2:1234",
        "127.0.0.1:9",
    )
    assert network.onboard_vehicle == "127.0.0.1:14561", "nothing is received from the network"


def test_with_another_machine_a_key_is_required_and_all_interfaces_are_bound() -> None:
    with pytest.raises(ConfigError, match=r"--onboard 10\.0\.0\.2:14571: network: .*key_file.*dmrac keygen"):
        offboard("--onboard", "10.0.0.2:14571")
    network = offboard("--onboard", "10.0.0.2:14571", "--key-file", "link.key").network
    assert (network.offboard_link, network.motion_capture) == ("0.0.0.0:14573", "127.0.0.1:14574")
    words = ("--onboard", "10.0.0.2:14571", "--key-file", "link.key", "--capture-key-file", "capture.key")
    assert offboard(*words).network.motion_capture == "0.0.0.0:14574"
    assert network.radio_offboard == "10.0.0.2:14571"
    assert offboard("--onboard", "127.0.0.1:14571").network.motion_capture == "127.0.0.1:14574"


def test_a_link_is_insecure_only_if_that_link_is_named() -> None:
    words = ("--vehicle", "udp://10.0.0.9:14560", "--offboard", "127.0.0.1:14573")
    with pytest.raises(ConfigError, match="vehicle_key_file"):
        onboard(*words, "--insecure", "ground")
    network = onboard(*words, "--insecure", "ground", "--insecure", "vehicle").network
    assert network.insecure_links == "vehicle"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", r"^--vehicle URL and --offboard HOST:PORT missing; .* --config FILE"),
        ("--vehicle udp://10.0.0.9:1", r"^--offboard HOST:PORT missing"),
        ("--vehicle tcp://10.0.0.9:1 --offboard 127.0.0.1:1", r"^--vehicle tcp://10\.0\.0\.9:1: expected HOST:PORT, u"),
        ("--vehicle udp://10.0.0.9 --offboard 127.0.0.1:1", r"^--vehicle udp://10\.0\.0\.9: expected HOST:PORT"),
        ("--vehicle udp://10.0.0.9:26061 --offboard 127.0.0.1:1", "port 26061 is reserved"),
        ("--vehicle udp://0.0.0.0:14560 --offboard 127.0.0.1:1", "0.0.0.0 is this machine's own"),
        ("--vehicle serial:/dev/ttyS0 --offboard 127.0.0.1:1", "expected HOST:PORT"),
        ("--vehicle serial:///dev/ttyS0?baud=fast --offboard 127.0.0.1:1", "with a whole number N"),
        ("--vehicle udp://10.0.0.9:1 --offboard nowhere", r"^--offboard nowhere: expected HOST:PORT"),
        ("--vehicle udp://10.0.0.9:1 --offboard 127.0.0.1:70000", "a port from 1 to 65535"),
        ("--vehicle udp://10.0.0.9:1 --offboard 127.0.0.1:1 --ground x", r"^--ground x: expected HOST:PORT"),
        ("--vehicle udp://127.0.0.1:14561 --offboard 127.0.0.1:1", "vehicle and onboard_vehicle are both"),
        ("--vehicle udp://10.0.0.9:1 --offboard 127.0.0.1:1 --controller magic", "unknown controller 'magic'"),
        ("--vehicle udp://10.0.0.9:1 --offboard 127.0.0.1:1 --duration 1", r"^--duration 1\.0: "),
        ("--config flight.yaml --controller pid", r"^--controller: not beside --config"),
        ("--config flight.yaml --set a=1", r"^--set: not beside --config"),
        ("--config none.yaml", r"^none\.yaml: cannot be read"),
    ],
)
def test_invalid_options_give_one_line(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=message) as error:
        onboard(*words.split())
    assert "\n" not in str(error.value)


def test_a_file_contains_everything_and_options_overrule_its_addresses(tmp_path: Path) -> None:
    path = tmp_path / "flight.yaml"
    path.write_text(resolve("hover", Choices("pid")).to_yaml(), encoding="utf-8")
    flight = onboard("--config", str(path), "--vehicle", "udp://127.0.0.1:15560")
    assert flight.text == path.read_bytes()
    assert flight.network.vehicle == "127.0.0.1:15560"
    assert flight.network.radio_onboard == "127.0.0.1:14570"
