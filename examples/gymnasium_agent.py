# %% [markdown]
# # A Gymnasium agent
# An agent learns to hold the vehicle in the simulated wind of its training, a hundred vehicles at a time, by the
# cross-entropy method. Then it flies in the full system, with estimator, radio and motors, against DMRAC.

# %%
import gymnasium
import numpy as np

import async_dmrac
import async_dmrac.environments  # registers async_dmrac/Mambo-v0
from async_dmrac import ConfigRecord, ControlInputs, ControlOutput
from async_dmrac.geometry import GRAVITY, attitude_for_thrust, quaternion_multiply, quaternion_to_rotation_vector

AGENTS, STEPS, ROUNDS = 100, 300, 6
LIMIT_M_S2 = 5.0
env = gymnasium.make_vec(
    "async_dmrac/Mambo-v0",
    num_envs=AGENTS,
    vectorization_mode="vector_entry_point",
    action="acceleration",
    observation=("position_error", "velocity_error"),
    draws=[{"path": "vehicle.body.mass_kg", "uniform": [0.058, 0.072]}],
)

# %% [markdown]
# ## Cross-entropy method over two gains: acceleration = (a e + b e_dot) / limit

# %%
rng = np.random.default_rng(1)
mean, spread = np.array([2.0, 1.0]), np.array([3.0, 2.0])
for number in range(ROUNDS):
    gains = np.abs(mean + spread * rng.standard_normal((AGENTS, 2)))
    seen, _ = env.reset(seed=number)
    returns, alive = np.zeros(AGENTS), np.ones(AGENTS, dtype=bool)
    for _ in range(STEPS):
        actions = (gains[:, :1] * seen[:, :3] + gains[:, 1:] * seen[:, 3:]) / LIMIT_M_S2
        seen, rewards, terminated, _, _ = env.step(np.clip(actions, -1.0, 1.0).astype(np.float32))
        alive &= ~terminated
        returns += rewards * alive
    best = gains[np.argsort(returns)[-AGENTS // 5 :]]
    mean, spread = best.mean(axis=0), best.std(axis=0) + 0.05
    print(f"round {number}: mean reward of a step {returns.mean() / STEPS:.3f}, gains {mean.round(2)}")


# %% [markdown]
# ## The agent as a controller of the full system


# %%
class Agent:
    """The learnt gains, and an attitude loop."""

    class Settings(ConfigRecord):
        gains: tuple[float, float]

    def __init__(self, settings: Settings, airframe, seed: int) -> None:
        self.gains, self.airframe = settings.gains, airframe
        self.inertia = np.array(airframe.inertia_kg_m2)

    def reset(self, inputs: ControlInputs) -> None:
        """Nothing to forget."""

    def step(self, inputs: ControlInputs) -> ControlOutput:
        state, target = inputs.state, inputs.target
        u = self.gains[0] * (np.array(target.now.position) - state.position)
        u += self.gains[1] * (np.array(target.now.velocity) - state.velocity)
        force = np.array([0.0, 0.0, GRAVITY]) - np.clip(u, -LIMIT_M_S2, LIMIT_M_S2)
        commanded = attitude_for_thrust(tuple(force / np.linalg.norm(force)), target.yaw_rad)
        w, x, y, z = state.quaternion
        turn = np.array(quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded)))
        roll, pitch, yaw = self.inertia * (130.0 * turn - 30.0 * state.rates)
        thrust = self.airframe.mass_kg * float(force @ state.rotation[:, 2])
        return ControlOutput(thrust_n=max(thrust, 0.0), torque_nm=(roll, pitch, yaw))


for name, controller, settings in (("agent", Agent, {"gains": tuple(mean.tolist())}), ("dmrac", "dmrac", None)):
    out = f"gymnasium_agent/{name}"
    flight = async_dmrac.fly("hover", controller, seed=3, settings=settings, duration_s=15.0, out=out)
    print(f"{name:6} position RMSE {flight.metrics.position_rmse_m:.3f} m, alive: {flight.survived}")
