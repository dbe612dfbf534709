"""Scales of the figures: a small error has an axis of its own, and one outlier does not squeeze all other values."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from experiments.results import trace_figures
from experiments.results.campaign_data import Trace
from experiments.results.figure_style import cut_outliers, new_figure

ERROR_M = 0.006


def trace(error_m: float) -> Trace:
    """A circle of 1 m radius, flown with the same error on every axis."""
    time_s = 0.005 * np.arange(2000)
    columns = {"time_s": time_s, "tick_mode": np.full(2000, 4.0), "onsets_s": np.zeros(0)}
    for axis, target in zip("ned", (np.cos(time_s), np.sin(time_s), np.full(2000, -1.0)), strict=True):
        columns |= {f"tick_target_{axis}": target, f"truth_position_{axis}": target + error_m}
    return Trace({"survived": True, "seed": 1}, columns)


def test_the_error_has_a_panel_on_its_own_scale() -> None:
    """Millimetres do not show on the axes of the position, which span metres."""
    group = SimpleNamespace(controller="pid", case="calm")
    data: Any = SimpleNamespace(
        controllers=["pid"],
        select=lambda *_: [group],
        traces=lambda _: [trace(ERROR_M), trace(0.5 * ERROR_M)],
        one_path=lambda _: True,
    )
    *positions, error = trace_figures.position(data, "calm").axes
    assert [panel.get_ylabel() for panel in positions] == ["north [m]", "east [m]", "height [m]"]
    assert "[mm]" in error.get_ylabel()
    assert error.get_ylim() == pytest.approx((0.0, 1.25 * 1e3 * ERROR_M * np.sqrt(3.0)))


def test_an_outlier_does_not_squeeze_the_others() -> None:
    panel = new_figure(3.0).add_subplot()
    assert cut_outliers(panel, [(0.0, 0.012), (1.0, 0.02), (2.0, 0.8), (3.0, 0.011)])
    assert panel.get_ylim() == pytest.approx((0.0, 0.026))
    assert [text.get_text() for text in panel.texts] == ["0.8"]


def test_two_levels_are_no_outlier() -> None:
    panel = new_figure(3.0).add_subplot()
    assert not cut_outliers(panel, [(0.0, 0.012), (1.0, 0.02), (2.0, 0.05)])
    assert not cut_outliers(panel, [(0.0, 0.01), (1.0, 0.8), (2.0, 0.9)])
    assert not panel.texts
