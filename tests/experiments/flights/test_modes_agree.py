"""Real time over UDP and lockstep give the same flight within a stated tolerance: one step, two drivers."""

from pathlib import Path

import pytest

from experiments.flights.logged_flight import fly_logged
from experiments.flights.scenario import resolve

pytestmark = [pytest.mark.realtime, pytest.mark.full]

RELATIVE, ABSOLUTE_M = 0.15, 0.003
"""Tolerance of the position RMSE: 15 % and 3 mm.

What differs: the phase between the two clocks, how long a training round takes, and which datagram meets which
delivery.
"""


@pytest.mark.parametrize("scenario", ["figure8_wind", "rotor_chip", "blackout"])
def test_the_two_modes_agree(scenario: str, tmp_path: Path) -> None:
    config = resolve(scenario)
    summaries = {}
    for mode in ("realtime", "lockstep"):
        folder = tmp_path / mode
        folder.mkdir()
        summaries[mode] = fly_logged(config, folder, lockstep=mode == "lockstep")
    for mode, summary in summaries.items():
        assert summary["survived"], f"{mode}: {summary['crash_reason']}"
        assert summary["features"]["swaps"] >= 3, mode
    real, virtual = (summaries[mode]["position_rmse_m"] for mode in ("realtime", "lockstep"))
    assert real == pytest.approx(virtual, rel=RELATIVE, abs=ABSOLUTE_M)
    onboard = summaries["realtime"]["onboard"]
    assert onboard["missed"] <= 0.01 * onboard["ticks"]
