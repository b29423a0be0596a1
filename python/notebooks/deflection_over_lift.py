# %% [markdown]
# # Deflection over lift, with its band
#
# How much does the tip rise per unit of lift? The errors of the installation are common to all frames and cancel in the slope.

# %%
import os

import numpy as np

import wingd

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
frames = store["f0001"].frames()
tip = frames.wingd.displacement("z").sel(eta=1.0)
tip

# %% [markdown]
# Without aircraft data the time stands for the weight, which falls as fuel burns. With them: `x = frames["weight_kg"].values / 1e3`.

# %%
x = (frames["time"].values - frames["time"].values[0]) / np.timedelta64(1, "h")
design = np.stack([np.ones_like(x), x - x.mean()], axis=1)
weights = np.linalg.pinv(design)
trend = sum((tip.isel(frame=k) * weights[1, k] for k in range(1, len(x))), tip.isel(frame=0) * weights[1, 0])
print(f"{float(trend.value):.4f} ± {float(trend.sigma):.4f} m per hour; the tip alone ± {float(tip.sigma[0]):.4f} m")
assert float(trend.sigma) < 0.2 * float(tip.sigma[0])

# %%
ax = tip.plot(marker="o", linestyle="")
ax.set_title("Tip displacement of the demonstration's flight")
ax.figure.savefig("deflection.png")
