import numpy as np
import pandas as pd
import pytest
from synthetic import Wing, fly, opened

import wingd
from wingd import WingdError, loads


def history(seconds=40.0, rate=50.0, sigma=1e3, seed=1, station=10.0):
    """Moments of a wing at 1.2 Hz about a mean, with noise of known sigma."""
    t = np.arange(0, seconds, 1 / rate)
    noise = np.random.default_rng(seed).normal(size=len(t)) * sigma
    moment = 1e6 + 5e4 * np.sin(2 * np.pi * 1.2 * t) + noise
    time = pd.Timestamp("2026-06-01T08:00:00Z") + pd.to_timedelta(t, unit="s")
    return pd.DataFrame(
        {
            "flight": "f0001",
            "time": time,
            "s_m": station,
            "moment_nm": moment,
            "sigma_moment_nm": np.hypot(sigma, 0.03 * moment),
            "sigma_by_stiffness_nm": 0.03 * moment,
        }
    )


def test_spectrum_has_the_power_of_the_oscillation_and_the_noise():
    found = wingd.spectrum(history())
    peak = found.loc[found["density"].idxmax()]
    assert peak["frequency_hz"] == pytest.approx(1.2, abs=0.06)
    step = found["frequency_hz"].diff().iloc[1]
    near = found[(found["frequency_hz"] - 1.2).abs() < 0.5]
    assert near["density"].sum() * step == pytest.approx(5e4**2 / 2, rel=0.05)
    high = found[found["frequency_hz"] > 5]
    assert high["density"].mean() == pytest.approx(1e6 * 2 / 50, rel=0.1)
    # The standard deviation contains that of the stiffness, which is no noise.
    assert found["noise"].iloc[0] == pytest.approx(high["density"].mean(), rel=0.1)


def test_spectrum_refuses_what_it_cannot_use():
    table = history()
    with pytest.raises(WingdError, match="gaps of up to 10.0 s"):
        wingd.spectrum(table[(table["time"].dt.second < 10) | (table["time"].dt.second >= 20)])
    with pytest.raises(WingdError, match="several stations"):
        wingd.spectrum(pd.concat([table, history(station=20.0)]))
    with pytest.raises(WingdError, match="too few"):
        wingd.spectrum(table.head(10))
    with pytest.raises(WingdError, match="no column gust"):
        wingd.spectrum(table, column="gust")


def test_cycles_and_damage():
    table = history()
    cycles = loads.rainflow(table, bending_hz=1.2)
    large = cycles[cycles["range_nm"] > 8e4]
    # 48 periods, in the ground-air-ground cycle and those between.
    assert large["count"].sum() == pytest.approx(48, abs=1.5)
    assert large["significant"].all()
    damage = loads.damage(table, bending_hz=1.2).set_index("slope")
    assert 1.0 < damage.loc[3.0, "relative"] < 1.05 and (damage["sigma_relative"] > 0).all()
    with pytest.raises(WingdError, match="too few to count cycles of a 10 Hz"):
        loads.rainflow(table, bending_hz=10)


def test_gaps_are_not_counted():
    t = np.concatenate([np.arange(0, 10, 0.02), np.arange(30, 40, 0.02)])
    sampling = loads.analyse_sampling(t, 1.2)
    assert sampling.countable and sampling.gaps == 1 and sampling.longest_gap_s == pytest.approx(20.02)
    assert sampling.covered_s == pytest.approx(19.96) and sampling.uncovered_s == pytest.approx(20.02)
    assert not loads.analyse_sampling(np.arange(0, 10, 1.0), 1.2).countable
    assert loads.analyse_sampling(np.array([0.0]), 1.2).reason(1.2) == "one frame is too few to count cycles"


def test_moments_of_shapes():
    data = fly(Wing(), [2.0, 1.9], seed=5)
    data = data.assign_coords(section=[5.0, 10.0])
    data["bending_moment"] = ("frame", "section"), np.array([[2e6, 1e6], [1.9e6, 0.9e6]]), {"units": "N m"}
    data["sigma_bending_moment"] = ("frame", "section"), np.full((2, 2), 5e4)
    data["bending_moment_stiffness"] = ("frame", "section", "stiffness"), np.full((2, 2, 2), 3e4 / np.sqrt(2))
    data["bending_moment_own"] = ("frame", "section", "own"), np.full((2, 2, 4), 2e4)
    shape = opened(data)
    table = loads.shape_moments(shape)
    assert list(table["s_m"]) == [5.0, 10.0, 5.0, 10.0] and list(table["moment_nm"]) == [2e6, 1e6, 1.9e6, 0.9e6]
    assert table["sigma_by_stiffness_nm"].to_numpy() == pytest.approx(3e4)
    extremes = loads.extremes(table)
    assert extremes.loc[5.0, "greatest_nm"] == 2e6 and extremes.loc[5.0, "greatest_in"] == "s000001/0001.jpg"
    # The stiffness is common to an installation: it cancels in differences.
    moment = shape.wingd.values("bending_moment")
    assert set(moment.factors) == {"own", "stiffness"}
    assert (moment.isel(frame=0) - moment.isel(frame=1)).sigma.values == pytest.approx(np.sqrt(2 * 4) * 2e4)


def test_moments_need_the_part_of_the_stiffness(tmp_path):
    table = history().drop(columns="sigma_by_stiffness_nm")
    with pytest.raises(WingdError, match="give the table of the stiffness"):
        loads.extremes(table)
    structure = pd.DataFrame({"s_m": [10.0], "ei_n_m2": [1e8], "sigma_ei_n_m2": [np.sqrt(0.03**2 - 0.02**2) * 1e8]})
    known = loads.extremes(table, structure)
    np.testing.assert_allclose(known, loads.extremes(history()), rtol=1e-6)
    file = tmp_path / "structure.csv"
    for text, message in [
        ("s_m,ei\n1,2\n", "has no column"),
        ("s_m,ei_n_m2,sigma_ei_n_m2\n2,1,0\n2,1,0\n", "in order"),
        ("s_m,ei_n_m2,sigma_ei_n_m2\n2,-1,0\n", "positive"),
    ]:
        file.write_text(text)
        with pytest.raises(WingdError, match=message):
            loads.read_structure(file)


def test_live_results_have_a_column_for_each_section():
    one, two = history(seconds=2), history(seconds=2, station=20.0, seed=2)
    wide = pd.DataFrame({"utc": one["time"], "flight": "f0001"})
    for name, table in (("b01", one), ("b02", two)):
        wide[f"arc_length_{name}_m"] = table["s_m"]
        wide[f"bending_moment_{name}_nm"] = table["moment_nm"]
        wide[f"sigma_bending_moment_{name}_nm"] = table["sigma_moment_nm"]
        wide[f"sigma_stiffness_{name}_nm"] = table["sigma_by_stiffness_nm"]
    found = loads.extremes(loads.read_moments(wide))
    np.testing.assert_allclose(found.loc[20.0], loads.extremes(two).loc[20.0])
    assert list(found.index) == [10.0, 20.0]
