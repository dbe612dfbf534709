"""The task of the environments: vehicles of a scenario that follow its path, each with draws of its own."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

import sim_vehicle.physics.inner_loop as loop
from async_dmrac.interface import configure
from configs.flight_tree import read_law
from configs.loader import ConfigError, fill
from experiments.campaigns.draws import VEHICLE_ROOT, Draw, draw_all
from experiments.flights.metrics import TARGET_DISTANCE_MAX_M
from experiments.flights.scenario import FlightConfig
from onboard.control.reference_model import ChannelGains
from onboard.flight.trajectory import Path
from protocol.conventions import GRAVITY, Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.batch import Map, VehicleBatch
from sim_vehicle.physics.observe import COLUMNS, OBSERVATIONS, observe_all
from sim_vehicle.world.interface import Disturbance

ACTIONS: Final = {
    "motors": (loop.MOTORS, 4),
    "rates": (loop.RATES, 4),
    "acceleration": (loop.ACCELERATION, 3),
    "residual": (loop.RESIDUAL, 3),
}
"""Mode and width of each kind of action."""
USUAL_OBSERVATION: Final = ("position_error", "velocity_error", "rotation", "rates", "last_action")
START_SPREAD: Final = (0.2, 0.2, 0.1, 0.2)
"""Of the start about the path: m, m/s, rad (as a turn of the quaternion) and rad/s; half-widths."""
RATES_MAX_RAD_S: Final = 6.0
ACCELERATION_MAX_M_S2: Final = 5.0
RESIDUAL_MAX_M_S2: Final = 3.0


class Task:
    """n vehicles, their actions, observations and rewards."""

    def __init__(
        self,
        vehicles: int,
        scenario: str = "hover",
        *,
        action: str = "rates",
        observation: Sequence[str] = USUAL_OBSERVATION,
        rate_hz: float = 200.0,
        episode_s: float = 10.0,
        controller: str = "none",
        set: Mapping[str, Any] | None = None,  # noqa: A002 the same word as in `async_dmrac.fly`
        disturbances: Sequence[Disturbance] = (),
        draws: Sequence[Mapping[str, Any]] = (),
        start_spread: float = 1.0,
        threads: int = 1,
    ) -> None:
        """Read the scenario. Raises ConfigError that names the argument, its value and what is allowed."""
        if action not in ACTIONS:
            raise ConfigError(f"action: {action!r}: allowed are {', '.join(ACTIONS)}")
        unknown = [name for name in observation if name not in OBSERVATIONS]
        if unknown or not observation:
            raise ConfigError(f"observation: {[*unknown]}: allowed are {', '.join(OBSERVATIONS)}")
        if not 1 <= threads <= vehicles:
            raise ConfigError(f"threads: {threads}: allowed are 1 to {vehicles}, the vehicles")
        self.substeps = round(1000.0 / rate_hz) if rate_hz > 0 else 0
        if not 1 <= self.substeps <= 100 or abs(self.substeps * rate_hz - 1000.0) > 1e-6:
            raise ConfigError(f"rate_hz: {rate_hz:g}: allowed are 10 to 1000 with a whole number of ms in a step")
        self.mode, self.action_width = ACTIONS[action]
        self._flight = configure(scenario, set=set, disturbances=disturbances)
        self._draws = tuple(fill(Draw, draw, f"draws[{at}]") for at, draw in enumerate(draws))
        self._scenario, self._spread = scenario, start_spread
        self.steps_max = round(episode_s * rate_hz)
        self.path = _targets(self._flight, self.steps_max, 1.0 / rate_hz)
        self._start = self._flight.vehicle.model_copy(
            update={"initial": self._flight.vehicle.initial.model_copy(update=_on_path(self.path[0]))}
        )
        self._settings = _loop_settings(self._flight, controller)
        self._columns = np.concatenate([np.arange(first, first + width) for first, width, _ in _places(observation)])
        self.observation_names = tuple(
            f"{name}_{part}" if width > 1 else name
            for name, (_, width, _) in zip(observation, _places(observation), strict=True)
            for part in range(width)
        )
        self.batch = VehicleBatch(self._start, [0] * vehicles, threads, map if threads == 1 else _beside(threads))
        self.steps: NDArray[np.int64] = np.zeros(vehicles, dtype=np.int64)
        self._table: Array = np.zeros((vehicles, COLUMNS))
        self._commands: Array = np.zeros((vehicles, 4))
        self._work: Array = np.zeros(4)
        self.rewards: Array = np.zeros(vehicles)
        self.lost = np.zeros(vehicles, dtype=np.bool_)

    def reset(self, vehicle: int, rng: np.random.Generator) -> int:
        """Start an episode of one vehicle with draws of its own; return its seed."""
        seed = int(rng.integers(2**31))
        config = self._drawn(seed) if self._draws else self._start
        self.batch.reset(vehicle, config, seed)
        state = self.batch.states[vehicle]
        metres, speed, turn, rate = (self._spread * size for size in START_SPREAD)
        state[:3] += rng.uniform(-metres, metres, 3)
        state[3:6] += self.path[0, 3:6] + rng.uniform(-speed, speed, 3)
        state[7:10] += 0.5 * rng.uniform(-turn, turn, 3)
        state[6:10] /= np.linalg.norm(state[6:10])
        state[10:13] = rng.uniform(-rate, rate, 3)
        self.steps[vehicle] = 0
        self._table[vehicle] = 0.0
        return seed

    def step(self, actions: Array, still: NDArray[np.bool_] | None = None) -> None:
        """One control step: write `rewards`, `lost` and what `observations` returns.

        Parameters
        ----------
        actions: [vehicles, action_width] in double precision; clipped in place to -1 to 1.
        still: [vehicles], true for those whose time stands still.
        """
        loop.command_all(
            self.mode,
            actions,
            self.batch.states,
            self.path,
            self.steps,
            self._settings,
            self._work,
            self._commands,
        )
        self.batch.step(self._commands, self.substeps, still)
        self.steps += 1
        if still is not None:
            self.steps[still] = 0
        self._observe(actions)

    def observations(self) -> NDArray[np.float32]:
        """[vehicles, columns], of now."""
        return self._table[:, self._columns].astype(np.float32)

    def look(self) -> None:
        """Update what `observations` returns after a reset."""
        self._observe(np.ascontiguousarray(self._table[:, 36 : 36 + self.action_width]))

    def _observe(self, actions: Array) -> None:
        observe_all(
            self.batch.states,
            self.path,
            self.steps,
            actions,
            self._settings[loop.MAX_THRUST],
            TARGET_DISTANCE_MAX_M,
            self._table,
            self.rewards,
            self.lost,
        )

    def position_error_m(self) -> Array:
        """[vehicles], distance to the target."""
        distance: Array = np.linalg.norm(self._table[:, :3], axis=1)
        return distance

    def _drawn(self, seed: int) -> SimVehicleConfig:
        """The vehicle with the values that this seed draws. Raises ConfigError for a path outside the vehicle."""
        tree: dict[str, Any] = self._start.model_dump(mode="json")
        for path, value in draw_all((), self._draws, seed, self._scenario).items():
            if not path.startswith(VEHICLE_ROOT):
                raise ConfigError(f"draws: {path}: allowed are paths that start with {VEHICLE_ROOT}")
            _put(tree, path.removeprefix(VEHICLE_ROOT), value)
        return fill(SimVehicleConfig, tree, "draws", VEHICLE_ROOT)


def _beside(threads: int) -> Map:
    """Return a `map` that calls the function for the first argument in this thread, and for the others beside it."""
    pool = ThreadPoolExecutor(threads - 1)

    def run(function: Callable[[Any], int], arguments: Iterable[Any]) -> list[int]:
        first, *others = arguments
        running = [pool.submit(function, one) for one in others]
        return [function(first), *(one.result() for one in running)]

    return run


def _put(tree: Any, path: str, value: Any) -> None:
    """Set the value at a path, in place. Raises ConfigError if it leads nowhere."""
    *above, last = path.split(".")
    try:
        for key in above:
            tree = tree[int(key) if isinstance(tree, list) else key]
        tree[int(last) if isinstance(tree, list) else last] = value
    except (KeyError, IndexError, ValueError, TypeError):
        raise ConfigError(f"draws: {VEHICLE_ROOT}{path}: there is no such value") from None


def _places(observation: Sequence[str]) -> list[tuple[int, int, str]]:
    return [OBSERVATIONS[name] for name in observation]


def _targets(flight: FlightConfig, steps: int, period_s: float) -> Array:
    """[steps + 1, TARGET_SIZE], the path from where it is flown at full speed; of a hover its place."""
    path = Path(flight.onboard.guidance.trajectory)
    start = path.laps_from_s() if path.window_s > 0.0 else path.start_s + 30.0
    rows: Array = np.array([np.concatenate(path.at(start + step * period_s)) for step in range(steps + 1)])
    return rows


def _on_path(target: Array) -> dict[str, Any]:
    position: tuple[float, ...] = tuple(target[:3].tolist())
    return {"position_ned_m": position, "hovering": True}


def _loop_settings(flight: FlightConfig, controller: str) -> Array:
    """[SETTINGS_SIZE] of the inner loop: the nominal airframe, position gains and rate gain of a controller."""
    airframe, S = flight.onboard.airframe, np.zeros(loop.SETTINGS_SIZE)
    settings = read_law(controller).get("settings", {})
    try:
        position, attitude = (settings[channel]["gains"] for channel in ("position", "attitude"))
    except (KeyError, TypeError):
        raise ConfigError(f"controller: {controller}: expected one with position.gains and attitude.gains") from None
    poles = TypeAdapter(tuple[ChannelGains, ChannelGains])
    position, attitude = poles.validate_python(
        tuple({key: tuple(v) if isinstance(v, list) else v for key, v in one.items()} for one in (position, attitude))
    )
    S[loop.MASS], S[loop.GRAVITY] = airframe.mass_kg, GRAVITY
    S[loop.INERTIA : loop.INERTIA + 3] = airframe.inertia_kg_m2
    S[loop.ARM_X], S[loop.ARM_Y] = airframe.arm_x_m, airframe.arm_y_m
    S[loop.TORQUE_RATIO], S[loop.MAX_THRUST] = airframe.yaw_torque_per_thrust_m, airframe.motor_thrust_max_n
    S[loop.MIN_SHARE] = airframe.motor_thrust_min_share
    S[loop.LEAD_UP] = max(airframe.motor_lag_up_s / airframe.motor_response_s, 1.0)
    S[loop.LEAD_DOWN] = max(airframe.motor_lag_down_s / airframe.motor_response_s, 1.0)
    for first, gains in ((loop.POSITION_K1, position), (loop.ATTITUDE_K1, attitude)):
        S[first : first + 3], S[first + 3 : first + 6] = gains.stiffness(), gains.rate_gain()
    # Critically damped: without the feed-forward of the cascade, the controller's own stiffness would be too slow.
    S[loop.ATTITUDE_K1 : loop.ATTITUDE_K1 + 3] = 0.25 * attitude.rate_gain() ** 2
    S[loop.RATES_MAX], S[loop.ACCELERATION_MAX] = RATES_MAX_RAD_S, ACCELERATION_MAX_M_S2
    S[loop.RESIDUAL_MAX] = RESIDUAL_MAX_M_S2
    return S
