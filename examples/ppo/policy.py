"""A policy of train.py as a controller of the full system. It needs numpy only; torch stays with the training."""

from pathlib import Path

import numpy as np

from async_dmrac import ConfigRecord, ControlInputs, ControlOutput, Field

TICKS = 4
"""Ticks of 5 ms from one action to the next: 50 actions a second, as in the training."""
RATES_MAX_RAD_S = 6.0
"""Body rate that an action of 1 commands, as in the environment."""


class Policy:
    """Collective thrust and body rates from a trained network, and a rate loop."""

    class Settings(ConfigRecord):
        file: str = Field(default="policy.npz", description="of train.py; a relative path counts from this file")
        rate_gain: tuple[float, float, float] = Field(description="1/s, roll, pitch, yaw")

    def __init__(self, settings: Settings, airframe, seed: int) -> None:
        with np.load(Path(__file__).parent / settings.file) as arrays:
            self.offset, self.scale, self.clip = arrays["offset"], arrays["scale"], float(arrays["clip"])
            layers = sum(name.startswith("weight_") for name in arrays.files)
            self.layers = [(arrays[f"weight_{k}"], arrays[f"bias_{k}"]) for k in range(layers)]
        self.gain = np.array(settings.rate_gain)
        self.inertia = np.array(airframe.inertia_kg_m2)
        self.motor_thrust_n = airframe.motor_thrust_max_n
        self.action, self.ticks = np.zeros(4), 0

    def reset(self, inputs: ControlInputs) -> None:
        self.action, self.ticks = np.zeros(4), 0

    def act(self, seen) -> np.ndarray:
        """The action [4], each from -1 to 1, that the network chooses for an observation [22]."""
        x = np.clip((seen - self.offset) / self.scale, -self.clip, self.clip)
        for number, (weight, bias) in enumerate(self.layers):
            x = weight @ x + bias
            if number < len(self.layers) - 1:
                x = np.tanh(x)
        return np.clip(x, -1.0, 1.0)

    def observation(self, inputs: ControlInputs) -> np.ndarray:
        """What the policy saw in training: OBSERVATION of train.py."""
        state, now = inputs.state, inputs.target.now
        return np.concatenate(
            [
                np.array(now.position) - state.position,
                np.array(now.velocity) - state.velocity,
                state.rotation.ravel(),
                state.rates,
                self.action,
            ]
        )

    def step(self, inputs: ControlInputs) -> ControlOutput:
        if self.ticks % TICKS == 0:
            self.action = self.act(self.observation(inputs))
        self.ticks += 1
        rates, J = np.array(inputs.state.rates), self.inertia
        torque = J * self.gain * (RATES_MAX_RAD_S * self.action[1:] - rates) + np.cross(rates, J * rates)
        thrust = 2.0 * (self.action[0] + 1.0) * self.motor_thrust_n
        roll, pitch, yaw = torque.tolist()
        return ControlOutput(thrust_n=float(thrust), torque_nm=(roll, pitch, yaw))
