import base64
import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from flight_log.compare import draw, labels, path_seconds, smoothed, summary_table, true_position, write_comparison
from flight_log.reader import FlightError, open_flight
from flight_log.report import repeat_command, text_of, write_report


class Structure(HTMLParser):
    """Checks that tags close in order, and collects everything that would be fetched."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        self.sources += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def structure(text: str) -> Structure:
    parser = Structure()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    return parser


def test_the_page_contains_everything_and_fetches_nothing(full_flight: Path) -> None:
    path = write_report(full_flight)
    assert path == full_flight / "report.html"
    text = path.read_text(encoding="utf-8")
    sources = structure(text).sources
    assert len(sources) == 1
    assert base64.b64decode(sources[0].removeprefix("data:image/png;base64,")).endswith(b"of a flight")
    assert "http" not in text
    for part in (
        "figure8_wind, dmrac, seed 7",
        "vehicle alive after 20 s, lockstep",
        '<td>position_rmse_m</td><td class="number">0.12346</td>',
        "<td>lap_rmse_m</td><td>0.2, 0.1</td>",
        '<td>link.up.lost</td><td class="number">5</td>',
        "mode FLYING &lt;fast&gt;",
        "40 of 60 rounds",
        "scripts/fly figure8_wind --controller dmrac --seed 7 --duration 20 --lockstep",
        "onboard: config.yaml, sim_vehicle: config.yaml",
        "complete, without gaps",
    ):
        assert part in text


def test_the_page_reports_a_crash_a_truncated_log_and_a_missing_summary(full_flight: Path) -> None:
    summary = json.loads((full_flight / "summary.json").read_text(encoding="utf-8"))
    summary |= {"survived": False, "crash_reason": "hit the floor"}
    (full_flight / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    log = full_flight / "onboard.mcap"
    log.write_bytes(log.read_bytes()[:-100])
    text = write_report(full_flight).read_text(encoding="utf-8")
    assert "vehicle lost: hit the floor" in text
    assert "onboard.mcap: not closed" in text
    summary |= {"outcome": "invalid", "invalid_reason": "the simulator stood still"}
    (full_flight / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    assert "invalid flight: the simulator stood still" in write_report(full_flight).read_text(encoding="utf-8")
    (full_flight / "summary.json").unlink()
    assert "no flight summary" in write_report(full_flight).read_text(encoding="utf-8")


def test_a_path_that_is_not_a_flight_folder_raises_with_its_name(full_flight: Path, tmp_path: Path) -> None:
    with pytest.raises(FlightError, match="no such flight"):
        write_report(tmp_path / "nothing")
    with pytest.raises(FlightError, match="not a flight folder"):
        write_report(full_flight / "onboard.mcap")


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (True, "yes"), (False, "no"), (0.1234567, "0.12346"), (12, "12"), ("a", "a")]
)
def test_values_of_the_summary_as_text(value: object, text: str) -> None:
    assert text_of(value) == text


def test_the_repeat_command_is_that_of_the_summary_if_it_has_one(make_flight: Callable[..., Path]) -> None:
    folder = make_flight("own", command="scripts/fly x --set a=1")
    assert repeat_command(open_flight(folder)) == "scripts/fly x --set a=1"


def test_a_comparison_has_table_figure_and_commands(
    full_flight: Path, make_flight: Callable[..., Path], tmp_path: Path
) -> None:
    other = make_flight("other", error_m=0.3, controller="pid", position_rmse_m=0.3, features={})
    flights = [open_flight(full_flight), open_flight(other)]
    assert labels(flights) == ["figure8_wind, dmrac, seed 7", "figure8_wind, pid, seed 7"]
    rows = {row[0]: row[1:] for row in summary_table(flights)}
    assert rows["position_rmse_m"] == ["0.12346", "0.3"]
    assert rows["features.version"] == ["3", "-"]
    write_comparison(flights, tmp_path / "comparison.html")
    text = (tmp_path / "comparison.html").read_text(encoding="utf-8")
    [source] = structure(text).sources
    png = base64.b64decode(source.removeprefix("data:image/png;base64,"))
    assert png.startswith(b"\x89PNG")
    assert len(png) > 20_000
    assert len(re.findall("scripts/fly", text)) == 2


def test_the_curves_of_a_comparison_have_the_right_values(full_flight: Path) -> None:
    flight = open_flight(full_flight)
    tick = flight["onboard/tick"]
    time_s = path_seconds(tick)
    assert time_s[0] == pytest.approx(-2.02)
    position = true_position(flight, tick)
    error = np.linalg.norm(position - tick.vector("target_n", "target_e", "target_d"), axis=1)
    np.testing.assert_allclose(smoothed(error, time_s), 0.1, rtol=1e-6)


def test_flights_that_cannot_be_compared_raise(full_flight: Path, tmp_path: Path) -> None:
    flight = open_flight(full_flight)
    with pytest.raises(FlightError, match="two flights or more"):
        write_comparison([flight], tmp_path / "x.html")
    shutil.copytree(full_flight, tmp_path / "silent")
    (tmp_path / "silent" / "onboard.mcap").unlink()
    silent = open_flight(tmp_path / "silent")
    with pytest.raises(FlightError, match="nothing to draw"):
        draw([silent, silent], ["a", "b"])
    assert draw([flight, silent], ["a", "b"])
    assert labels([flight, flight]) == ["figure8_wind, dmrac, seed 7 (1)", "figure8_wind, dmrac, seed 7 (2)"]
