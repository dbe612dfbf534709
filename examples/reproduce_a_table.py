# %% [markdown]
# # Reproduce one table of the results
# The results fly every condition with a hundred seeds. Here one condition of one campaign is flown again with two of
# them: three controllers hover, and a rotor loses a part of its thrust. The table has the columns of docs/results.md.

# %%
import async_dmrac

settings = async_dmrac.campaign_file("rotor_chip")
settings["controllers"] = ["none", "pid", "dmrac"]
settings["sweeps"][0]["values"] = [0.7]  # thrust left on the chipped rotor
settings["figures"] = []

# %% [markdown]
# The flights run in processes. In a script they import the script, so the call is below the usual condition. More seeds
# can follow later into the same folder, with `resume=True`.

# %%
if __name__ == "__main__":
    flights = async_dmrac.campaign(settings, seeds=2, jobs=2, core="c", out="reproduce_a_table")
    print(f"{flights.flown} flights, {flights.lost} vehicles lost, {flights.errors} could not be flown")
    print(flights.tables())
    for controller, errors in flights.groups("after_onset_rmse_m", by=("controller",)).items():
        print(f"{controller[0]:6} position RMSE in the 4 s after the chip, m: {errors.round(3)}")
