"""The Mambo as a Gymnasium environment: one vehicle, or many in one compiled batch."""

from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from async_dmrac.environments.task import Task

Observation: TypeAlias = NDArray[np.float32]
Action: TypeAlias = NDArray[np.float32]


class MamboEnv(gymnasium.Env[Observation, Action]):
    """One vehicle that follows the path of a scenario.

    Parameters
    ----------
    scenario: a name in configs/scenarios, or a file: path, vehicle and disturbances.
    action: "motors", "rates" (collective thrust and body rates), "acceleration" (NED), or "residual" (an acceleration
        that is added to the position loop of `controller`). All parts from -1 to 1.
    observation: names of sim_vehicle.physics.observe.OBSERVATIONS.
    rate_hz: control steps per second. episode_s: until an episode is truncated.
    controller: whose position gains and rate gain the inner loop has (no law of it flies).
    set: values by path. disturbances: added to those of the scenario. draws: as in a campaign file, per episode.
    start_spread: of the start about the path, as a multiple of 0.2 m, 0.2 m/s, 0.1 rad and 0.2 rad/s; 0: none.

    An episode ends (terminated) with a crash, or more than 2.5 m from the target.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 as Gymnasium declares it

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        """Raise ConfigError that names the option, its value and what is allowed."""
        self.render_mode = render_mode
        self.task = Task(1, **options)
        self.observation_space, self.action_space = spaces(self.task)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. seed: of this and all later episodes."""
        super().reset(seed=seed, options=options)
        drawn = self.task.reset(0, self.np_random)
        self.task.look()
        return self.task.observations()[0], {"seed": drawn}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step."""
        task = self.task
        task.step(np.array(action, dtype=np.float64).reshape(1, task.action_width))
        terminated = bool(task.batch.crashed[0] or task.lost[0])
        return (
            task.observations()[0],
            float(task.rewards[0]),
            terminated,
            bool(task.steps[0] >= task.steps_max) and not terminated,
            {},
        )


class MamboVectorEnv(VectorEnv[Observation, Action, NDArray[Any]]):
    """Many vehicles in one compiled batch, each in an episode of its own. Arguments as for MamboEnv.

    threads: that step parts of the batch side by side; the result does not depend on it.

    A vehicle whose episode has ended starts again in the next step (AutoresetMode.NEXT_STEP).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 as Gymnasium declares it
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, num_envs: int = 1, render_mode: str | None = None, **options: Any) -> None:
        """Raise ConfigError that names the option, its value and what is allowed."""
        self.num_envs, self.render_mode = num_envs, render_mode
        self.task = Task(num_envs, **options)
        self.single_observation_space, self.single_action_space = spaces(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._generators: list[np.random.Generator] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode of every vehicle. seed: of vehicle k, seed + k."""
        super().reset(seed=None if isinstance(seed, list) else seed, options=options)
        if isinstance(seed, int):
            seed = [seed + k for k in range(self.num_envs)]
        if seed is not None or not self._generators:
            seeds = seed or [None] * self.num_envs
            self._generators = [np.random.default_rng(one) for one in seeds]
        for vehicle, rng in enumerate(self._generators):
            self.task.reset(vehicle, rng)
        self._ended[:] = False
        self.task.look()
        return self.task.observations(), {}

    def step(self, actions: Action) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """One control step of every vehicle."""
        task, ended = self.task, self._ended
        again = np.flatnonzero(ended).tolist()
        for vehicle in again:
            task.reset(vehicle, self._generators[vehicle])
        own = np.array(actions, dtype=np.float64)
        own[again] = 0.0
        task.step(own, ended.copy() if again else None)
        rewards, terminated = task.rewards.copy(), task.batch.crashed | task.lost
        rewards[again] = 0.0
        truncated = (task.steps >= task.steps_max) & ~terminated
        self._ended = terminated | truncated
        return task.observations(), rewards, terminated, truncated, {}


def spaces(task: Task) -> tuple[Any, Any]:
    """Of what is seen, and of actions."""
    seen = Box(-np.inf, np.inf, (len(task.observation_names),), dtype=np.float32)
    return seen, Box(-1.0, 1.0, (task.action_width,), dtype=np.float32)
