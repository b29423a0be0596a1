# %% [markdown]
# # A surface moved by the measured shape
#
# Nodes of a surface move with the sections of the wing. Each node has a standard deviation. The surface of this example is the upper skin
# through the surveyed markers. `deform` takes files and meshes that meshio or pyvista read, with `axes=` and `unit=`.

# %%
import os

import meshio
import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

import wingd

store = wingd.open(os.environ.get("WINGD_STORE", "demo-flight/store"))
shape = store["f0001"].shape("s000003")
markers = shape["marker_ground_position"].values
corners = Delaunay(markers[:, :2]).simplices
middles = np.concatenate([markers[corners].mean(axis=1), markers])
skin = LinearNDInterpolator(markers[:, :2], markers[:, 2])
points = np.column_stack([middles[:, :2], skin(middles[:, :2])])
points = points[np.isfinite(points).all(axis=1)]
mesh = meshio.Mesh(points, [("triangle", Delaunay(points[:, :2]).simplices)])

# %%
moved = shape.wingd.deform(mesh)
outermost = int(moved.arc_m.argmax())
print(
    f"{moved.displacement_m[outermost]} ± {moved.sigma_m[outermost]} m; markers {moved.marker_distance_m * 1e3:.1f} mm from the surface"
)
assert 1.5 < moved.displacement_m[outermost, 2] < 3.0 and 0 < moved.sigma_m[outermost, 2] < 0.05

# %%
import matplotlib.pyplot as plt  # noqa: E402

plt.style.use(wingd.plot.STYLE)
figure, axes = plt.subplots(figsize=(7, 3))
drawn = axes.scatter(moved.arc_m, moved.displacement_m[:, 2], c=moved.sigma_m[:, 2] * 1e3)
figure.colorbar(drawn, label="standard deviation / mm")
axes.set_xlabel("arc length from the root / m")
axes.set_ylabel("vertical displacement / m")
figure.savefig("surface.png")
