"""The optimiser for the worst accepted versions: its value, its file, and what it keeps."""

import json

import optuna
import pytest

from configs.loader import ConfigError
from experiments.attacks import search
from experiments.attacks.attack_flight import AttackFlight, AttackOutcome
from experiments.attacks.search import KEPT, LOST_VALUE, STARTS, Search, best, keep, run_search, value_of
from experiments.attacks.strategies import read_finds

FLIGHTS = (AttackFlight("search", 3, "jet_8"),)


def outcome(error_m=0.1, lost_after_s=-1.0, swaps=1):
    return AttackOutcome(
        "search", 3, "tilted" if lost_after_s >= 0.0 else "", lost_after_s, error_m, 0.2, swaps, {}, []
    )


def test_a_lost_vehicle_counts_more_than_any_error_and_more_the_sooner():
    assert value_of([outcome(0.1), outcome(0.3)], [0.1, 0.1]) == pytest.approx(2.0)
    soon, late = value_of([outcome(lost_after_s=0.1)], [0.1]), value_of([outcome(lost_after_s=3.0)], [0.1])
    assert soon > late > LOST_VALUE


def test_seeds_of_evaluation_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"seed 1000 is for evaluation; allowed are 0 to 999"):
        Search((AttackFlight("search", 1000),), 5, tmp_path)


class Pool:
    """Flies at once: the error grows with one parameter; a version is accepted unless `share` is small."""

    def __init__(self, _workers, recycle=True):
        pass

    def open(self):
        return self

    def submit(self, fly, *arguments):
        return Done(outcome(0.1) if not arguments else rated(arguments[1]))

    def close(self):
        pass


def rated(strategy):
    return outcome(0.1 + 0.1 * strategy["position_honest"] ** 2, swaps=int(strategy["share"] > 0.5))


class Done:
    def __init__(self, found):
        self.found = found

    def result(self):
        return self.found


@pytest.fixture
def flown(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "LocalPool", Pool)
    lines = []
    return run_search(Search(FLIGHTS, 8, tmp_path), 2, lines.append), lines, tmp_path


def test_the_starts_are_flown_first_and_the_same_command_goes_on(flown):
    study, lines, folder = flown
    assert len(study.trials) == len(lines) == 8
    assert [trial.params for trial in study.trials[: len(STARTS)]] == [dict(start) for start in STARTS]
    more = []
    again = run_search(Search(FLIGHTS, 10, folder), 2, more.append)
    assert (len(again.trials), len(more)) == (10, 2)
    assert run_search(Search(FLIGHTS, 10, folder), 2, more.append).best_value == again.best_value


def test_a_search_over_other_flights_needs_another_folder(flown):
    with pytest.raises(ConfigError, match="other flights"):
        search.open_study(Search((AttackFlight("search", 4),), 8, flown[2]))


def test_a_trial_that_was_killed_is_flown_again(flown):
    study = flown[0]
    left = study.ask()
    search._suggested(left)
    again = search.open_study(Search(FLIGHTS, 8, flown[2]))
    assert again.trials[left.number].state is optuna.trial.TrialState.FAIL
    assert again.trials[-1].state is optuna.trial.TrialState.WAITING


def test_the_best_finds_are_kept_with_their_command(flown):
    study, _, folder = flown
    finds = best(study)
    assert 0 < len(finds) <= KEPT
    assert [find.value for find in finds] == sorted((find.value for find in finds), reverse=True)
    assert all(find.accepted for find in finds)
    path = folder / "finds.json"
    keep(study, "dmrac attack --search 8", path)
    assert [find["share"] for find in read_finds(path)] == [
        pytest.approx(find.strategy["share"], rel=1e-4) for find in finds
    ]
    assert json.loads(path.read_text())["command"] == "dmrac attack --search 8"


def test_the_same_find_is_not_kept_twice(flown):
    study = flown[0]
    worst = best(study)[0]
    trial = optuna.trial.create_trial(
        params=dict(worst.strategy),
        distributions=study.trials[0].distributions,
        value=worst.value + 1.0,
        user_attrs={"lost": 0, "accepted": 1},
    )
    study.add_trial(trial)
    assert [find.trial for find in best(study)].count(worst.trial) == 0
    assert best(study)[0].value == worst.value + 1.0
