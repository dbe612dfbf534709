"""Measures how many control steps per second the environments make."""

from time import perf_counter
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


def environment_speeds(runs: int = 200) -> dict[str, float]:
    """Return control steps per second: of one vehicle, and of a batch with one thread and with one per core.

    Every step is complete: action, five sub-steps of physics, observation, reward, and the starts of new episodes.
    """
    register()
    speeds = {}
    for action in ("motors", "rates"):
        single = gymnasium.make(ENVIRONMENT, action=action, disable_env_checker=True)
        speeds[f"{action}, gymnasium.make"] = _single(single, runs)
        speeds[f"{action}, without wrappers"] = _single(single.unwrapped, runs)
        for threads in dict.fromkeys((1, min(cores(), 2))):
            speeds[f"{action}, batch of {BATCH}, {threads} thread{'s' * (threads > 1)}"] = _batch(action, threads, runs)
    return speeds


def _single(env: Any, runs: int) -> float:
    action = np.full(4, 0.0, dtype=np.float32)
    action[0] = ACTION
    env.reset(seed=1)
    best = 0.0
    for _ in range(runs):
        env.reset()
        start = perf_counter()
        for _ in range(CALLS[1]):
            env.step(action)
        best = max(best, CALLS[1] / (perf_counter() - start))
    return best


def _batch(action: str, threads: int, runs: int) -> float:
    env = gymnasium.make_vec(
        ENVIRONMENT, num_envs=BATCH, vectorization_mode="vector_entry_point", action=action, threads=threads
    )
    actions = np.zeros((BATCH, 4), dtype=np.float32)
    actions[:, 0] = ACTION
    env.reset(seed=1)
    best = 0.0
    for _ in range(runs):
        start = perf_counter()
        for _ in range(CALLS[BATCH]):
            env.step(actions)
        best = max(best, BATCH * CALLS[BATCH] / (perf_counter() - start))
    return best
