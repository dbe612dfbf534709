"""The compiled batch of vehicles as a vector environment of stable-baselines3, which has an interface of its own."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from async_dmrac.environments.mambo import Action, Observation, spaces
from async_dmrac.environments.task import Task


class MamboBatch(VecEnv):  # type: ignore[misc]
    """Many vehicles, each in an episode of its own: `PPO("MlpPolicy", MamboBatch(100, action="rates"))`.

    A vehicle whose episode has ended starts again in the same step, as stable-baselines3 expects it: the last
    observation of the episode is in `infos[k]["terminal_observation"]`.
    """

    def __init__(self, vehicles: int, *, seed: int = 1, **options: Any) -> None:
        """options: those of MamboEnv. Raises ConfigError that names the option, its value and what is allowed."""
        self.task, self.render_mode = Task(vehicles, **options), None
        super().__init__(vehicles, *spaces(self.task))
        self._rng = np.random.default_rng(seed)
        self._actions = np.zeros((vehicles, self.task.action_width))
        self._returns = np.zeros(vehicles)

    def reset(self) -> Observation:
        """Start an episode of every vehicle."""
        for vehicle in range(self.num_envs):
            self.task.reset(vehicle, self._rng)
        self._returns[:] = 0.0
        self.task.look()
        return self.task.observations()

    def step_async(self, actions: Action) -> None:
        """Take the actions of the next step, [vehicles, action_width]."""
        self._actions[:] = actions

    def step_wait(self) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One control step of every vehicle."""
        task = self.task
        task.step(self._actions)
        rewards, terminated = task.rewards.astype(np.float32), task.batch.crashed | task.lost
        truncated = (task.steps >= task.steps_max) & ~terminated
        self._returns += task.rewards
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = terminated | truncated
        if ended.any():
            last = task.observations()
            for vehicle in np.flatnonzero(ended).tolist():
                infos[vehicle] = {
                    "terminal_observation": last[vehicle],
                    "TimeLimit.truncated": bool(truncated[vehicle]),
                    "episode": {"r": float(self._returns[vehicle]), "l": int(task.steps[vehicle]), "t": 0.0},
                }
                self._returns[vehicle] = 0.0
                task.reset(vehicle, self._rng)
            task.look()
        return task.observations(), rewards, ended, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of this object, once for each vehicle."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not allowed: the vehicles share one object. Raises AttributeError."""
        raise AttributeError(f"{attr_name}: the vehicles of a batch share their options")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Not allowed: there is no environment of one vehicle. Raises AttributeError."""
        raise AttributeError(f"{method_name}: a batch has no environment of one vehicle")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Sequence[bool]:
        """False for each vehicle."""
        return [False] * len(list(self._get_indices(indices)))
