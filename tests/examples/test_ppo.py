"""The PPO agent: what it sees and commands in the full system is what it saw and commanded in training."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import async_dmrac
import sim_vehicle.physics.inner_loop as loop
from async_dmrac.environments.task import Task
from configs.flight_tree import read_law

ROOT = Path(__file__).resolve().parents[2]
PPO = ROOT / "examples" / "ppo"
OBSERVATION = ("position_error", "velocity_error", "rotation", "rates", "last_action")


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"ppo_{name}", PPO / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.fixture
def task() -> Task:
    task = Task(1, action="rates", observation=OBSERVATION, rate_hz=100.0)
    task.reset(0, np.random.default_rng(3))
    task.look()
    for action in ([0.1, 0.2, -0.1, 0.3], [0.0, -0.3, 0.2, 0.1]):
        task.step(np.array([action]))
    return task


@pytest.fixture
def policy() -> Any:
    found, airframe = module("policy"), async_dmrac.configure("hover").onboard.airframe
    settings = found.Policy.Settings(rate_gain=tuple(read_law(str(PPO / "controller.yaml"))["settings"]["rate_gain"]))
    return found.Policy(settings, airframe, 1)


def inputs_of(task: Task) -> Any:
    """The state and the target of the task's vehicle, as onboard gives them to a controller."""
    x, seen = task.batch.states[0], task.observations()[0]
    state = SimpleNamespace(position=x[:3], velocity=x[3:6], rotation=seen[6:15].reshape(3, 3), rates=x[10:13])
    target = task.path[min(task.steps[0], len(task.path) - 1)]
    now = SimpleNamespace(position=tuple(target[:3]), velocity=tuple(target[3:6]))
    return SimpleNamespace(state=state, target=SimpleNamespace(now=now))


def test_it_sees_in_flight_what_it_saw_in_training(task: Task, policy: Any) -> None:
    policy.action = np.array([0.0, -0.3, 0.2, 0.1])
    assert policy.observation(inputs_of(task)) == pytest.approx(task.observations()[0], abs=1e-6)


def test_an_action_commands_in_flight_what_it_commanded_in_training(task: Task, policy: Any) -> None:
    action, settings, state = np.array([0.1, 0.2, -0.3, 0.1]), task._settings, task.batch.states[0]
    policy.act = lambda seen: action
    output = policy.step(inputs_of(task))
    alpha = policy.gain * (6.0 * action[1:] - state[10:13])
    assert output.torque_nm == pytest.approx(loop.torque_for(tuple(alpha), state, settings))
    assert output.thrust_n == pytest.approx(2.0 * 1.1 * settings[loop.MAX_THRUST])


def test_the_shipped_policy_hovers_in_the_full_system(tmp_path: Path) -> None:
    flight = async_dmrac.fly("hover", str(PPO / "controller.yaml"), seed=3, duration_s=12.0, out=tmp_path / "flight")
    assert flight.survived
    assert flight.metrics.position_rmse_m < 0.1


def test_the_controller_needs_no_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from configs.flight_tree import read_law; from configs.user_class import find_class\n"
        f"assert find_class(read_law({str(PPO / 'controller.yaml')!r})['class']).__name__ == 'Policy'\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_the_weights_that_are_written_are_those_of_the_trained_policy(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    import stable_baselines3
    from stable_baselines3.common.vec_env import VecNormalize

    from async_dmrac.environments.stable_baselines import MamboBatch

    train = module("train")
    env = VecNormalize(MamboBatch(4, action="rates", observation=OBSERVATION, rate_hz=100.0, episode_s=0.5))
    agent = stable_baselines3.PPO(
        "MlpPolicy", env, n_steps=64, batch_size=64, policy_kwargs={"net_arch": [8, 8]}, device="cpu"
    )
    agent.learn(512)
    train.save(agent, env, tmp_path / "policy.npz")
    found = module("policy").Policy
    settings = found.Settings(file=str(tmp_path / "policy.npz"), rate_gain=(1.0, 1.0, 1.0))
    seen = np.random.default_rng(1).normal(size=22)
    own = found(settings, async_dmrac.configure("hover").onboard.airframe, 1)
    expected, _ = agent.predict(env.normalize_obs(seen), deterministic=True)
    assert own.act(seen) == pytest.approx(expected, abs=1e-5)


def test_an_episode_of_the_batch_ends_and_starts_again_in_the_same_step() -> None:
    pytest.importorskip("stable_baselines3")
    from async_dmrac.environments.stable_baselines import MamboBatch

    batch = MamboBatch(3, action="rates", observation=("position",), rate_hz=100.0, episode_s=0.3, start_spread=0.5)
    batch.reset()
    for step in range(1, 31):
        seen, _, ended, infos = batch.step(np.zeros((3, 4), dtype=np.float32))
        assert ended.tolist() == [step == 30] * 3
    assert all(info["TimeLimit.truncated"] and info["episode"]["l"] == 30 for info in infos)
    assert not np.allclose(seen, [info["terminal_observation"] for info in infos])
    assert batch.step(np.zeros((3, 4), dtype=np.float32))[2].tolist() == [False] * 3


def test_in_training_an_action_takes_effect_a_step_late_and_is_seen_meanwhile() -> None:
    pytest.importorskip("stable_baselines3")
    options: Any = {"action": "rates", "observation": OBSERVATION, "rate_hz": 50.0, "start_spread": 0.0}
    train = module("train")
    late, prompt = train.DelayedBatch(2, **options), train.MamboBatch(2, **options)
    late.reset()
    prompt.reset()
    first, second = np.full((2, 4), 0.3, dtype=np.float32), np.full((2, 4), -0.2, dtype=np.float32)
    seen = late.step(first)[0]
    assert seen[:, -4:] == pytest.approx(first)
    assert seen[:, :-4] == pytest.approx(prompt.step(np.zeros((2, 4)))[0][:, :-4])
    assert late.step(second)[0][:, :-4] == pytest.approx(prompt.step(first)[0][:, :-4])
