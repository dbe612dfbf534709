"""Tables, figures and pages from made-up flights whose outcome is known."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from configs.loader import ConfigError
from experiments.campaigns.draws import Draw
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.worker import TRACE_COLUMNS, TRUTH_COLUMNS
from experiments.results import trace_figures
from experiments.results.campaign_data import CampaignData, Trace, load_data
from experiments.results.campaign_page import CampaignReport, write_report
from experiments.results.comparisons import WORSE, comparisons, judged, losses, summary
from experiments.results.feature_probe import probe_accuracy, regimes_of, signals_of, silhouette
from experiments.results.figure_plan import KINDS, draw_all
from experiments.results.heat_map import draw_heat_map, heat_map_rows, losses_first
from experiments.results.reproduction import Reproduction, publish_rows, write_results
from experiments.results.sweep_figures import sweep_metric
from experiments.results.tables import tables, target_ratio
from protocol.signals import SIGNAL_INDEX
from tests.experiments.results.made_up import made_up_trace


def test_the_losses_are_complete(folder: Path) -> None:
    data = load_data(folder)
    compared = judged(list(comparisons(data)))
    table = losses(compared)
    assert table is not None
    quantity = "survival, dmrac 0 % [0, 24]"
    assert table.rows == (
        ("a chip, factor 0.6", quantity, "–", "pid 8 % [1, 35]; mrac 8 % [1, 35]"),
        ("a chip, factor 0.7", quantity, "pid 75 % [47, 91]; mrac 75 % [47, 91]", "–"),
    )
    # At 0.6 and 0.7 no dmrac flight survives to be compared: three survivals and two errors, with two rivals each.
    counts = "10 comparisons: DMRAC is better in 4, **worse in 2**, and does not differ significantly in 4."
    assert summary(data, compared).endswith(counts)


def test_every_error_in_the_table_is_compared(folder: Path) -> None:
    data = load_data(folder)
    slow = [row | {"recovery_s": 2.0 if row["controller"] == "dmrac" else 1.0} for row in data.rows]
    config = data.config.model_copy(update={"metrics": ("settled_rmse_m", "recovery_s", "feature_age_median_s")})
    table = losses(judged(list(comparisons(replace(data, config=config, rows=tuple(slow))))))
    assert table is not None
    assert table.rows[-1][:2] == ("a chip, factor 0.9", "recovery time [s]")
    assert table.rows[-1][2].startswith("pid 2.00 [2.00, 2.00]; mrac 2.00")
    assert not any("age" in row[1] for row in table.rows)


def test_verdicts_depend_on_the_number_of_comparisons(folder: Path) -> None:
    compared = list(comparisons(load_data(folder)))
    assert [one.verdict for one in judged(compared)].count(WORSE) == 2
    assert [one.verdict for one in judged(compared * 30)].count(WORSE) == 0


def test_cases_under_the_same_conditions_are_compared(folder: Path) -> None:
    """Flights of another controller in its own case are compared too, if the campaign lists the cases together."""
    data = load_data(folder)
    cases = (data.config.cases[0], data.config.cases[0].model_copy(update={"name": "others", "label": ""}))
    rows = tuple(row | {"case": "others"} if row["controller"] == "mrac" else row for row in data.rows)
    for together, rivals in (((), {"pid"}), ((("chip", "others"),), {"pid", "mrac"})):
        config = data.config.model_copy(update={"cases": cases, "same_conditions": together})
        assert {one.rival for one in comparisons(replace(data, config=config, rows=rows))} == rivals


def flown_once_beside(data: CampaignData, together: tuple[tuple[str, ...], ...]) -> CampaignData:
    """DMRAC at every point, and mrac in its own case that is not swept."""
    cases = (data.config.cases[0], data.config.cases[0].model_copy(update={"name": "others", "label": ""}))
    once = [row for row in data.rows if row["controller"] == "mrac" and json.loads(row["point"])["factor"] == 0.9]
    ours = [row for row in data.rows if row["controller"] == "dmrac"]
    rows = (*ours, *(row | {"case": "others", "point": "{}"} for row in once))
    return replace(data, config=data.config.model_copy(update={"cases": cases, "same_conditions": together}), rows=rows)


def test_a_case_that_is_not_swept_is_compared_at_every_point(folder: Path) -> None:
    compared = list(comparisons(flown_once_beside(load_data(folder), (("chip", "others"),))))
    assert {one.condition.rpartition(" ")[2] for one in compared} == {"0.6", "0.7", "0.9"}
    assert {one.rival for one in compared} == {"mrac"}


@pytest.mark.parametrize(("together", "drawn"), [((("chip", "others"),), ["mrac"]), ((), [])])
def test_a_case_flown_once_is_a_line_across_the_sweep(
    folder: Path, together: tuple[tuple[str, ...], ...], drawn: list[str]
) -> None:
    figure = sweep_metric(flown_once_beside(load_data(folder), together), "factor", "settled_rmse_m")
    (panel,) = figure.axes
    across = [line for line in panel.lines if line.get_linestyle() == "--" and len(set(line.get_ydata())) == 1]
    assert [line.get_label() for line in across if len(line.get_ydata()) == 2] == drawn


def test_few_pairs_are_counted(folder: Path) -> None:
    data = load_data(folder)
    rows = tuple(row | {"survived": row["seed"] < 1002} if row["controller"] == "pid" else row for row in data.rows)
    few = replace(data, rows=rows)
    table = {(row[0], row[1].strip("*")): row for row in tables(few)[0].rows}
    assert table["0.9", "dmrac"][6] == "0.20 (2 pairs)"


def test_survivors_and_crashes_are_separate(folder: Path) -> None:
    data = load_data(folder)
    rows = {(row[0], row[1].strip("*")): row for row in tables(data)[0].rows}
    assert rows["0.7", "dmrac"][3].startswith("0 %")
    assert rows["0.7", "dmrac"][5] == "–"
    assert rows["0.9", "dmrac"][3] == "100 % [76, 100]"
    assert float(rows["0.9", "dmrac"][5].split()[0]) == pytest.approx(0.02, rel=0.5)
    assert rows["0.9", "dmrac"][6] == "0.20 [0.20, 0.20]"


def test_targets_and_failures_are_in_the_tables(folder: Path) -> None:
    data = load_data(folder)
    found = {table.caption: table for table in tables(data)}
    target = found["Targets: medians of ratios paired by seed"]
    assert target.rows == (("dmrac / mrac", "0.40 [0.40, 0.40]", "12", "≤ 0.75", "yes"),)
    failures = next(table for caption, table in found.items() if caption.startswith("1 flights failed"))
    assert failures.rows[0][2] == "dmrac fly x"
    half = next(table for caption, table in found.items() if caption.startswith("Where half"))
    assert 0.7 < float(half.rows[2][3].split()[0]) < 0.9


def test_a_target_against_several_controllers_counts_the_one_with_the_least_median(folder: Path) -> None:
    data = load_data(folder)
    target = data.config.targets[0]
    best = target.model_copy(update={"theirs": target.theirs.model_copy(update={"controller": ("pid", "mrac")})})
    found = target_ratio(data, best)
    assert found == target_ratio(data, target)
    assert found is not None
    assert found[1] == "mrac"
    weaker = target.model_copy(update={"theirs": target.theirs.model_copy(update={"controller": ("pid", "indi")})})
    assert target_ratio(data, weaker) is None, "indi was not flown"
    config = data.config.model_copy(update={"targets": (best,)})
    found_table = {table.caption: table for table in tables(replace(data, config=config))}
    assert found_table["Targets: medians of ratios paired by seed"].rows[0][0] == "dmrac / mrac (mrac)"


def test_the_coverage_of_the_live_bound_is_in_a_table_for_controllers_and_campaign(folder: Path) -> None:
    data = load_data(folder)
    rows = tuple(
        row | {"position_bound_coverage": 0.5} if row["key"] == data.rows[0]["key"] else row for row in data.rows
    )
    table = next(one for one in tables(replace(data, rows=rows)) if one.caption.startswith("Live bound"))
    assert table.header[2:6] == ("position: bound [mm]", "error [mm]", "covered", "least flight")
    assert [row[0] for row in table.rows] == [*data.controllers, "all"]
    everything = table.rows[-1]
    assert everything[1] == str(len(data.rows)), "lost vehicles too"
    assert float(everything[2]) == pytest.approx(3.0 * float(everything[3]), rel=0.05)
    shares = [row["position_bound_coverage"] for row in rows]
    assert everything[4:6] == (f"{100.0 * np.mean(shares):.2f} %", "50.0 %")
    assert everything[8:10] == ("100.00 %", "100.0 %")


def test_rows_from_before_the_bound_on_the_tracking_error_have_neither_table_nor_figure(
    folder: Path, tmp_path: Path
) -> None:
    data = load_data(folder)
    old = replace(data, rows=tuple(row | {"position_bound_coverage": math.nan} for row in data.rows))
    assert not any(one.caption.startswith("Live bound") for one in tables(old))
    said: list[str] = []
    pictures, _ = draw_all(old, tmp_path, said.append)
    assert {picture.name.split("_", 3)[3] for picture in pictures} == set(KINDS) - {"bounds"}
    assert any("bounds: left out" in line for line in said)


def test_every_kind_of_figure_is_drawn(folder: Path, tmp_path: Path) -> None:
    data = load_data(folder)
    left_out: list[str] = []
    pictures, _ = draw_all(data, tmp_path, lambda text: left_out.append(text) if "left out" in text else None)
    assert {picture.name.split("_", 3)[3] for picture in pictures} == set(KINDS)
    assert not left_out
    for picture in pictures:
        assert picture.png.stat().st_size > 5_000
        assert "<dc:date>" not in picture.png.with_suffix(".svg").read_text()
        assert "{" not in picture.caption
    assert write_report(folder, tmp_path, lambda text: None).pictures == tuple(pictures)
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(pictures)
    assert (
        page.index("DMRAC is better in") < page.index("Where DMRAC is worse") < page.index("medians of the survivors")
    )
    assert 'src="http' not in page
    assert "thrust_factor" in page  # the configuration


def test_unknown_figures_and_options_are_named(folder: Path, tmp_path: Path) -> None:
    data = load_data(folder)
    for entry, words in (({"kind": "pie"}, "allowed are survival"), ({"kind": "laps", "colour": 1}, "figures.0")):
        config = data.config.model_copy(update={"figures": (entry,)})
        wrong = type(data)(data.folder, data.name, config, data.rows)
        with pytest.raises(ConfigError, match=words):
            draw_all(wrong, tmp_path, lambda text: None)


def test_the_results_page_has_its_order(folder: Path, tmp_path: Path) -> None:
    plan = Reproduction(folder.parent, tmp_path / "results.md", quick=True)
    write_results(plan, [CampaignReport(load_data(folder))])
    text = plan.page.read_text()
    data = load_data(folder)
    rows = f"[data/{data.name}.parquet](data/{data.name}.parquet)"
    order = ("heat_map.png", "**Targets**", "`dmrac reproduce --quick`", "| Made up | 10 | 4 | 2 | 4 |", "Holm")
    order += ("## Made up", "**Where DMRAC is worse", "<details>", "medians of the survivors", rows, "numpy")
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert (tmp_path / "pictures" / "results" / "heat_map.png").stat().st_size > 10_000


def test_the_heat_map_compares_with_the_best_other(folder: Path) -> None:
    """At 0.9 all survive and the errors are 0.10, 0.05 and 0.02 times the same spread."""
    rows = heat_map_rows(load_data(folder))
    assert [row.condition for row in rows] == [f"a chip, factor {factor}" for factor in (0.6, 0.7, 0.9)]
    assert rows[-1].ratios == pytest.approx({"pid": 5.0, "mrac": 2.5, "dmrac": 0.4})
    assert math.isnan(rows[0].ratios["dmrac"])
    assert rows[0].survival["dmrac"] == 0.0
    (panel, _) = draw_heat_map(rows).axes
    assert {"5.00", "2.50", "0.40", "–"} <= {text.get_text() for text in panel.texts}


def test_losses_come_first_the_worst_at_the_head(folder: Path) -> None:
    rows = heat_map_rows(load_data(folder))
    assert "In no condition" in losses_first([replace(row, ratios={**row.ratios, "dmrac": 0.5}) for row in rows])
    worse = [
        replace(row, condition=f"c{n}", ratios={**row.ratios, "dmrac": 1.0 + n}) for n, row in enumerate(rows * 3, 1)
    ]
    text = losses_first([replace(worse[0], ratios={**worse[0].ratios, "dmrac": 0.9}), *worse])
    assert text.startswith(
        f"DMRAC has a larger median error than the best other controller in {len(worse)} of {len(worse) + 1}"
    )
    named = [line for line in text.splitlines() if line.startswith("- ")]
    assert len(named) == min(3, len(worse))
    assert f"c{len(worse)}: " in named[0]
    assert f"{1.0 + len(worse):.2f} times that of mrac" in named[0]


def test_the_rows_are_stored_beside_the_page(folder: Path, tmp_path: Path) -> None:
    plan = Reproduction(folder.parent, tmp_path / "results.md", quick=True, only=("retention",))
    assert plan.command == "dmrac reproduce --quick --only retention"
    file = publish_rows(plan, folder.name)
    assert file.parent == tmp_path / "data"
    data = load_data(folder)
    assert pq.read_table(file).num_rows == len(data.rows) + len(data.failed)


def test_a_folder_without_flights_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="not a campaign's folder"):
        load_data(tmp_path)


def test_signals_are_those_of_the_sample() -> None:
    import io

    with np.load(io.BytesIO(made_up_trace())) as archive:
        trace = Trace(empty_row(), {name: archive[name] for name in archive.files})
    signals = signals_of(trace)
    roll = 2.0 * 0.1 * np.sin(trace.time_s)
    np.testing.assert_allclose(signals[:, SIGNAL_INDEX["roll"]], roll, atol=1e-12)
    np.testing.assert_allclose(signals[:, SIGNAL_INDEX["pitch"]], 0.0, atol=1e-12)
    v = np.sin(trace.time_s)
    body_y = np.cos(roll) * v + np.sin(roll) * v
    np.testing.assert_allclose(signals[:, SIGNAL_INDEX["body_velocity_y"]], body_y, atol=1e-12)


def test_the_probe_distinguishes_regimes_only_if_the_features_do() -> None:
    import io

    with np.load(io.BytesIO(made_up_trace())) as archive:
        trace = Trace(empty_row(), {name: archive[name] for name in archive.files})
    samples = regimes_of(trace, {"one": (0.0, 10.0), "two": (10.0, 20.0)}, round_s=2.5)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(samples.regime.size, 4))
    apart = noise + 8.0 * samples.regime[:, None]
    assert probe_accuracy(apart, samples) > 0.99
    assert silhouette(apart, samples) > 0.7
    assert abs(probe_accuracy(noise, samples) - 0.5) < 0.15
    assert abs(silhouette(noise, samples)) < 0.05
    assert not math.isnan(samples.signals.sum())


def test_features_that_depend_only_on_the_place_are_at_chance_and_not_below() -> None:
    """Each fold covers all places: otherwise the probe would guess the regime with more samples left there."""
    time = np.arange(0.0, 60.0, 0.05)
    trace = Trace(empty_row(), {"time_s": time, **{f"tick_{name}": np.zeros(time.size) for name in TRACE_COLUMNS},
                                **{f"truth_{name}": np.ones(time.size) for name in TRUTH_COLUMNS}})  # fmt: skip
    samples = regimes_of(trace, {"a": (0.0, 19.0), "b": (20.0, 39.5), "c": (40.0, 58.0)})
    place = 2.0 * np.pi * np.arange(samples.regime.size) / np.sum((samples.regime == 0) & (samples.round == 0))
    values = np.column_stack([np.sin(k * place + shift) for k in range(1, 9) for shift in (0.0, 1.57)])
    assert np.bincount(samples.regime * 3 + samples.round.astype(int)).tolist() == 9 * [120]
    assert abs(probe_accuracy(values, samples) - 1.0 / 3.0) < 0.1


@pytest.mark.parametrize("kind", ["position", "attitude"])
def test_the_axis_of_a_row_fits_its_widest_panel(folder: Path, kind: str) -> None:
    """The panels of a row share their axis: it must fit the widest of them, in any column."""
    data = load_data(folder)
    drawn = getattr(trace_figures, kind)(data, "chip", ["pid", "mrac"], {"factor": 0.9})
    wide = replace(data, folder=folder.parent / f"wide_{kind}")
    (wide.folder / "traces").mkdir(parents=True)
    for group in data.select("chip", point={"factor": 0.9}):
        for trace in data.traces(group):
            name = trace.row["key"].replace("/", "__") + ".npz"
            columns = dict(trace.columns)
            if group.controller == "mrac":
                columns |= {f"truth_position_{axis}": 2.0 * trace[f"truth_position_{axis}"] for axis in "ned"}
                columns |= {"tick_quaternion_x": 2.0 * trace["tick_quaternion_x"]}
            np.savez(wide.folder / "traces" / name, allow_pickle=False, **columns)
    widened = getattr(trace_figures, kind)(wide, "chip", ["pid", "mrac"], {"factor": 0.9})
    assert widened.axes[0].get_ylim()[1] > 1.5 * drawn.axes[0].get_ylim()[1]


@pytest.mark.parametrize("kind", ["position", "attitude"])
def test_flights_on_different_paths_are_not_averaged(folder: Path, kind: str, tmp_path: Path) -> None:
    data = load_data(folder)
    start = Draw(path="onboard.guidance.trajectory.path.start_phase", uniform=(0.0, 1.0))
    figures = ({"kind": kind, "case": "chip", "point": {"factor": 0.9}, "controllers": ["pid"]},)
    for draws, title, said in (
        ((), "pid (2 flights)", "over the seeds"),
        ((start,), "pid (seed 1000)", "first seed's"),
    ):
        one = replace(data, config=data.config.model_copy(update={"draws": draws, "figures": figures}))
        drawn = getattr(trace_figures, kind)(one, "chip", ["pid"], {"factor": 0.9})
        assert drawn.axes[0].get_title() == title
        (picture,), _ = draw_all(one, tmp_path, lambda text: None)
        assert said in picture.caption
