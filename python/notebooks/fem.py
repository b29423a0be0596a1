# %% [markdown]
# # A finite-element model against the measured shape
#
# The model of this example is the measured wing, 2 % too stiff.

# %%
import os

import numpy as np
import pandas as pd

import wingd

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
shape = store["f0001"].shape("s000003")
arc = shape["arc_length"].values
fem = pd.DataFrame(
    {
        "arc_length_m": arc,
        "displacement_z_m": shape.wingd.displacement("z").value.values / 1.02,
        "slope_deg": np.degrees(shape.wingd.slope().value.values) / 1.02,
    }
)

# %%
found = wingd.compare(shape, fem=fem, eta=[0.25, 0.5, 0.75, 1])
print(found)

# %%
test = found.test()
assert test.significant and test.freedom <= 4
found.plot()[0].figure.savefig("fem.png")

# %% [markdown]
# The model without the contraction of the cold wing:

# %%
print(wingd.compare(shape, fem=fem, thermal=False, eta=[0.5, 1]).notes[0])
