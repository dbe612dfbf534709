# %% [markdown]
# # A controller of my own
# A class with `Settings`, `reset` and `step`, written where it is used: in a notebook, or in any file. It gets the
# estimated state and the target, and returns thrust and torque. Mixer, estimator and flight modes stay the same.

# %%
import numpy as np

import async_dmrac
from async_dmrac import ConfigRecord, ControlInputs, ControlOutput, Field
from async_dmrac.geometry import (
    GRAVITY,
    attitude_for_thrust,
    quaternion_multiply,
    quaternion_to_rotation_vector,
)


class MyController:
    """Proportional-derivative control of position and attitude."""

    class Settings(ConfigRecord):
        position_gain: float = Field(gt=0, description="1/s^2")
        velocity_gain: float = Field(gt=0, description="1/s")
        angle_gain: float = Field(gt=0, description="1/s^2")
        rate_gain: float = Field(gt=0, description="1/s")

    def __init__(self, settings: Settings, airframe, seed: int) -> None:
        self.settings, self.airframe = settings, airframe
        self.inertia = np.array(airframe.inertia_kg_m2)

    def reset(self, inputs: ControlInputs) -> None:
        """Nothing to forget."""

    def step(self, inputs: ControlInputs) -> ControlOutput:
        state, target, gains = inputs.state, inputs.target, self.settings
        u = gains.position_gain * (np.array(target.now.position) - state.position)
        u += gains.velocity_gain * (np.array(target.now.velocity) - state.velocity) + target.feed_forward
        force = np.array([0.0, 0.0, GRAVITY]) - np.clip(u, -4.0, 4.0)  # along body down, per mass
        down = force / np.linalg.norm(force)
        w, x, y, z = state.quaternion
        commanded = attitude_for_thrust(tuple(down), target.yaw_rad)
        turn = np.array(quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded)))
        roll, pitch, yaw = self.inertia * (gains.angle_gain * turn - gains.rate_gain * state.rates)
        thrust = self.airframe.mass_kg * float(force @ state.rotation[:, 2])
        return ControlOutput(thrust_n=max(thrust, 0.0), torque_nm=(roll, pitch, yaw))


# %% [markdown]
# ## Fly it

# %%
settings = {"position_gain": 12.0, "velocity_gain": 5.0, "angle_gain": 150.0, "rate_gain": 20.0}
flight = async_dmrac.fly(
    "figure8_calm", MyController, seed=3, settings=settings, duration_s=15.0, out="my_controller/flight"
)
print(f"position RMSE {flight.metrics.position_rmse_m:.3f} m, alive: {flight.survived}")

# %% [markdown]
# From the command line, with the class in a file: `dmrac fly figure8_calm --controller my.yaml`, where `my.yaml` holds
# `class: my_controller.py:MyController` and the settings.
