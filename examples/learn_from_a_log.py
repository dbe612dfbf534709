# %% [markdown]
# # Learn from my own flight log
# The learner alone, on the samples of a recorded flight: where the vehicle is and how it moves, and which acceleration
# its motors do not explain. Any other log works in the same way: named columns in, named columns out.

# %%
import numpy as np

import async_dmrac

RATE_HZ = 50.0
flight = async_dmrac.fly("figure8_wind", "bias", seed=3, duration_s=35.0, core="c", out="learn_from_a_log/flight")

# %% [markdown]
# ## Samples: every fourth tick on the path

# %%
tick = flight["onboard/tick"]
rows = np.flatnonzero(flight.trace.on_path)[::4]
inputs = [f"{name}_{axis}" for name in ("position", "velocity") for axis in "ned"]
outputs = [f"position_residual_{axis}" for axis in "ned"]
signals, labels = ({name: tick[name][rows] for name in names} for names in (inputs, outputs))
half = len(rows) // 2


def part(table, rows):
    return {name: column[rows] for name, column in table.items()}


# %% [markdown]
# ## Off line: train on the first half

# %%
learner = async_dmrac.Learner(inputs, outputs, rate_hz=RATE_HZ)
fit = learner.fit(part(signals, slice(None, half)), part(labels, slice(None, half)))
print("held-out RMSE by output, m/s^2:", {name: round(value, 3) for name, value in fit.rmse.items()})


def rmse(found, where):
    truth = np.column_stack([labels[name][where] for name in outputs])
    return float(np.sqrt(np.square(found - truth).sum(axis=1).mean()))


# %% [markdown]
# ## On line: the last layer follows the second half; each prediction is made before its sample is seen

# %%
second = slice(half, None)
map_alone = rmse(learner.predict(part(signals, second)), second)
ahead = []
for row in range(half, len(rows)):
    ahead.append(learner.predict(part(signals, row)))
    learner.update(part(signals, row), part(labels, row))
mean = np.mean([labels[name][:half] for name in outputs], axis=1)
print(f"error on the second half, m/s^2: mean {rmse(mean, second):.2f}, trained map {map_alone:.2f}, ", end="")
print(f"with the last layer on line {rmse(np.array(ahead), second):.2f}")

# %% [markdown]
# ## Train again on what was seen meanwhile, and swap without a jump

# %%
plan = learner.swap(learner.fit(rounds=5, use=False))
print("swap:", plan.refusal or "done", f"largest change {plan.jump:.2f} of the usual size")
