"""`dmrac bench`: times the onboard step, the loop, the simulated vehicle, the trainer and lockstep.

`dmrac bench sensors` compares the noise of the simulated sensors with real flight logs instead; `dmrac bench flood`
flies while ports are flooded; `dmrac bench core` measures the core in C beside numpy's; `dmrac bench fleet` how soon a
sample flies as weights with many vehicles on one trainer; `dmrac bench gym` counts the steps per second of the
Gymnasium environments; `dmrac bench neural-fly`, `omac`, `nanobench` and `crazypad` run the
learner, and on `nanobench` the estimator, on tasks and flights of others.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import plain_console, positive
from configs.loader import ConfigError
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve
from runtime.extras import require_modules

if TYPE_CHECKING:
    from async_dmrac.benchmarks.recordings import Left

SENSORS: Final = "sensors"
FLOOD: Final = "flood"
CORE: Final = "core"
FLEET: Final = "fleet"
GYM: Final = "gym"
NEURAL_FLY: Final = "neural-fly"
OMAC: Final = "omac"
NANOBENCH: Final = "nanobench"
CRAZYPAD: Final = "crazypad"
FOLDERS: Final = {NEURAL_FLY: "data", NANOBENCH: "data", CRAZYPAD: "data", OMAC: "code"}
"""Option with the folder of others that a kind needs. Nothing is downloaded."""
FIXED: Final = (CORE, FLEET, GYM, NEURAL_FLY, OMAC, NANOBENCH, CRAZYPAD)
"""What always flies the same, or nothing."""
AHEAD: Final = "predicted 0.16 s ahead"
VEHICLES: Final = {CORE: 64, FLEET: 16}
"""Most vehicles, unless given."""
EXAMPLES: Final = """examples:
  dmrac bench
  dmrac bench sensors --set vehicle.sensors.imu.noise=white
  dmrac bench flood --controller mrac --seconds 12
  dmrac bench core --seconds 20 --vehicles 64
  dmrac bench fleet --seconds 40
  dmrac bench gym
  dmrac bench neural-fly --data neural-fly/data
  dmrac bench omac --code Online-Meta-Adaptive-Control/quadsim --seconds 60
  dmrac bench nanobench --data nanobench-iros2026
  dmrac bench crazypad --data CrazyPAD/data --out crazypad.json
  dmrac bench figure8_wind --controller mrac --seconds 30 --out bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac bench`."""
    parser.add_argument(
        "scenario",
        nargs="?",
        default=DEFAULT_SCENARIO,
        help="scenario to fly (default: %(default)s); sensors: compare the sensors' noise with real flight logs; "
        "flood: fly with flooded ports (needs root); core: the core in C beside numpy's; fleet: many vehicles on one "
        "trainer; gym: the Gymnasium environments; neural-fly, omac, nanobench, crazypad: the learner on tasks and "
        "flights of others",
    )
    parser.add_argument(
        "--vehicles",
        type=positive,
        metavar="N",
        help="most vehicles (default: " + ", ".join(f"{name} {most}" for name, most in VEHICLES.items()) + ")",
    )
    parser.add_argument(
        "--data",
        type=Path,
        metavar="FOLDER",
        help="neural-fly, crazypad: their folder `data`; nanobench: their repository",
    )
    parser.add_argument("--code", type=Path, metavar="FOLDER", help="omac: the folder with their `threedeequadsim`")
    parser.add_argument("--controller", help="another controller than the scenario's")
    parser.add_argument("--seconds", type=float, default=15.0, help="flight time to measure, 2 to 600 s")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value by path")
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write the numbers to this file as JSON")
    add_json_option(parser, "the numbers")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0. Raises ConfigError for bad options."""
    if not 2.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds {arguments.seconds:g}: allowed are 2 to 600")
    if arguments.vehicles is not None and arguments.scenario not in VEHICLES:
        raise ConfigError(f"--vehicles {arguments.vehicles}: only with dmrac bench {', '.join(VEHICLES)}")
    for option in set(FOLDERS.values()):
        if getattr(arguments, option) is not None and FOLDERS.get(arguments.scenario) != option:
            kinds_with = ", ".join(kind for kind, needed in FOLDERS.items() if needed == option)
            raise ConfigError(f"--{option} {getattr(arguments, option)}: only with dmrac bench {kinds_with}")
    if arguments.scenario in FIXED and (arguments.controller is not None or arguments.set):
        raise ConfigError(f"--controller, --set: not allowed with dmrac bench {arguments.scenario}")
    kinds: dict[str, Callable[[argparse.Namespace], Any]] = {
        SENSORS: _sensors,
        FLOOD: _flood,
        CORE: _core,
        FLEET: _fleet,
        GYM: _gym,
        NEURAL_FLY: _neural_fly,
        OMAC: _omac,
        NANOBENCH: _nanobench,
        CRAZYPAD: _crazypad,
    }
    measure: Callable[[argparse.Namespace], Any] = kinds.get(arguments.scenario, _times)
    report = measure(arguments)
    if arguments.json:
        print_json(report)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


def _times(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.timing.benchmark import measure

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    return measure(resolve(arguments.scenario, choices), arguments.seconds, plain_console(arguments.json).print)


def _core(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.campaigns.provenance import here
    from experiments.timing.core_speed import measure

    show, place = plain_console(arguments.json).print, here()
    show(place)
    figures = measure(max(arguments.seconds, 5.0), arguments.vehicles or VEHICLES[CORE], show)
    return {"machine": place, "figures": [one.as_json() for one in figures]}


def _fleet(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from experiments.timing.fleet_latency import as_json, measure

    return as_json(
        measure(arguments.vehicles or VEHICLES[FLEET], arguments.seconds, plain_console(arguments.json).print)
    )


def _flood(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from experiments.link.flood import PORTS, RATES_HZ, as_json, measure, table

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    console = plain_console(arguments.json)
    flights = measure(resolve(DEFAULT_SCENARIO, choices), tuple(PORTS), RATES_HZ, console.print)
    console.print(table(flights))
    return as_json(flights)


def _gym(arguments: argparse.Namespace) -> dict[str, dict[str, float]]:
    require_modules("gymnasium", "numba", purpose=f"dmrac bench {GYM}")
    from async_dmrac.environments.speed import environment_speeds

    speeds = environment_speeds()
    show = plain_console(arguments.json).print
    show(
        "\n".join(
            f"{name:34} {one.steps_s:9.0f} steps/s, {one.processor_us:6.2f} us of processor time a step"
            for name, one in speeds.items()
        )
    )
    return {name: asdict(one) for name, one in speeds.items()}


def _neural_fly(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from async_dmrac.benchmarks.neural_fly import WHERE, as_json, compare

    found, show = compare(_folder(arguments, WHERE)), plain_console(arguments.json).print
    show("mean squared error of the force; fitted and published: the last layer fits the whole flight; ahead: on line")
    show(f"{'flight':10} {'samples':>8} {'zero':>7} {'mean':>7} {'fitted':>7} {'published':>9} {'ahead':>7} untrained")
    for one in found:
        published = f"{one.published:9.2f}" if one.published is not None else f"{'-':>9}"
        show(
            f"{one.condition:10} {one.samples:8d} {one.zero:7.2f} {one.mean:7.2f} {one.fitted:7.2f} {published}"
            f" {one.ahead:7.2f} {one.ahead_untrained:9.2f}"
        )
    return as_json(found)


def _omac(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from async_dmrac.benchmarks.omac import WHERE, as_json, compare

    found, show = compare(_folder(arguments, WHERE), arguments.seconds), plain_console(arguments.json).print
    show(f"{'controller':12} {'mean error':>11} {'second half':>12}")
    for one in found:
        show(f"{one.controller:12} {one.position_m:9.3f} m {one.settled_m:10.3f} m")
    return as_json(found)


def _nanobench(arguments: argparse.Namespace) -> dict[str, Any]:
    from async_dmrac.benchmarks.nanobench import WHERE, learner_result
    from async_dmrac.benchmarks.nanobench_estimates import by_speed, estimates

    folder, show = _folder(arguments, WHERE), plain_console(arguments.json).print
    learnt = learner_result(folder)
    show(f"residual acceleration of held-out flights, m/s^2 rms, {AHEAD}; motor lag {learnt.motor_lag_s:.2f} s")
    _show_left(learnt.flights, learnt.left_out, show)
    found, left_out = estimates(folder)
    means = by_speed(found)
    show("\nvelocity against the motion capture, m/s rms, means over the trefoil flights of a speed; (attitude, deg)")
    head = f"{'speed':8} {'flights':>7} {'published':>9} {'logged':>7}"
    show(f"{head} {'their filter':>16} {'ours, 100 poses/s':>18} {'ours, 10 poses/s':>17}")
    for one in means:
        show(
            f"{one.speed:8} {one.flights:7d} {one.published_m_s:9.3f} {one.logged_m_s:7.3f}"
            f" {one.theirs_m_s:7.3f} ({one.theirs_deg:6.2f}) {one.ours_m_s:9.3f} ({one.ours_deg:6.2f})"
            f" {one.sparse_m_s:8.3f} ({one.sparse_deg:6.2f})"
        )
    if left_out:
        show(f"left out: {', '.join(left_out)}")
    return {
        "learner": asdict(learnt),
        "estimator": [asdict(one) for one in found],
        "estimator_by_speed": [asdict(one) for one in means],
        "estimator_left_out": left_out,
    }


def _crazypad(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from async_dmrac.benchmarks.crazypad import WHERE, results

    found, show = results(_folder(arguments, WHERE)), plain_console(arguments.json).print
    for one in found:
        gains = ", ".join(f"{gain:.1f}" for gain in one.gains)
        show(f"{one.kind}: residual of held-out flights, {one.unit} rms, {AHEAD}; gains {gains} {one.unit}")
        _show_left(one.flights, one.left_out, show)
    return [asdict(one) for one in found]


def _show_left(flights: Sequence["Left"], left_out: Sequence[str], show: Callable[[str], None]) -> None:
    """A row per flight, and the flights with too few samples."""
    width = max(len(one.flight) for one in flights)
    head = f"{'flight':{width}} {'samples':>8} {'no model':>9} {'bias':>7}"
    show(f"{head} {'untrained':>9} {'trained, held':>13} {'trained, adapted':>16}")
    for one in flights:
        show(
            f"{one.flight:{width}} {one.samples:8d} {one.zero:9.3f} {one.bias:7.3f} {one.untrained:9.3f}"
            f" {one.held:13.3f} {one.adapted:16.3f}"
        )
    if left_out:
        show(f"left out, too few samples in the air or another rate: {', '.join(left_out)}")


def _folder(arguments: argparse.Namespace, where: str) -> Path:
    """The folder of others. Raises ConfigError, which says where to get it, without one."""
    option = FOLDERS[arguments.scenario]
    folder: Path | None = getattr(arguments, option)
    if folder is None:
        raise ConfigError(f"--{option}: missing; dmrac bench {arguments.scenario} downloads nothing: {where}")
    return folder


def _sensors(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.flights.sensor_noise import NOT_MEASURED_S, as_json, compare_noise, nis_table, noise_table

    choices = Choices(arguments.controller, None, arguments.seconds + NOT_MEASURED_S, tuple(arguments.set))
    config = resolve("hover", choices)
    comparison, console = compare_noise(choices), plain_console(arguments.json)
    console.print(noise_table(config, comparison.rows))
    console.print(nis_table(comparison.nis))
    return as_json(config, comparison)
