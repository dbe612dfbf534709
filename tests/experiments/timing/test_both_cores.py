"""Timing both cores: what is measured, not how long it takes."""

import pytest

from experiments.timing.both_cores import INSIDE, main, measure_cores
from onboard.c.compile import BuildError, compiler
from onboard.cores import CORES

try:
    compiler()
except BuildError as error:
    pytest.skip(str(error), allow_module_level=True)


def test_ticks_of_both_cores_and_the_calls_of_c_in_them() -> None:
    spent = measure_cores("pid", seconds=0.5, rounds=1)
    assert list(spent) == [*CORES, INSIDE]
    assert all(0.0 < p50 <= p99 <= most for p50, p99, most in spent.values())


def test_the_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    quantiles = {"numpy": (300.0, 400.0, 500.0), "c": (60.0, 70.0, 80.0), INSIDE: (5.0, 6.0, 7.0)}
    monkeypatch.setattr("experiments.timing.both_cores.measure_cores", lambda controller: quantiles)
    main(["pid"])
    assert capsys.readouterr().out.splitlines()[-1] == "| pid | 300 us | 60 us | 5 us |"
