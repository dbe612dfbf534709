"""Train a policy to hover with stable-baselines3's PPO, and write it as numpy arrays: policy.npz beside this file.

    pip install 'async-dmrac[rl]'
    python examples/ppo/train.py --seconds 300

A hundred vehicles fly at once. Each episode draws the vehicle and the wind. The policy sees what OBSERVATION names and
commands collective thrust and body rates, 50 times a second. A command takes effect 20 ms late.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from async_dmrac.environments.stable_baselines import MamboBatch
from async_dmrac.physics import Wind

OBSERVATION = ("position_error", "velocity_error", "rotation", "rates", "last_action")
RATE_HZ = 50.0
"""Motors hold their command for 20 ms."""


class DelayedBatch(MamboBatch):
    """The batch, where an action takes effect a step late: sensors, estimator and motors delay it in flight.

    `last_action`, the end of the observation, is the action that waits, as in flight.
    """

    def __init__(self, vehicles: int, **options: Any) -> None:
        super().__init__(vehicles, **options)
        self._waiting = np.zeros_like(self._actions)

    def reset(self) -> Any:
        self._waiting[:] = 0.0
        return super().reset()

    def step_async(self, actions: Any) -> None:
        self._actions[:] = self._waiting
        self._waiting[:] = np.clip(actions, -1.0, 1.0)

    def step_wait(self) -> Any:
        seen, rewards, ended, infos = super().step_wait()
        self._waiting[ended] = 0.0
        seen[:, -self._waiting.shape[1] :] = self._waiting
        return seen, rewards, ended, infos


class Budget(BaseCallback):
    """Stops after so many seconds of computing time. Every ten of them, it prints the mean reward and saves."""

    def __init__(self, seconds: float, out: Path) -> None:
        super().__init__()
        self.seconds, self.out, self.start, self.shown = seconds, out, time.process_time(), 0.0

    def _on_step(self) -> bool:
        return time.process_time() - self.start < self.seconds

    def _on_rollout_end(self) -> None:
        used = time.process_time() - self.start
        if used - self.shown > 10.0 and self.model.ep_info_buffer:
            self.shown = used
            save(self.model, self.training_env, self.out)
            reward = np.mean([one["r"] / one["l"] for one in self.model.ep_info_buffer])
            steps = np.mean([one["l"] for one in self.model.ep_info_buffer])
            print(
                f"{used:4.0f} s, {self.num_timesteps:8d} steps: reward {reward:.3f} a step, episode {steps:.0f} steps",
                flush=True,
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=300.0, help="computing time (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("policy.npz"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    batch = DelayedBatch(
        100,
        seed=arguments.seed,
        action="rates",
        observation=OBSERVATION,
        rate_hz=RATE_HZ,
        episode_s=5.0,
        disturbances=[Wind(velocity_ned_m_s=(0.0, 0.0, 0.0))],
        draws=[
            {"vehicle": "tuning", "thrust_to_weight": 1.9},
            {"path": "vehicle.disturbances.0.velocity_ned_m_s.0", "uniform": [-2.0, 2.0]},
            {"path": "vehicle.disturbances.0.velocity_ned_m_s.1", "uniform": [-2.0, 2.0]},
        ],
        start_spread=1.5,
    )
    env = VecNormalize(batch, norm_obs=True, norm_reward=True, gamma=0.98)
    agent = PPO(
        "MlpPolicy",
        env,
        n_steps=64,
        batch_size=1600,
        n_epochs=5,
        learning_rate=1e-3,
        gamma=0.98,
        gae_lambda=0.95,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        seed=arguments.seed,
        device="cpu",
    )
    agent.learn(10**9, callback=Budget(arguments.seconds, arguments.out))
    save(agent, env, arguments.out)
    print(f"written: {arguments.out}, after {agent.num_timesteps} steps")


def save(agent: PPO, env: VecNormalize, out: Path) -> None:
    """Write the layers of the policy and the scaling of its inputs."""
    layers = [one for one in agent.policy.mlp_extractor.policy_net if isinstance(one, torch.nn.Linear)]
    arrays = {"offset": env.obs_rms.mean, "scale": np.sqrt(env.obs_rms.var + env.epsilon)}
    for number, layer in enumerate([*layers, agent.policy.action_net]):
        arrays[f"weight_{number}"] = layer.weight.detach().numpy()
        arrays[f"bias_{number}"] = layer.bias.detach().numpy()
    arrays["clip"] = np.array(env.clip_obs)
    np.savez_compressed(out, **{name: np.asarray(value, dtype=np.float32) for name, value in arrays.items()})


if __name__ == "__main__":
    main()
