"""The demonstration's lines and picture, from two short flights."""

from dataclasses import replace
from pathlib import Path

import pytest

from experiments.flights.demo import PAIR, WIND, DemoFlight, demo_configs, draw_demo, fly_demo, summary


@pytest.fixture(scope="module")
def flights() -> tuple[DemoFlight, ...]:
    configs = demo_configs(seed=3, duration_s=14.0, assignments=("offboard.experience.mode=frozen",))
    return tuple(fly_demo(config) for config in configs)


def test_both_fly_in_the_same_wind() -> None:
    pid, dmrac = demo_configs(None, 10.0, ())
    assert (pid.controller, dmrac.controller) == PAIR
    assert pid.vehicle.disturbances == dmrac.vehicle.disturbances
    assert pid.seed == dmrac.seed
    assert f"={pid.vehicle.disturbances[0].speed_m_s}" in WIND  # type: ignore[attr-defined]


def test_the_lines_are_those_of_the_flights(flights: tuple[DemoFlight, ...]) -> None:
    known = replace(flights[0], first_lap_rmse_m=0.1, settled_rmse_m=0.08), replace(flights[1], settled_rmse_m=0.02)
    lines = summary(known)
    assert lines[0] == "pid:    first lap 100.0 mm, settled  80.0 mm"
    assert lines[2].startswith("With dmrac 25% of pid's settled error is left")
    lost = summary((known[0], replace(known[1], crash_reason="floor contact")))
    assert "VEHICLE LOST" in lost[1]
    assert len(lost) == 2


def test_the_picture_is_drawn(flights: tuple[DemoFlight, ...], tmp_path: Path) -> None:
    draw_demo(flights, tmp_path / "demo.png")
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
