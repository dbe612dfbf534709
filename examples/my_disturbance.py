# %% [markdown]
# # A disturbance of my own
# A record of settings with `act`, which runs in every sub-step of 1 ms. Numba compiles it where it is installed, so it
# may use numbers, arrays and `math` only.

# %%
from math import sin

import async_dmrac
from async_dmrac import Disturbance, Field
from async_dmrac.geometry import Vector3
from async_dmrac.physics import FORCE


class Sway(Disturbance):
    """A force that swings: a load on a string, seen from the vehicle."""

    amplitude_ned_n: Vector3
    frequency_hz: float = Field(gt=0.0)

    def values(self):
        return (*self.amplitude_ned_n, 6.283185307179586 * self.frequency_hz)

    @staticmethod
    def act(v, memory, time_s, state, P, noise, effect):
        s = sin(v[3] * time_s)
        effect[FORCE] += v[0] * s
        effect[FORCE + 1] += v[1] * s
        effect[FORCE + 2] += v[2] * s


# %% [markdown]
# ## The same force for two controllers

# %%
sway = Sway(onset_s=6.0, amplitude_ned_n=(0.08, 0.0, 0.0), frequency_hz=0.5)
for name in ("none", "l1"):
    out = f"my_disturbance/{name}"
    flight = async_dmrac.fly("hover", name, seed=3, disturbances=[sway], duration_s=15.0, core="c", out=out)
    force = flight["sim_vehicle/truth"]["disturbance_force_n"]
    print(f"{name:5} largest force {abs(force).max():.3f} N, position RMSE {flight.metrics.position_rmse_m:.3f} m")
