"""`dmrac fly --vehicle N`: ports and id of its own, and the command that repeats the flight."""

import argparse

import pytest

from async_dmrac.command_line import build_parser, main
from async_dmrac.commands import fly
from configs.addresses import ADDRESSES
from configs.flight_tree import PORTS_EACH, Choices
from experiments.flights.scenario import resolve
from runtime.sockets import AddressInUseError


def arguments(*words: str) -> argparse.Namespace:
    return build_parser("fly").parse_args(["fly", *words])


def test_two_flights_share_no_address() -> None:
    first, second = (resolve("hover", Choices("pid", vehicle=number)) for number in (1, 2))
    for name in ADDRESSES:
        one, other = (int(getattr(flight.network, name).rpartition(":")[2]) for flight in (first, second))
        assert other == one + PORTS_EACH
    assert second.onboard.vehicle_id == 2


def test_the_record_repeats_it() -> None:
    config = resolve("hover", Choices("pid", vehicle=3))
    words = fly.repeat_command(arguments("hover", "--controller", "pid", "--vehicle", "3"), config).split()
    assert words[words.index("--vehicle") + 1] == "3"
    assert "--vehicle" not in fly.repeat_command(arguments("hover"), config)


def test_taken_ports_name_the_number_that_is_free(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def taken(network: object) -> None:
        raise AddressInUseError("network.vehicle: 127.0.0.1:14560 is in use")

    monkeypatch.setattr(fly, "require_free_ports", taken)
    monkeypatch.setattr(fly, "free_vehicle_number", lambda *_: 4)
    assert main(["fly", "hover", "--controller", "pid"]) == 2
    assert capsys.readouterr().err.endswith("is in use; or fly beside it with --vehicle 4\n")
