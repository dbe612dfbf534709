# %% [markdown]
# # A first flight
# Fly the same gust of a fan's jet with two controllers, and look at the record.

# %%
import async_dmrac

options = {"seed": 3, "duration_s": 25.0, "core": "c"}
flights = {
    name: async_dmrac.fly("figure8_wind", name, out=f"first_flight/{name}", **options) for name in ("pid", "dmrac")
}

# %% [markdown]
# ## Metrics, and arrays with names and units

# %%
for name, flight in flights.items():
    print(f"{name:6} position RMSE {flight.metrics.position_rmse_m:.3f} m, alive: {flight.survived}")

tick = flights["dmrac"]["onboard/tick"]
print(tick["position_n"].shape, tick.units["position_n"], "from", tick.time_s[0], "to", tick.time_s[-1], "s")

# %% [markdown]
# ## Events and a figure

# %%
for event in flights["dmrac"].events[:3]:
    print(event.process, event.text)
figure = flights["dmrac"].figure()
figure.savefig("first_flight/dmrac.png")
figure
