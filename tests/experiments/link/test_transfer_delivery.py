from pathlib import Path

import numpy as np
import pytest

from experiments.link.transfer_delivery import LOSSES, draw, ideal_transfer, table, transfer


def test_a_transfer_takes_less_than_two_seconds_at_50_percent_loss() -> None:
    """At 50 % loss each way a pair of 6-32-32-20 networks is on board within 2 s at the default pace."""
    assert max(transfer(0.5, "float16", seed).seconds for seed in range(25)) < 2.0
    assert transfer(0.0, "float16", 0).seconds == pytest.approx(0.11, abs=0.02)
    assert 8 <= transfer(0.0, "float16", 0).chunks <= 12


def test_the_ideal_code_is_a_bound() -> None:
    repair = np.median([transfer(0.7, "float32", seed).seconds for seed in range(25)])
    ideal = np.median([ideal_transfer(0.7, 15, seed).seconds for seed in range(25)])
    assert ideal < repair


def test_table_and_figure(tmp_path: Path) -> None:
    results = {"float16, repair": np.ones((len(LOSSES), 3, 2)), "float16, ideal code": np.full((len(LOSSES), 3, 2), 2)}
    assert "| 50% | 1.00 / 1.00 s, 1.0 | 2.00 / 2.00 s, 2.0 |" in table(results)
    draw(results, tmp_path / "delivery.png")
    assert (tmp_path / "delivery.png").stat().st_size > 1000
