# %% [markdown]
# # Bending moments, cycles and damage
#
# With `[structure] stiffness` in the installation, results contain bending moments with their standard deviation:
# `store["f0003"].moments`. Here a gust history of known noise stands for live results at 50 per second.

# %%
import numpy as np
import pandas as pd

import wingd

seconds = np.arange(0, 60, 0.02)
rng = np.random.default_rng(1)
moment = (
    1e6
    + 6e4 * np.sin(2 * np.pi * 1.2 * seconds) * np.exp(-(((seconds - 30) / 15) ** 2))
    + rng.normal(size=len(seconds)) * 1e3
)
moments = pd.DataFrame(
    {
        "time": pd.Timestamp("2026-06-01T08:00:00Z") + pd.to_timedelta(seconds, unit="s"),
        "s_m": 10.0,
        "moment_nm": moment,
        "sigma_moment_nm": np.hypot(1e3, 0.036 * moment),
        "sigma_by_stiffness_nm": 0.036 * moment,
    }
)
wingd.loads.extremes(moments)

# %%
cycles = wingd.loads.rainflow(moments, bending_hz=1.2)
damage = wingd.loads.damage(moments, bending_hz=1.2)
print(cycles[cycles.significant].head(), damage, sep="\n")
assert 1 < damage["relative"][0] < 1.1

# %%
from wingd import plot  # noqa: E402

spectrum = wingd.spectrum(moments)
plot.draw_moments(moments).figure.savefig("moments.png")
plot.draw_spectrum(spectrum, unit="N m").figure.savefig("spectrum.png")
assert abs(spectrum.loc[spectrum["density"].idxmax(), "frequency_hz"] - 1.2) < 0.1
