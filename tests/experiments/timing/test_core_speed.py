"""`dmrac bench core`: what is measured and reported, not how long it takes."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from async_dmrac.command_line import main
from experiments.timing import core_speed, rotorpy_loop
from experiments.timing.both_cores import INSIDE
from experiments.timing.core_speed import Figure
from onboard.c.library import BuildError, compiler

try:
    compiler()
except BuildError as error:
    pytest.skip(str(error), allow_module_level=True)


def by_name(figures: list[Figure]) -> dict[str, Figure]:
    return {figure.name: figure for figure in figures}


def test_a_target_is_met_or_missed_from_its_side() -> None:
    assert Figure("tick", 29.0, "us", 30.0).met is True
    assert Figure("tick", 31.0, "us", 30.0).met is False
    assert Figure("speed", 41.0, "x", 40.0, at_most=False).met is True
    assert Figure("speed", 39.0, "x", 40.0, at_most=False).met is False
    assert Figure("speed", None, "x", 40.0, note="absent").met is None
    assert Figure("speed", 5.0, "x").met is None
    assert Figure("speed", 39.0, "x", 40.0, at_most=False).text() == "speed: 39 x (target at least 40: MISSED)"
    assert Figure("speed", None, "x", note="absent").text() == "speed: not measured (absent)"


def test_the_part_in_c_is_compared_with_the_same_part_of_numpys(monkeypatch: pytest.MonkeyPatch) -> None:
    quantiles = {"numpy": (600.0, 0.0, 0.0), "c": (60.0, 0.0, 0.0), INSIDE: (20.0, 0.0, 0.0)}
    monkeypatch.setattr(core_speed, "measure_cores", lambda *arguments: quantiles)
    monkeypatch.setattr(core_speed, "numpy_without_mavlink_us", lambda seconds: 400.0)
    values = [figure.value for figure in core_speed.tick_figures()]
    assert values == [60.0, 20.0, 400.0, 0.05, 0.1]


def test_numpys_tick_without_mavlink_is_shorter_than_the_whole_tick() -> None:
    spent = core_speed.measure_cores(core_speed.LEARNER, 0.5, 1)
    assert 0.0 < core_speed.numpy_without_mavlink_us(0.5) < 10.0 * spent["numpy"][0]


def test_lockstep_and_the_absent_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds = {("l1", "c"): iter([30.0, 44.0, 31.0]), ("l1", "numpy"): iter([5.0, 5.5, 4.0])}
    speeds |= {("dmrac", "c"): iter([7.5, 6.0, 7.0])}
    monkeypatch.setattr(
        core_speed, "lockstep_speed", lambda config, core, train=None: (next(speeds[config.controller, core]), 50.0)
    )
    monkeypatch.setattr(rotorpy_loop, "is_installed", lambda: False)
    figures = core_speed.lockstep_figures(5.0)
    assert [(one.value, one.met) for one in figures] == [(44.0, True), (5.5, None), (None, None), (7.5, True)]
    assert figures[0].note.startswith("50 by processor time")
    assert figures[2].note == "RotorPy is not installed: extra `rotorpy`"


def test_against_the_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core_speed, "lockstep_speed", lambda config, core, train=None: (40.0, 50.0))
    monkeypatch.setattr(rotorpy_loop, "is_installed", lambda: True)
    monkeypatch.setattr(rotorpy_loop, "rotorpy_speed", lambda seconds: 1.6)
    figures = by_name(core_speed.lockstep_figures(5.0))
    assert figures["lockstep without trainer / RotorPy's own loop"].value == 25.0


def test_rotorpys_own_loop_flies_in_rotorpy() -> None:
    pytest.importorskip("rotorpy", reason="the rotorpy extra is not installed")
    assert rotorpy_loop.rotorpy_speed(1.0) > 0.0


def test_vehicles_take_turns_in_one_process() -> None:
    figures = core_speed.vehicle_figures([1, 3], ticks=5)
    one, three, ratio = (figure.value for figure in figures)
    assert one is not None
    assert three is not None
    assert ratio == pytest.approx(three / one)


def test_a_campaign_of_the_c_core_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core_speed, "CAMPAIGN_FLIGHT_S", 5.0)
    figure = core_speed.campaign_figure(jobs=1, flights_per_job=4)
    assert figure.value is not None
    assert figure.value > 0.0
    assert figure.name.endswith("on 1 cores")


def test_the_command_prints_and_writes_every_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[int] = []

    def vehicles(counts: list[int]) -> list[Figure]:
        asked.extend(counts)
        return [Figure("vehicles", 1.1, "", 1.25)]

    for name in ("tick_figures", "lockstep_figures"):
        monkeypatch.setattr(core_speed, name, lambda *arguments: [Figure("figure", 31.0, "us", 30.0)])
    monkeypatch.setattr(core_speed, "campaign_figure", lambda: Figure("campaign", None, "", note="absent"))
    monkeypatch.setattr(core_speed, "vehicle_figures", vehicles)
    assert main(["bench", "core", "--vehicles", "16", "--out", str(tmp_path / "core.json")]) == 0
    report = json.loads((tmp_path / "core.json").read_text(encoding="utf-8"))
    assert asked == [1, 4, 16]
    assert [one["met"] for one in report["figures"]] == [False, False, None, True]
    assert report["machine"]
    printed = capsys.readouterr().out
    assert "figure: 31 us (target at most 30: MISSED)" in printed
    assert "campaign: not measured (absent)" in printed


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bench", "--vehicles", "4"], "--vehicles 4: only with dmrac bench core"),
        (["bench", "core", "--controller", "pid"], "--controller, --set: not allowed with dmrac bench core"),
    ],
)
def test_options_that_do_not_fit(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert expected in capsys.readouterr().err


def test_a_failed_flight_gives_no_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core_speed, "run_campaign", lambda *arguments: SimpleNamespace(errors=2))
    figure = core_speed.campaign_figure(jobs=1, flights_per_job=4)
    assert figure.value is None
    assert figure.note == "2 flights failed"
