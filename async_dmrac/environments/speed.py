"""Measures how many control steps per second the environments make."""

from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any, Final

import gymnasium
import numpy as np

from async_dmrac.environments.registration import ENVIRONMENT, register
from runtime.kernel import cores

BATCH: Final = 100
CALLS: Final = {1: 20, BATCH: 2}
"""Calls of `step` in a run, by vehicles; the fastest run counts, which the rest of the machine disturbed least."""
ACTION: Final = -0.05
"""Near hover, as thrust."""


@dataclass(frozen=True, slots=True)
class Speed:
    """Of an environment: the best of the runs."""

    steps_s: float
    """Control steps per second, of all vehicles together."""
    processor_us: float
    """Processor time of a step of one vehicle, us, of all threads together."""


def environment_speeds(runs: int = 200) -> dict[str, Speed]:
    """Return the speed of one vehicle, and of a batch with one thread and with one per core.

    Every step is complete: action, five sub-steps of physics, observation, reward, and the starts of new episodes.
    """
    register()
    speeds = {}
    for action in ("motors", "rates"):
        single = gymnasium.make(ENVIRONMENT, action=action, disable_env_checker=True)
        speeds[f"{action}, gymnasium.make"] = _speed(single, 1, runs)
        speeds[f"{action}, without wrappers"] = _speed(single.unwrapped, 1, runs)
        for threads in dict.fromkeys((1, min(cores(), 2))):
            many = gymnasium.make_vec(
                ENVIRONMENT, num_envs=BATCH, vectorization_mode="vector_entry_point", action=action, threads=threads
            )
            name = f"{action}, batch of {BATCH}, {threads} thread{'s' * (threads > 1)}"
            speeds[name] = _speed(many, BATCH, runs)
    return speeds


def _speed(env: Any, vehicles: int, runs: int) -> Speed:
    actions = np.zeros(env.action_space.shape, dtype=np.float32)
    actions[..., 0] = ACTION
    env.reset(seed=1)
    wall_s = processor_s = np.inf
    for _ in range(runs):
        if vehicles == 1:  # a batch starts its episodes again by itself
            env.reset()
        start = perf_counter(), process_time()
        for _ in range(CALLS[vehicles]):
            env.step(actions)
        wall_s = min(wall_s, perf_counter() - start[0])
        processor_s = min(processor_s, process_time() - start[1])
    steps = vehicles * CALLS[vehicles]
    return Speed(float(steps / wall_s), float(1e6 * processor_s / steps))
