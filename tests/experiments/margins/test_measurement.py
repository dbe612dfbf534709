"""Margins measured in flight: they agree with the linear prediction, and an unstable delay is one."""

import json
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from configs.flight_tree import Choices
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import resolve
from experiments.margins.linear import predicted_loop
from experiments.margins.measurement import Band, LoopMeasurementError, flight_time_s, measure
from experiments.margins.stability import margins
from experiments.margins.table import measure_all

SHORT = Band(1.0, 16.0, 10, 0.6, 5.0, 3)
LONG = Band(1.0, 10.0, 10, 2.0, 10.0, 3)
FINE = 2.0 * np.pi * np.geomspace(0.1, 40.0, 400)
SETTINGS = "onboard.controller.settings"
GAINS = (
    f"{SETTINGS}.position.gains.natural_frequency_rad_s=[6.9,6.9,5.0]",
    f"{SETTINGS}.position.gains.damping=1.1",
    f"{SETTINGS}.position.augmentation.gain=[4.6,4.6,54.0]",
    f"{SETTINGS}.attitude.gains.natural_frequency_rad_s=[16.5,16.5,5.0]",
    f"{SETTINGS}.attitude.gains.damping=1.1",
    f"{SETTINGS}.attitude.augmentation.gain=[418.0,418.0,20.0]",
)
"""Whatever the search has found since."""
PLAIN = (
    *GAINS,
    "onboard.airframe.motor_response_s=0.05",
    f"{SETTINGS}.prediction=false",
    f"{SETTINGS}.command_rate_filter_s=0.0",
)
COMPENSATED = (*GAINS, f"{SETTINGS}.position.gains.natural_frequency_rad_s=[4.0,4.0,4.0]")
"""Prediction, motor compensation and rate feed-forward are the defaults."""


def attitude(band: Band, assignments: tuple[str, ...]) -> tuple[float, float]:
    """Mean phase margin of roll and pitch of pid, measured and predicted, deg."""
    config = resolve("hover", Choices("pid", 3, 60.0, assignments))
    measured = [response.margins.phase_margin_deg for response in measure(config, 1, band)[:2]]
    predicted = margins(FINE, predicted_loop(config, 1, 0, FINE)).phase_margin_deg
    return float(np.mean(measured)), predicted


def test_compensation_of_the_delays_raises_the_measured_and_the_predicted_phase_margin() -> None:
    """The measured loop contains the position loop around it, which the prediction leaves out."""
    plain, predicted_plain = attitude(SHORT, PLAIN)
    assert plain == pytest.approx(predicted_plain, abs=8.0)
    better, predicted_better = attitude(LONG, COMPENSATED)
    assert better > plain + 10.0
    assert predicted_better > predicted_plain + 20.0


HEIGHT = Band(0.6, 2.0, 5, 0.1, 10.0, 2)
STIFF = ("vehicle.battery.resistance_ohm=0.0", "vehicle.battery.polarisation_ohm=0.0")


@pytest.mark.parametrize(("battery", "least", "most"), [((), 0.70, 0.85), (STIFF, 0.95, 1.05)])
def test_the_sag_of_the_battery_takes_gain_of_the_height_loop(
    battery: tuple[str, ...], least: float, most: float
) -> None:
    """Measured and predicted alike; the ratio is to the predicted loop of a battery without resistance."""
    down = measure(resolve("hover", Choices("pid", 3, 60.0, (*COMPENSATED, *battery))), 0, HEIGHT)[2]
    fast = down.omega > 4.0
    stiff = predicted_loop(resolve("hover", Choices("pid", 3, 60.0, (*COMPENSATED, *STIFF))), 0, 2, down.omega)
    predicted = predicted_loop(resolve("hover", Choices("pid", 3, 60.0, (*COMPENSATED, *battery))), 0, 2, down.omega)
    assert least < float(np.median(np.abs(down.L / stiff)[fast])) < most
    assert float(np.median(np.abs(down.L / predicted)[fast])) == pytest.approx(1.0, abs=0.05)


def test_a_delay_beyond_the_predicted_margin_loses_the_vehicle() -> None:
    config = resolve("hover", Choices("pid", 3, 20.0, PLAIN))
    margin_ms = margins(FINE, predicted_loop(config, 1, 0, FINE)).delay_margin_ms
    late_s = 1e-3 * margin_ms + 0.012
    late = resolve("hover", Choices("pid", 3, 20.0, (*PLAIN, f"vehicle.motors.command_delay_s={late_s}")))
    assert fly_lockstep(late, with_offboard=False).crash_reason
    assert not fly_lockstep(config, with_offboard=False).crash_reason


def test_a_flight_that_is_too_short_is_named() -> None:
    with pytest.raises(LoopMeasurementError, match="too short"):
        measure(resolve("hover", Choices("pid", 3, 10.0)), 1, SHORT)


@pytest.mark.full
@pytest.mark.parametrize("controller", ["none", "pid", "bias", "mrac", "dmrac", "l1", "indi", "repetitive", "ilc"])
def test_shipped_gains_have_their_margins_in_flight(controller: str) -> None:
    config = resolve("hover", Choices(controller, 3, flight_time_s()))
    for loop in measure_all(config):
        found = loop.measured.margins
        assert found.phase_margin_deg >= 35.0, loop.measured.loop
        assert not found.gain_margin_db < 6.0, loop.measured.loop  # NaN: it never crosses -180 degrees in the band
        assert found.delay_margin_ms >= 15.0, loop.measured.loop


@pytest.mark.full
def test_the_command_writes_table_json_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, picture = tmp_path / "m.json", tmp_path / "m.png"
    assert main(["margins", "pid", "--out", str(out), "--bode", str(picture)]) == 0
    entries = json.loads(out.read_text(encoding="utf-8"))
    assert [entry["loop"] for entry in entries] == ["roll", "pitch", "yaw", "north", "east", "down"]
    assert set(entries[0]) == {"controller", "loop", "gain_margin_db", "phase_margin_deg", "delay_margin_ms"}
    assert picture.stat().st_size > 10_000
    assert "phase margin" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nobody",), "unknown controller 'nobody'"),
        (("pid", "--vehicle", "boat"), "unknown vehicle 'boat'"),
        (("pid", "--set", "onboard.no_such_key=1"), "no_such_key: unknown key"),
    ],
)
def test_wrong_arguments_are_named(words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["margins", *words]) == 2
    assert message in capsys.readouterr().err
