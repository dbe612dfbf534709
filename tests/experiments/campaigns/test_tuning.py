"""The gain search: costs, starting point, resuming, and the file it writes."""

import math
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest

import experiments.campaigns.tuning as tuning
from configs.loader import CONFIG_DIRECTORY, ConfigError, parse_yaml, read_tree
from experiments.campaigns.controller_file import tuned_text
from experiments.campaigns.flight_row import empty_row
from experiments.campaigns.search_space import Parameter, near_an_end, present_values
from experiments.campaigns.tuning import (
    Search,
    cost,
    flown_values,
    is_done,
    load_tuning,
    margin_shortfall,
    margin_shortfalls,
    open_study,
    run_search,
    search_record,
)
from experiments.campaigns.worker import FlightResult

TUNE = CONFIG_DIRECTORY / "campaigns" / "tune.yaml"
ALIVE = empty_row() | {"survived": True, "duration_s": 20.0, "flown_s": 20.0}


class Inline(Executor):
    """Runs a job at once, with `fly`."""

    def __init__(self, fly: Any) -> None:
        self._fly = fly

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(self._fly(*args))
        return future


def bowl(job: Any) -> FlightResult:
    """A flight whose error is smallest at a lead of 0.12 s and a position frequency of 5."""
    given = dict(item.split("=", 1) for item in job.assignments)
    lead = float(given["onboard.guidance.feed_forward_lead_s"])
    frequency = float(given["onboard.controller.settings.position.gains.natural_frequency_rad_s.0"])
    error = 0.02 * math.exp(100.0 * (lead - 0.12) ** 2 + 2.0 * math.log(frequency / 5.0) ** 2)
    row = ALIVE | {"settled_rmse_m": error, "after_onset_rmse_m": error}
    return FlightResult(job.key, row)


def level(job: Any) -> FlightResult:
    """A flight with the same error whatever the gains."""
    return FlightResult(job.key, ALIVE | {"settled_rmse_m": 0.02, "after_onset_rmse_m": 0.02})


def test_a_crash_costs_more_than_any_error() -> None:
    good = cost(ALIVE | {"settled_rmse_m": 0.02}, "settled_rmse_m", 0.02, 5.0)
    awful = cost(ALIVE | {"settled_rmse_m": 2.0}, "settled_rmse_m", 0.02, 5.0)
    lost = {"survived": False, "settled_rmse_m": 0.001}
    late = cost(ALIVE | lost | {"flown_s": 19.0}, "settled_rmse_m", 0.02, 5.0)
    early = cost(ALIVE | lost | {"flown_s": 2.0}, "settled_rmse_m", 0.02, 5.0)
    broken = cost(ALIVE | {"error": "boom"}, "settled_rmse_m", 0.02, 5.0)
    assert good == 1.0
    assert good < awful == 5.0 < late < early < broken == 10.0
    assert cost(ALIVE, "settled_rmse_m", 0.02, 5.0) == 5.0  # no complete lap: the highest cost


def test_every_shipped_controller_has_a_space_that_fits_its_file() -> None:
    config = load_tuning("tune")[0]
    for controller in config.own:
        space = config.space(controller)
        names = [one.name for one in space]
        assert len(set(names)) == len(names)
        assert set(present_values(space, controller)) == set(names)
        text = (CONFIG_DIRECTORY / "controllers" / f"{controller}.yaml").read_text()
        values = {path: one.low for one in space for path in one.paths}
        assert tuned_text(text, values, ["x"], controller)


def test_common_parameters_come_first_and_are_the_same_for_all() -> None:
    config = load_tuning("tune")[0]
    for controller in config.own:
        assert config.space(controller)[: len(config.common)] == config.common
    with pytest.raises(ConfigError, match="declared are bias, dmrac"):
        config.space("unheard_of")


def test_tuning_refuses_evaluation_seeds() -> None:
    tree = read_tree(TUNE) | {"seeds": {"first": 999, "count": 2}}
    with pytest.raises(ValueError, match="seeds below 1000"):
        tuning.TuneConfig.model_validate_json(__import__("json").dumps(tree), strict=False)


def search(trials: int) -> Search:
    """Of pid, without the corners: their margins take time."""
    return Search(load_tuning("tune")[0].model_copy(update={"corners": ()}), "tune", "pid", trials, seed=3)


@pytest.fixture
def any_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """All gains have the margins."""
    monkeypatch.setattr(tuning, "margin_shortfall", lambda search, values: 0.0)


def test_search_improves_on_the_file_and_resumes(tmp_path: Path) -> None:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    whole = run_search(search(24), open_study(search(24), tmp_path / "whole"), Inline(bowl), lambda study: None)
    first = next(trial.value for trial in whole.trials if trial.user_attrs["flown"])
    assert first is not None
    assert whole.best_value < first
    run_search(search(9), open_study(search(9), tmp_path / "parts"), Inline(bowl), lambda study: None)
    parts = run_search(search(24), open_study(search(24), tmp_path / "parts"), Inline(bowl), lambda study: None)
    count = min(len(parts.trials), len(whole.trials))
    assert [trial.params for trial in parts.trials[:count]] == [trial.params for trial in whole.trials[:count]]
    record = search_record(search(24), parts)
    assert "--trials 24" in record[0]
    assert f"seeds 0 to {load_tuning('tune')[0].seeds.count - 1}; " in record[1]
    assert f"of {len(flown_values(parts))} flown trials" in record[2]


def test_gains_without_the_margins_are_not_flown(tmp_path: Path) -> None:
    flown: list[str] = []

    def fly(job: Any) -> FlightResult:
        flown.append(job.key)
        return bowl(job)

    one = search(9)  # the estimator's first proposal comes after the starts, and ignores the margins
    study = run_search(one, open_study(one, tmp_path), Inline(fly), lambda study: None)
    ended = study.get_trials(states=tuning.ENDED)
    missing = {trial.number: margin_shortfall(one, trial.params) for trial in ended}
    assert [trial.user_attrs["flown"] for trial in ended] == [missing[trial.number] == 0.0 for trial in ended]
    refused = [trial.value for trial in ended if missing[trial.number] > 0.0]
    assert refused
    assert all(value is not None and value > 2.0 * one.config.crash_cost for value in refused)
    assert len(flown) <= len(flown_values(study)) * len(one.config.cases) * one.config.seeds.count


def test_a_search_ends_when_its_last_third_gained_little() -> None:
    assert not is_done([3.0, 2.0, 1.9], 6)
    assert is_done([3.0, 2.0, 2.0, 2.0, 1.99, 1.99], 6)
    assert not is_done([3.0, 2.0, 2.0, 2.0, 1.9, 1.9], 6)
    assert is_done([3.0, 2.0, 2.0, 2.0, 1.9, 1.9, 1.9, 1.9, 1.0, 1.0, 1.0, 1.0], 6)


def test_shipped_gains_lie_inside_their_ranges() -> None:
    config = load_tuning("tune")[0]
    ends = {
        controller: near_an_end(config.space(controller), present_values(config.space(controller), controller))
        for controller in config.own
    }
    assert not any(ends.values()), ends


def test_a_value_at_the_end_of_a_whole_range_asks_for_no_wider_one() -> None:
    range_ = {"name": "share", "paths": ("settings.path_turn",), "low": 0.0, "high": 1.0}
    assert near_an_end([Parameter(**range_)], {"share": 0.0}) == ["share"]
    assert near_an_end([Parameter(**range_, whole=True)], {"share": 0.0}) == []


@pytest.mark.parametrize("controller", sorted(load_tuning("tune")[0].own))
def test_shipped_gains_have_the_predicted_margins(controller: str) -> None:
    one = Search(load_tuning("tune")[0], "tune", controller, 1)
    missing = margin_shortfalls(one, present_values(one.config.space(controller), controller))
    assert list(missing) == ["nominal", *(corner.name for corner in one.config.corners), "steepest_map"]
    assert max(missing.values()) < 1e-3  # four digits are written


def test_starts_without_the_margins_are_moved_to_gains_with_them(tmp_path: Path) -> None:
    """Whatever the margins do not depend on stays."""
    one = Search(load_tuning("tune")[0], "tune", "indi", 1)
    start = {"position_frequency": 6.0, "attitude_frequency": 15.0, "position_damping": 0.7, "attitude_damping": 1.5}
    values = start | {"feed_forward_lead": 0.05, "path_turn": 0.5, "position_filter": 0.05, "attitude_filter": 0.1}
    assert margin_shortfall(one, values) > 0.0
    moved = tuning.with_margins(one, values, np.random.default_rng(0))
    assert margin_shortfall(one, moved) == 0.0
    assert moved["feed_forward_lead"] == pytest.approx(0.05)
    first = open_study(one, tmp_path).trials[0].system_attrs["fixed_params"]
    assert margin_shortfall(one, first) == 0.0


def test_two_corners_of_one_name_are_refused() -> None:
    tree = read_tree(TUNE)
    tree["corners"][1]["name"] = tree["corners"][0]["name"]
    with pytest.raises(ValueError, match=r"heavy_inertia_weak_slow.*: expected different names, none of them nominal"):
        tuning.TuneConfig.model_validate_json(__import__("json").dumps(tree), strict=False)


@pytest.mark.usefixtures("any_gains")
def test_the_first_trials_start_from_the_campaigns_loop_gains(tmp_path: Path) -> None:
    one = search(1 + len(load_tuning("tune")[0].starts))
    study = run_search(one, open_study(one, tmp_path), Inline(level), lambda study: None)
    first, *others = (trial.params for trial in study.trials)
    changed = [{name: other[name] for name in first if other[name] != first[name]} for other in others]
    assert changed == list(load_tuning("tune")[0].starts)


@pytest.mark.usefixtures("any_gains")
def test_the_trial_of_a_killed_search_is_repeated(tmp_path: Path) -> None:
    study = open_study(search(2), tmp_path)
    flying = study.ask()  # then the process is killed
    values = {
        one.name: flying.suggest_float(one.name, one.low, one.high, log=one.log)
        for one in search(2).config.space("pid")
    }
    one = search(1 + len(search(2).config.starts))
    again = run_search(one, open_study(one, tmp_path), Inline(level), lambda study: None)
    assert again.trials[0].state.name == "FAIL"
    assert [trial.params for trial in again.trials[1:]].count(values) == 1


def test_a_start_outside_its_range_is_refused() -> None:
    tree = read_tree(TUNE) | {"starts": [{"position_frequency": 40.0}]}
    with pytest.raises(ValueError, match=r"position_frequency: 40\.0 is not a common parameter within its range"):
        tuning.TuneConfig.model_validate_json(__import__("json").dumps(tree), strict=False)


@pytest.mark.usefixtures("any_gains")
def test_an_interrupted_trial_is_repeated(tmp_path: Path) -> None:
    def interrupted(job: Any) -> FlightResult:
        raise KeyboardInterrupt

    study = open_study(search(2), tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_search(search(2), study, Inline(interrupted), lambda study: None)
    study = run_search(search(2), open_study(search(2), tmp_path), Inline(level), lambda study: None)
    states = [trial.state for trial in study.trials]
    assert states.count(optuna.trial.TrialState.FAIL) == 1
    assert states.count(optuna.trial.TrialState.COMPLETE) == 2
    assert study.trials[1].params | load_tuning("tune")[0].starts[0] == study.trials[1].params  # not flown before


def test_a_wrong_path_ends_the_search_with_its_command(tmp_path: Path) -> None:
    def wrong(job: Any) -> FlightResult:
        row = empty_row() | {"error": "configs.loader.ConfigError: no such key", "command": "dmrac fly x"}
        return FlightResult(job.key, row)

    with pytest.raises(ConfigError, match="repeat with: dmrac fly x"):
        run_search(search(1), open_study(search(1), tmp_path), Inline(wrong), lambda study: None)


def test_the_file_keeps_comments_anchors_and_layout() -> None:
    text = (
        "# What this is.\n# Tuned: an older search\nsettings:\n  a: {x: 1.0, y: [2.0, 3.0]}  # why\n"
        "  b: &same\n    - {signal: p, scale: 1.0}\n  c: *same\n"
    )
    changed = tuned_text(text, {"settings.a.x": 0.5, "settings.a.y.1": 12.0, "guidance.lead": 0.1}, ["new"], "file")
    assert changed == (
        "# What this is.\n# Tuned: new\nsettings:\n  a: {x: 0.5, y: [2.0, 12.0]}  # why\n"
        "  b: &same\n    - {signal: p, scale: 1.0}\n  c: *same\nguidance:\n  lead: 0.1\n"
    )
    again = tuned_text(changed, {"guidance.lead": 0.2, "guidance.other": 1e-5}, ["newer"], "file")
    assert parse_yaml(again, "file")["guidance"] == {"lead": 0.2, "other": 1e-5}
    with pytest.raises(ConfigError, match=r"settings\.z\.q"):
        tuned_text(text, {"settings.z.q": 1.0}, [], "file")


def test_values_that_a_file_leaves_to_their_defaults_are_searched_and_written() -> None:
    text = "settings:\n  a: {x: 1.0}\n  b:\n    law:\n      y: 2.0\n  c: {}\n"
    values = {"settings.a.new": 0.5, "settings.b.law.new": 0.25, "settings.c.new": 3.0}
    changed = parse_yaml(tuned_text(text, values, [], "file"), "file")["settings"]
    assert changed == {"a": {"x": 1.0, "new": 0.5}, "b": {"law": {"new": 0.25, "y": 2.0}}, "c": {"new": 3.0}}
