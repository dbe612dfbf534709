"""Draws of a campaign: by the seed, the same for all controllers, from ranges that nobody tuned in."""

import json
from typing import Any

import pytest

from configs.loader import CONFIG_DIRECTORY, ConfigError, fill, parse_yaml
from configs.vehicle import read_vehicle
from experiments.campaigns.campaign import CampaignConfig, load_campaign
from experiments.campaigns.draws import thrust_to_weight
from experiments.campaigns.flight_jobs import FlightJob, unfold
from experiments.campaigns.worker import fly_job
from sim_vehicle.disturbances.fan_jet import FanJet

WHOLE = {"vehicle": "held_out"}
START_PHASE = "onboard.guidance.trajectory.path.start_phase"
JET_NORTH = "vehicle.disturbances.0.origin_ned_m.0"
MASS = "vehicle.body.mass_kg"
NOT_DRAWN = ("paper_preset", "survival", "tune")
"""The paper's flights are flown as they are; survival asks for the ranges of tuning; tune is another kind of file."""
REPORTING = sorted(file.stem for file in (CONFIG_DIRECTORY / "campaigns").glob("*.yaml") if file.stem not in NOT_DRAWN)


def campaign(*draws: dict[str, Any], own: tuple[dict[str, Any], ...] = (), **over: Any) -> CampaignConfig:
    cases = [{"name": name, "scenario": "figure8_wind", "draws": own} for name in ("one", "two")]
    tree = {"description": "t", "controllers": ["pid", "none"], "seeds": {"count": 20}, "cases": cases, "draws": draws}
    return fill(CampaignConfig, tree | over, "t")


def assigned(job: FlightJob) -> dict[str, Any]:
    return {path: json.loads(value) for path, _, value in (one.partition("=") for one in job.assignments)}


def drawn(config: CampaignConfig, seeds: int | None = None) -> dict[int, list[dict[str, Any]]]:
    """The assignments of every flight, by seed."""
    found: dict[int, list[dict[str, Any]]] = {}
    for job in unfold(config, "t", seeds):
        found.setdefault(job.seed, []).append(assigned(job))
    return found


def test_a_whole_vehicle_is_the_same_in_every_case_and_for_every_controller_of_a_seed() -> None:
    flights = drawn(campaign(WHOLE))
    assert all(all(one == of_seed[0] for one in of_seed) for of_seed in flights.values())
    paths = [f"vehicle.{path}" for path in read_vehicle("mambo").ranges["held_out"]]
    assert list(flights[1000][0]) == paths
    for path in paths:
        assert len({json.dumps(of_seed[0][path]) for of_seed in flights.values()}) == 20, f"{path}: one for each seed"


def test_a_whole_vehicle_lies_within_its_ranges_and_reaches_their_ends() -> None:
    flights = [of_seed[0] for of_seed in drawn(campaign(WHOLE), 200).values()]
    vehicle = read_vehicle("mambo")
    for path in vehicle.ranges["held_out"]:
        low, high = (number(vehicle.drawn(path, share, "held_out")) for share in (0.0, 1.0))
        values = [number(flight[f"vehicle.{path}"]) for flight in flights]
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high >= max(values) > high - 0.05 * (high - low)


def number(value: Any) -> float:
    return float(value[0]) if isinstance(value, list) else float(value)


def test_the_draws_of_a_campaign_do_not_depend_on_each_other_or_on_a_case() -> None:
    start = {"path": START_PHASE, "uniform": [0.0, 1.0]}
    alone, among = campaign(start), campaign(WHOLE, start, own=({"path": JET_NORTH, "uniform": [0.3, 0.5]},))
    for seed, flights in drawn(alone).items():
        assert flights[0][START_PHASE] == drawn(among)[seed][0][START_PHASE]
    of_case = campaign(own=(WHOLE,))
    assert drawn(of_case)[1000][0] == drawn(campaign(WHOLE))[1000][0]


def test_a_vehicle_with_too_little_thrust_is_drawn_again() -> None:
    free, limited = drawn(campaign(WHOLE), 100), drawn(campaign(WHOLE | {"thrust_to_weight": 1.6}), 100)
    able = [seed for seed in free if lift(free[seed][0]) >= 1.6]
    assert 20 < len(able) < 80
    assert all(limited[seed] == free[seed] for seed in able)
    assert all(lift(of_seed[0]) >= 1.6 for of_seed in limited.values())
    again = {MASS, "vehicle.motors.gain"}
    for seed, flights in limited.items():
        assert {path for path, value in flights[0].items() if value != free[seed][0][path]} <= again


def lift(flight: dict[str, Any]) -> float:
    motors = read_vehicle("mambo").simulated["motors"]
    return thrust_to_weight({"mass_kg": flight[MASS]}, motors | {"gain": flight["vehicle.motors.gain"]})


def test_the_nominal_vehicle_lifts_twice_its_weight() -> None:
    vehicle = read_vehicle("mambo").simulated
    assert thrust_to_weight(vehicle["body"], vehicle["motors"]) == pytest.approx(2.117, abs=1e-3)


def test_a_range_is_that_of_the_scenarios_vehicle() -> None:
    case = {"name": "one", "scenario": "figure8_real", "draws": [{"path": MASS, "range": "tuning"}]}
    masses = [flights[0][MASS] for flights in drawn(campaign(cases=[case])).values()]
    assert 0.9 * 0.07 <= min(masses) < 0.067 < 0.08 < max(masses) <= 1.2 * 0.07


@pytest.mark.parametrize(
    ("draws", "said"),
    [
        ([{"path": MASS}], "give one of uniform, choice, range and vehicle"),
        ([WHOLE | {"path": MASS}], "path: expected with uniform, choice and range, and not"),
        ([{"uniform": [0, 1]}], "path: expected with uniform"),
        ([{"vehicle": "mambo"}], r"draws\.0\.vehicle: 'mambo': .*'tuning' or 'held_out'"),
        ([{"path": "onboard.airframe.mass_kg", "range": "tuning"}], r"expected one that starts with vehicle\."),
        ([{"path": MASS, "range": "tuning", "thrust_to_weight": 1.5}], "thrust_to_weight: expected with vehicle only"),
        ([{"path": MASS, "uniform": [0.07, 0.06]}], r"uniform: \[0\.07, 0\.06\]: expected the low end first"),
        (
            [{"path": "vehicle.body.arm_x_m", "range": "held_out"}],
            "no held_out range of it; allowed are body.mass_kg",
        ),
        ([WHOLE | {"thrust_to_weight": 2.9}], "vehicle mambo: draws: thrust_to_weight: 2.9: no vehicle within its"),
        ([WHOLE, {"path": MASS, "uniform": [0.06, 0.07]}], "draws: vehicle.body.mass_kg: drawn twice"),
    ],
)
def test_a_wrong_draw_is_named(draws: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        list(unfold(campaign(*draws), "t"))


def test_a_value_is_not_drawn_by_the_campaign_and_by_the_case() -> None:
    start = {"path": START_PHASE, "uniform": [0.0, 1.0]}
    with pytest.raises(ConfigError, match="start_phase: drawn twice; expected once, in the campaign or in the case"):
        list(unfold(campaign(start, own=(start,)), "t"))


@pytest.mark.parametrize("name", REPORTING)
def test_what_a_seed_draws_is_the_same_in_all_flights_of_a_shipped_campaign(name: str) -> None:
    """So all that a campaign compares is flown under the same conditions; the source of an experience too.

    Not what a memory is learnt from: other vehicles in other places.
    """
    config, _ = load_campaign(name)
    paths = {case.name: drawn_paths(config, case.name) for case in config.cases}
    found: dict[tuple[str, int], set[str]] = {}
    for job in unfold(config, "t", 2):
        for path, value in assigned(job).items():
            if path in paths[job.case] and not job.teaches:
                found.setdefault((path, job.seed), set()).add(json.dumps(value))
    assert all(len(values) == 1 for values in found.values()), found
    by_seed = {path: (found[path, 1000], found[path, 1001]) for path, _ in found}
    assert all(one != other for one, other in by_seed.values()), by_seed
    assert MASS in by_seed
    periodic = any(case.scenario not in ("rotor_chip", "lissajous_wind") for case in config.cases)
    assert (START_PHASE in by_seed) is periodic


def drawn_paths(config: CampaignConfig, case: str) -> set[str]:
    whole = {f"vehicle.{path}" for path in read_vehicle("mambo").ranges["held_out"]}
    draws = (*config.draws, *config.case(case).draws)
    return set[str]().union(*({draw.path} if draw.path else whole for draw in draws))


@pytest.mark.parametrize("name", REPORTING)
def test_a_shipped_campaign_draws_held_out_vehicles_and_another_place_of_the_jet(name: str) -> None:
    config, _ = load_campaign(name)
    first = {job.case: job for job in reversed(list(unfold(config, name, 1))) if not job.teaches}
    draws = [*config.draws, *(draw for case in config.cases if case.name in first for draw in case.draws)]
    assert {draw.vehicle for draw in draws} == {None, "held_out"}
    for job in first.values():
        for item in job.configuration().vehicle.disturbances:
            if isinstance(item, FanJet):
                assert item.origin_ned_m[0] < 0.56, "the search of the gains flies it at 0.6 m"


WEAK = """
description: A vehicle that cannot lift its weight.
controllers: [none]
cases: [{name: weak, scenario: hover, duration_s: 6, set: {vehicle.motors.gain: [0.4, 0.4, 0.4, 0.4]}}]
seeds: {count: 1}
"""


def test_a_vehicle_that_does_not_reach_its_height_is_lost_and_not_left_out() -> None:
    row = fly_job(next(unfold(fill(CampaignConfig, parse_yaml(WEAK, "t"), "t"), "t"))).row
    assert (row["survived"], row["crash_reason"], row["error"]) == (False, "never reached the height of its path", "")
