# %% [markdown]
# # Before and after a repair
#
# Two series of one flight: the errors of installation and flight cancel. Of two flights those of the installation do.

# %%
import os

import wingd

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
flight = store["f0001"]
before, after = flight.shape("s000001"), flight.shape("s000002")
difference = before.wingd.displacement("z") - after.wingd.displacement("z")
print(difference.sel(eta=[0.25, 0.5, 0.75, 1.0]))

# %% [markdown]
# The loads differed: the wing had burnt fuel. A load correction subtracts their effect, here of 0.17 ± 0.02 of the load that bends the wing
# like the first series.

# %%
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

shape = before.wingd.displacement("z").value.values
effect = pd.DataFrame(
    {
        "arc_length_m": before["arc_length"],
        "displacement_z_m": shape / shape[-1],
        "slope_deg": np.degrees(before.wingd.slope().value) / shape[-1],
    }
)
change = float(difference.value[-1])
found = before.wingd.difference(after, load=[(effect, f"{change},0.02")])
print(found.test())
assert abs(found["displacement_z"].value.values[-1]) < 1e-9
found.plot()[0].figure.savefig("before_and_after.png")
