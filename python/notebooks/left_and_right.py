# %% [markdown]
# # The left and the right wing
#
# Quantities that do not depend on the side are compared at equal arc lengths from the root. The two installations share no errors, and their
# roots are specified independently. Here a frame of the demonstration stands for the right wing.

# %%
import os

import wingd

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
left = store["f0001"].shape(frame="s000003/0001.jpg")
right = store["f0001"].shape(frame="s000003/0002.jpg").assign_attrs(side="right")
right = right.assign_coords(
    {
        name: right[name].astype(str).copy(data=f"right-{right[name].item()}")
        for name in right.coords
        if str(name).endswith("_sources")
    }
)
left = left.assign_attrs(side="left")

# %%
found = left.wingd.difference(right, mirror=True, eta=[0.25, 0.5, 0.75, 1.0])
print(found)
assert "slope" in found.quantities and found["displacement_z"].sigma.values[-1] > 0.02
found.plot()[0].figure.savefig("left_and_right.png")
