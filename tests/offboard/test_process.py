"""The offboard process: which vehicles it serves, that failures of one do not affect the others, what it refuses."""

import argparse
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from configs.addresses import load_network
from experiments.flights.scenario import Choices, resolve
from offboard import command as offboard_command
from offboard.process import serve
from tests.experiments.processes import on_ports


class Service:
    """Counts its steps; requests the end after `steps`, or fails in every step."""

    def __init__(self, stop: Any, steps: int, failing: bool = False) -> None:
        self.sockets = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM),)
        self.sockets[0].bind(("127.0.0.1", 0))
        self.steps, self.ended, self.ends_well = 0, False, True
        self._stop, self._until, self._failing = stop, steps, failing

    @property
    def given_up(self) -> bool:
        return self._failing and self.steps >= self._until

    def due(self, now_ns: int) -> bool:
        return True

    def step(self) -> None:
        self.steps += 1
        if self.steps >= self._until and not self._failing:
            self._stop.count = 1

    def end(self) -> bool:
        self.ended = True
        self.sockets[0].close()
        return self.ends_well


def test_the_others_are_served_after_a_vehicle_is_given_up() -> None:
    stop: Any = SimpleNamespace(count=0)
    services: Any = [Service(stop, 2, failing=True), Service(stop, 5)]
    assert serve(services, stop) == 1
    assert [service.steps for service in services] == [2, 5]
    assert all(service.ended for service in services)


def test_all_given_up_ends_the_process() -> None:
    stop: Any = SimpleNamespace(count=0)
    services: Any = [Service(stop, 2, failing=True), Service(stop, 3, failing=True)]
    assert serve(services, stop) == 1
    assert [service.steps for service in services] == [2, 3]


def test_the_status_is_0_without_failures() -> None:
    stop: Any = SimpleNamespace(count=0)
    service: Any = Service(stop, 3)
    assert serve([service], stop) == 0


def test_a_failed_end_gives_status_1_and_the_others_end_too() -> None:
    stop: Any = SimpleNamespace(count=0)
    services: Any = [Service(stop, 3), Service(stop, 3)]
    services[0].ends_well = False
    assert serve(services, stop) == 1
    assert all(service.ended for service in services)


def configuration(path: Path, vehicle: int, first_port: int) -> Path:
    path.write_text(on_ports(resolve("hover", Choices(vehicle=vehicle)), first_port).to_yaml(), encoding="utf-8")
    return path


def refused(capfd: pytest.CaptureFixture[str], *words: object) -> str:
    parser = argparse.ArgumentParser()
    offboard_command.add_arguments(parser)
    assert offboard_command.run(parser.parse_args([str(word) for word in words])) == 2
    return capfd.readouterr().err


def test_several_vehicles_need_their_own_number_and_addresses(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    first = configuration(tmp_path / "first.yaml", 1, 18000)
    twin = configuration(tmp_path / "twin.yaml", 1, 18020)
    neighbour = configuration(tmp_path / "neighbour.yaml", 2, 18000)
    message = refused(capfd, "--config", first, "--also", twin, "--out", tmp_path)
    assert "twin.yaml: offboard.vehicle_id: 1 is used by" in message
    message = refused(capfd, "--config", first, "--also", neighbour, "--out", tmp_path)
    assert "neighbour.yaml: network." in message
    assert "is used by" in message


def test_vehicles_that_share_their_networks_need_the_same_training(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    first = configuration(tmp_path / "first.yaml", 1, 18000)
    second = configuration(tmp_path / "second.yaml", 2, 18020)
    for keys, old, new in (
        ("features.trained.dropout", "dropout: 0.0", "dropout: 0.1"),
        ("offboard.trainer.batches", "batches: 80", "batches: 40"),
    ):
        text = second.read_text(encoding="utf-8")
        other = tmp_path / "other.yaml"
        other.write_text(text.replace(old, new), encoding="utf-8")
        message = refused(capfd, "--config", first, "--also", other, "--out", tmp_path)
        assert f"other.yaml: {keys}: {new.split()[1]}; allowed is {old.split()[1]}, as in" in message


def test_options_for_one_vehicle_are_refused_with_also(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first = configuration(tmp_path / "first.yaml", 1, 18000)
    second = configuration(tmp_path / "second.yaml", 2, 18020)
    assert "--also: needs --config" in refused(capfd, "--onboard", "127.0.0.1:14571", "--also", second)
    both = ("--config", first, "--also", second, "--out", tmp_path)
    assert "--bind-link: not allowed with --also" in refused(capfd, *both, "--bind-link", "127.0.0.1:18099")
    assert "give the --out folder" in refused(capfd, *both, "--resume", tmp_path / "checkpoint.npz")
    assert "holds no vehicle_N/checkpoint.npz" in refused(capfd, *both, "--resume", tmp_path)
    (tmp_path / "vehicle_2").mkdir()
    (tmp_path / "vehicle_2" / "checkpoint.npz").write_bytes(b"damaged")
    assert "vehicle_2/checkpoint.npz: " in refused(capfd, *both, "--resume", tmp_path)


def test_an_address_in_use_is_named_by_its_key_in_the_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    first = configuration(tmp_path / "first.yaml", 1, 18040)
    second = configuration(tmp_path / "second.yaml", 2, 18060)
    address = load_network(second, {}).offboard_link
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", int(address.rpartition(":")[2])))
        message = refused(capfd, "--config", first, "--also", second, "--out", tmp_path)
    assert message.startswith(f"network.offboard_link: {address} is in use")
