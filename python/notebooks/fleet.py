# %% [markdown]
# # A fleet: equal loads, equal shapes?
#
# Shapes of several flights are compared at fixed fractions of the wing's length, with factors: what flights of one installation share does not
# become smaller in a mean. The table `shape` of a lake (`wingd-fleet query`) has the same columns. Here the series of the demonstration are the
# flights, and one store stands for the lake.

# %%
import os

import pandas as pd

import wingd
from wingd.values import concat

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
series = sorted({name.partition("/")[0] for name in store["f0001"].frames()["image"].values})
shapes = {name: store["f0001"].shape(name).wingd.displacement("z").sel(eta=[0.25, 0.5, 0.75, 1.0]) for name in series}
table = pd.concat(
    {name: values.to_pandas()[["eta", "displacement_z_m", "sigma_displacement_z_m"]] for name, values in shapes.items()}
)
print(table.to_string())

# %%
mean = concat(list(shapes.values())).mean()
single = shapes[series[0]].sigma.values[-1]
print(
    f"sigma of one series {single:.4f} m, of the mean of {len(series)} {mean.sigma.values[-1]:.4f} m: most of it is common"
)
assert mean.sigma.values[-1] > 0.8 * single

# %%
import matplotlib.pyplot as plt  # noqa: E402

plt.style.use(wingd.plot.STYLE)
figure, axes = plt.subplots()
for name, values in shapes.items():
    values.plot(ax=axes, label=name)
figure.savefig("fleet.png")
