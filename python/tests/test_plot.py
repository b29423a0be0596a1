import matplotlib
import numpy as np
import pandas as pd
import pytest
from synthetic import Wing, bend, fly, opened

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

import wingd  # noqa: E402
from wingd import plot  # noqa: E402


@pytest.fixture
def frames():
    yield opened(fly(Wing(), [2.0, 1.9], seed=5))
    plt.close("all")


def test_axes_name_quantity_unit_and_reference(frames):
    ax = frames.isel(frame=0).wingd.displacement().plot(label="measured")
    assert (
        ax.get_ylabel() == "z of the displacement, relative to\nthe survey / m"
        and ax.get_xlabel() == "arc length from the root / m"
    )
    band = ax.collections[0].get_paths()[0].vertices
    z = frames.isel(frame=0).wingd.displacement()
    assert band[:, 1].max() == pytest.approx((z.value + z.sigma).values.max())
    assert len(frames.wingd.slope().plot().lines) == 2
    assert plt.gca().get_ylabel().endswith("/ deg")
    assert frames.wingd.displacement().isel(eta=-1).plot().get_xlabel() == "time (UTC)"
    with pytest.raises(wingd.WingdError, match="select one component"):
        frames.wingd.displacement(axis=None).plot()


def test_a_comparison_shades_where_it_differs(frames):
    arcs = Wing().arc
    fem = pd.DataFrame(
        {"arc_length_m": arcs, "displacement_z_m": bend(arcs, 1.8)[0], "slope_deg": np.degrees(bend(arcs, 1.8)[1])}
    )
    axes = wingd.compare(frames.isel(frame=0), fem).plot()
    assert (
        len(axes) == 2
        and axes[0].patches
        and axes[0].get_ylabel() == "difference of z of the displacement,\nrelative to the survey / m"
    )


def test_moments_spectra_and_animations(frames, tmp_path):
    from test_loads import history

    assert plot.draw_moments(history(seconds=2)).get_ylabel() == "bending moment relative to the ground / kN m"
    assert (
        plot.draw_spectrum(wingd.spectrum(history()), unit="N m").get_ylabel() == "power spectral density / (N m)²/Hz"
    )
    plot.animate(frames, file=tmp_path / "wing.gif")
    assert (tmp_path / "wing.gif").read_bytes()[:3] == b"GIF"
