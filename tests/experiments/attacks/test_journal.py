"""The flights of an attack campaign are kept, found again, and not mixed with those of other code."""

import dataclasses
import json

import pytest

from configs.loader import ConfigError
from experiments.attacks import corpus
from experiments.attacks.attack_flight import AttackFlight, AttackOutcome
from experiments.attacks.journal import FILE, Journal

FLIGHT = AttackFlight("steep", 7, "jet_8", assignments=("onboard.controller.settings.guard.strikes_max=2",))


def outcome(flight=FLIGHT, error_m=0.05, lost=""):
    return AttackOutcome(
        flight.case,
        flight.seed,
        lost,
        1.5 if lost else -1.0,
        error_m,
        0.2,
        3,
        {2: "slope", 4: "reach"},
        ["1.00 an event"],
    )


def test_a_flight_is_found_again_by_all_that_it_depends_on(tmp_path):
    Journal(tmp_path, "abc").add(FLIGHT, outcome())
    again = Journal(tmp_path, "abc")
    assert again.find(FLIGHT) == outcome()
    for changed in ({"seed": 8}, {"case": "flipped"}, {"condition": "calm"}, {"core": "c"}, {"assignments": ()}):
        assert again.find(dataclasses.replace(FLIGHT, **changed)) is None


def test_without_a_folder_it_lasts_as_long_as_the_process():
    journal = Journal(None, "abc")
    journal.add(FLIGHT, outcome())
    assert journal.find(FLIGHT) == outcome()


def test_half_a_line_of_a_killed_process_is_cut_off(tmp_path):
    Journal(tmp_path, "abc").add(FLIGHT, outcome())
    path = tmp_path / FILE
    path.write_text(path.read_text() + '{"key": "steep/jet')
    other = dataclasses.replace(FLIGHT, seed=8)
    Journal(tmp_path, "abc").add(other, outcome(other))
    again = Journal(tmp_path, "abc")
    assert again.find(FLIGHT) == outcome()
    assert again.find(other) == outcome(other)


def test_flights_of_other_code_are_not_mixed(tmp_path):
    Journal(tmp_path, "abc").add(FLIGHT, outcome())
    with pytest.raises(ConfigError, match=r"flown with 'abc', this is 'def'"):
        Journal(tmp_path, "def")


@pytest.mark.parametrize("content", ["not json\n", '{"other": 1}\n', '{"source": "abc"}\n{"key": "k"}\n'])
def test_another_file_is_a_plain_error(tmp_path, content):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ConfigError, match=FILE):
        Journal(tmp_path, "abc")


class Pool:
    """Flies at once, here; notes what it flew."""

    def __init__(self, _workers, recycle):
        assert not recycle, "a pool that replaces its processes hangs while it has idle ones"
        self.flown = []
        Pool.last = self

    def open(self):
        return self

    def submit(self, fly):
        flight = fly.__self__
        self.flown.append((flight.case, flight.controller, flight.seed))
        return Done(outcome(flight, 0.1 if flight.controller == "bias" else 0.15, "tilted" if flight.seed == 2 else ""))

    def close(self):
        pass


class Done:
    def __init__(self, found):
        self.found = found

    def result(self):
        return self.found


def test_a_corpus_flies_only_what_its_journal_lacks(tmp_path, monkeypatch):
    monkeypatch.setattr(corpus, "LocalPool", Pool)
    monkeypatch.setattr(corpus, "as_completed", list)
    flights = [AttackFlight(case, seed) for seed in (1, 2) for case in ("steep", "flipped")]
    first = corpus.fly_corpus(flights[:2], Journal(tmp_path, "abc"), 1)
    assert Pool.last.flown == [("silent", "bias", 1), ("steep", "dmrac", 1), ("flipped", "dmrac", 1)]
    assert [row.flights for row in first] == [1, 1]
    rows = corpus.fly_corpus(flights, Journal(tmp_path, "abc"), 1)
    assert Pool.last.flown == [("silent", "bias", 2), ("steep", "dmrac", 2), ("flipped", "dmrac", 2)]
    assert json.dumps([row.summary() for row in rows]) == json.dumps(
        [{"case": case, "flights": 2, "lost": 1, "error_ratio_to_bias": 1.5} for case in ("steep", "flipped")]
    )
    assert rows[0].refused == {"slope": 2, "reach": 2}


def test_the_law_that_is_compared_with_flies_the_same_air_without_the_controllers_settings():
    plain = corpus.plain_flight(
        dataclasses.replace(FLIGHT, assignments=(*FLIGHT.assignments, "vehicle.body.mass_kg=0.07"))
    )
    assert (plain.controller, plain.case, plain.condition, plain.seed) == ("bias", "silent", "jet_8", 7)
    assert plain.assignments == ("vehicle.body.mass_kg=0.07",)
