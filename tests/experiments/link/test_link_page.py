"""The tables of docs/link.md from made-up flights, and the blocks of the page."""

import json
import math
from pathlib import Path

import pytest

from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.flight_row import Row, empty_row
from experiments.link.link_page import MARKS, PAGE, draw, main, replace_between_marks
from experiments.link.link_tables import (
    CAMPAIGN,
    GROUPS,
    PERFECT_POINT,
    age_table,
    group_of,
    links_below,
    name_of,
    sweep_table,
    verdict,
)
from experiments.results.campaign_data import Group


def flight(link: str, controller: str, seed: int, survived: bool = True, **values: float) -> Row:
    defaults = {"position_rmse_m": 0.03, "before_onset_rmse_m": 0.02, "after_onset_rmse_m": 0.05}
    shares = {"up_lost_share": 0.1, "down_lost_share": 0.2, "up_bytes_s": 8000.0, "down_bytes_s": 12_000.0}
    about = {"controller": controller, "seed": seed, "survived": survived, "point": json.dumps({"link": link})}
    return empty_row() | about | defaults | shares | {"feature_age_median_s": 0.9, "pose_age_median_s": 0.01} | values


def group(link: str, alive: int, dead: int = 0, **values: float) -> Group:
    return group_of(
        link, "dmrac", [flight(link, "dmrac", seed, seed < alive, **values) for seed in range(alive + dead)]
    )


FLIGHTS = {
    ("loss_0", "dmrac"): group("loss_0", 20),
    ("loss_50", "dmrac"): group("loss_50", 19, 1, position_rmse_m=0.06, feature_age_median_s=3.0),
    ("loss_100", "dmrac"): group("loss_100", 8, 12, feature_age_median_s=math.nan),
    ("silent_3_before", "dmrac"): group("silent_3_before", 20),
}


def test_a_link_is_below_only_if_the_paired_test_is_significant() -> None:
    assert links_below(FLIGHTS) == {("loss_100", "dmrac")}
    text = verdict(FLIGHTS)
    assert text.startswith("80 flights, 20 seeds, 13 vehicles lost. Survival is significantly below")
    assert text.endswith(": dmrac at loss_100.")
    assert "nowhere significantly below" in verdict({key: FLIGHTS[key] for key in FLIGHTS if key[0] != "loss_100"})


def test_the_table_of_a_sweep() -> None:
    lines = sweep_table(FLIGHTS, "loss", ["dmrac"]).splitlines()
    assert len(lines) == 2 + 3
    assert lines[2].startswith("| perfect | 10% / 20% | 20/20 (84% to 100%) | 3.0 cm | 2.0 cm | 5.0 cm | 0.90 s |")
    assert lines[3].startswith("| 50 % | 10% / 20% | 19/20 (76% to 99%) | 6.0 cm |")
    assert "**8/20 (22% to 61%) below**" in lines[4]
    assert lines[4].endswith("| - | 0.01 s | 8.0 kB/s | 12.0 kB/s |")
    assert len(sweep_table(FLIGHTS, "silent", ["dmrac"]).splitlines()) == 2 + 2, "the perfect link stands first"


def test_the_table_by_age() -> None:
    lines = age_table(FLIGHTS, "dmrac").splitlines()
    assert lines[2].startswith("| 0 to 1 s | 40 | 3.0 cm |")
    assert lines[4].startswith("| 2 to 4 s | 19 | 6.0 cm |")
    assert lines[-1].startswith("| none ever arrived | 8 |")


@pytest.mark.parametrize(
    ("link", "name"),
    [
        ("loss_0", "perfect"),
        ("loss_30", "30 %"),
        ("burst_50", "50 on average"),
        ("silent_0.3_after", "0.3 s, from right after the chip"),
        ("silent_end_before", "to the end, from before the chip"),
    ],
)
def test_links_in_words(link: str, name: str) -> None:
    assert name_of(link) == name


def test_the_campaign_has_what_the_page_shows() -> None:
    campaign, _ = load_campaign(CAMPAIGN)
    points = campaign.sweeps[0].points
    assert PERFECT_POINT in points
    assert all(any(link.startswith(kind) for kind, _ in GROUPS) for link in points)
    losses = [link for link in points if link.startswith("loss")]
    assert (losses[0], losses[-1]) == ("loss_0", "loss_100")


def test_the_page_has_a_block_for_each_table() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in ("verdict", *(kind for kind, _ in GROUPS), "age", "traces"):
        for mark in MARKS:
            assert text.count(mark.format(name)) == 1
        assert replace_between_marks(text, name, "new").count("\n\nnew\n\n") == 1
    with pytest.raises(ValueError, match="no block 'other'"):
        replace_between_marks(text, "other", "")


def test_a_folder_without_flights_leaves_the_page_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "link.md"
    page.write_text(PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["--no-flights", "--out", str(tmp_path / "none"), "--page", str(page)])
    assert ended.value.code == 2
    assert "holds no flight at loss_0 yet" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_the_figure(tmp_path: Path) -> None:
    draw(FLIGHTS, "dmrac", tmp_path / "pictures" / "figure.png")
    assert (tmp_path / "pictures" / "figure.png").stat().st_size > 10_000
