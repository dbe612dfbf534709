"""`dmrac bench gym` measures every kind of environment."""

import json

import pytest

from async_dmrac.command_line import main
from async_dmrac.environments import speed


def test_it_measures_one_vehicle_and_batches(capsys, monkeypatch):
    monkeypatch.setattr(speed.environment_speeds, "__defaults__", (2,))
    assert main(["bench", "gym", "--json"]) == 0
    speeds = json.loads(capsys.readouterr().out)
    assert {"motors, gymnasium.make", "rates, without wrappers", "rates, batch of 100, 1 thread"} <= set(speeds)
    assert all(one["steps_s"] > 0.0 and one["processor_us"] > 0.0 for one in speeds.values())


@pytest.mark.parametrize("option", [("--set", "seed=3"), ("--controller", "pid")])
def test_options_that_it_has_no_use_for_are_refused(option, capsys):
    assert main(["bench", "gym", *option]) == 2
    assert "not allowed with dmrac bench gym" in capsys.readouterr().err
