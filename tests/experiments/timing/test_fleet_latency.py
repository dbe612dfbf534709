"""`dmrac bench fleet`: real vehicles' cores, a real trainer, real sockets."""

import json
from typing import Any

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.timing import fleet_latency
from experiments.timing.fleet_latency import FleetLatency, RemoteOffboard, as_json
from onboard.c.compile import BuildError, compiler
from runtime.sockets import AddressInUseError, DatagramSocket


def one(vehicles: int, p50_s: float) -> FleetLatency:
    return FleetLatency(vehicles, 40.0, 10, 20, p50_s, 2.0 * p50_s, 0.0, 0)


def test_the_targets_are_to_a_single_vehicle() -> None:
    found = as_json([one(1, 0.5), one(4, 0.9), one(8, 0.7), one(16, 0.9)])
    assert [row["met"] for row in found] == [True, None, False, True]
    assert as_json([one(1, 1.6)])[0]["met"] is False
    assert as_json([one(1, np.nan), one(8, 0.5)])[1]["met"] is None


def test_datagrams_go_both_ways_and_an_address_is_free_again() -> None:
    config = fleet_latency._config(3, 5.0)
    network = config.network
    assert (network.radio_offboard, network.radio_onboard) == (network.onboard_link, network.offboard_link)
    trainer = DatagramSocket("trainer", network.offboard_link, network.onboard_link)
    capture = DatagramSocket("capture", network.motion_capture, None)
    remote = RemoteOffboard(config)
    with pytest.raises(AddressInUseError):
        RemoteOffboard(config)
    remote.receive_onboard(b"samples", 0)
    remote.receive_motion_capture(b"pose", 0)
    trainer.send(b"version")
    assert trainer.receive(9) == [b"samples"]
    assert capture.receive(9) == [b"pose"]
    assert remote.step(0).to_onboard == [b"version"]
    for socket in (remote, trainer, capture):
        socket.close()
    RemoteOffboard(config).close()


def test_options_that_do_not_fit(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "fleet", "--controller", "l1"]) == 2
    assert "--controller, --set: not allowed with dmrac bench fleet" in capsys.readouterr().err
    assert main(["bench", "hover", "--vehicles", "2"]) == 2
    assert "--vehicles 2: only with dmrac bench core, fleet" in capsys.readouterr().err


@pytest.mark.realtime
def test_two_vehicles_learn_from_one_trainer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        compiler()
    except BuildError as error:
        pytest.skip(str(error))
    config = fleet_latency._config

    def eager(number: int, seconds: float) -> Any:  # a first version within seconds
        made = config(number, seconds)
        trainer = made.offboard.trainer.model_copy(update={"minimum_samples": 60})
        return made.model_copy(update={"offboard": made.offboard.model_copy(update={"trainer": trainer})})

    monkeypatch.setattr(fleet_latency, "_config", eager)
    monkeypatch.setattr(fleet_latency, "FLEETS", ())
    assert main(["bench", "fleet", "--vehicles", "2", "--seconds", "16", "--json"]) == 0
    [found] = json.loads(capsys.readouterr().out)
    assert (found["vehicles"], found["lost"]) == (2, 0)
    assert found["versions"] >= 2
    assert found["rounds"] >= found["versions"]
    assert 0.0 < found["p50_s"] <= found["p90_s"] < 16.0
