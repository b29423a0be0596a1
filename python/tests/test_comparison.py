import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from synthetic import Wing, bend, fly, opened

from wingd import WingdError
from wingd.comparison import compare, difference, read_computation, shape_quantities
from wingd.shapes import parse_conditions
from wingd.values import Values, WingdWarning, chi_square_test

DATA = Path(__file__).parent / "data"


def table(tip=2.0, scale=1.0, arcs=None, **more):
    arcs = Wing().arc if arcs is None else arcs
    z, slope, twist = bend(arcs, tip * scale)
    columns = {
        "arc_length_m": arcs,
        "displacement_z_m": z,
        "slope_deg": np.degrees(slope),
        "twist_deg": np.degrees(twist),
    }
    return pd.DataFrame(columns | more)


@pytest.fixture
def shape():
    return opened(fly(Wing(), [2.0], seed=5)).isel(frame=0)


def rejections(pairs, alpha=0.05):
    return np.mean([difference(a, b).test().p < alpha for a, b in pairs])


# --- statistics ---------------------------------------------------------------------------------------------------


def sampled(parts: list[Values], number: int, seed: int) -> np.ndarray:
    """Return p of `number` differences that are sampled from their covariance."""
    from wingd.values import _joint

    mean, covariance = _joint(parts)
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(eigenvalues.clip(0))
    rng, found = np.random.default_rng(seed), []
    sizes = np.cumsum([p.value.size for p in parts])[:-1]
    for _ in range(number):
        values = np.split(root @ rng.normal(size=len(mean)), sizes)
        found.append(
            chi_square_test([Values(p.value.copy(data=v), p.factors) for p, v in zip(parts, values, strict=True)]).p
        )
    return np.array(found)


def test_frames_that_are_not_ok_are_left_out_of_a_mean_and_named():
    frames = opened(fly(Wing(), [2.0, 1.9, 9.0], seed=5))
    frames["status"] = "frame", ["ok", "ok", "doubtful"]
    frames["reason"] = "frame", ["", "", "the images contradict the survey"]
    with pytest.warns(WingdWarning, match="1 of 3 .*s000002/0001.jpg, doubtful: the images contradict the survey"):
        mean = frames.wingd.mean()
    sound = frames.isel(frame=[0, 1]).wingd.mean()
    assert mean["frames"] == 2 and np.array_equal(mean["displacement"], sound["displacement"])
    with pytest.raises(WingdError, match="no frame has the status ok"):
        frames.isel(frame=[2]).wingd.mean()


def test_two_frames_of_a_flight_are_rejected_at_the_level():
    frames = opened(fly(Wing(stations=11), [2.0] * 4, seed=5))
    pair = difference(frames.isel(frame=0), frames.isel(frame=1))
    p = sampled(list(pair.quantities.values()), 2000, seed=11)
    assert 0.035 <= np.mean(p < 0.05) <= 0.065
    assert 0.005 <= np.mean(p < 0.01) <= 0.016
    # Whole flights sampled from their sources, not from the covariance that is tested.
    flights = [opened(fly(Wing(stations=11), [2.0, 2.0], seed=100 + k)) for k in range(150)]
    rate = rejections([(f.isel(frame=0), f.isel(frame=1)) for f in flights])
    assert 0.0 <= rate <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 150)


@pytest.mark.long
def test_two_thousand_pairs_of_sampled_flights_are_rejected_at_the_level():
    flights = (opened(fly(Wing(stations=11), [2.0, 2.0], seed=20_000 + k)) for k in range(2000))
    assert 0.035 <= rejections((f.isel(frame=0), f.isel(frame=1)) for f in flights) <= 0.065


def test_two_frames_of_a_real_flight_are_rejected_at_the_level():
    from wingd.backend import open_shape

    frames = open_shape(DATA / "base-dev.nc")
    pair = difference(frames.isel(frame=0), frames.isel(frame=2))
    assert 0.035 <= np.mean(sampled(list(pair.quantities.values()), 2000, seed=3) < 0.05) <= 0.065


def two_installations(k, other_stations=False):
    rng = np.random.default_rng(k)
    roots = rng.normal(size=2) * 0.3
    lengths = rng.uniform(28.0, 31.0, size=2) if other_stations else (30.0, 30.0)
    wings = [
        Wing(
            name=f"W{k}-{i}",
            seed=1000 * k + i,
            root_error_m=root,
            length_m=length,
            outermost_m=length / 1.03,
            stations=21,
        )
        for i, (root, length) in enumerate(zip(roots, lengths, strict=True))
    ]
    return [opened(fly(w, [2.0], seed=2 * k + i)) for i, w in enumerate(wings)]


def test_two_installations_with_independent_roots():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WingdWarning)
        rate = rejections([two_installations(k) for k in range(120)])
    assert rate <= 0.10
    # Without the error of the roots equal wings would differ.
    bare = []
    for k in range(30):
        a, b = two_installations(k)
        for s in (a, b):
            s.attrs["root_offset_sigma_m"] = 0.0
        bare.append((a, b))
    assert rejections(bare) > 0.3


def test_equal_wings_with_different_outermost_markers():
    """By eta of model tips that are 1.03 times the outermost markers, they differed by 148 ± 33 mm."""
    a = opened(fly(Wing(name="A", seed=1, length_m=30.0, outermost_m=29.1, stations=41), [2.0], seed=5))
    b = opened(fly(Wing(name="B", seed=2, length_m=28.5, outermost_m=27.7, stations=38), [2.0], seed=6))
    found = difference(a, b)
    assert found.test().p > 0.05
    assert float(found.table()["arc_length_m"].max()) <= 28.5
    note = found.notes[0]
    assert "30.000 and 28.500 m" in note and "29.100 and 27.700" in note and "28.500 m" in note
    by_eta = (
        a.wingd.displacement().mean().sel(eta=0.98).value.item()
        - b.wingd.displacement().mean().sel(eta=0.98).value.item()
    )
    assert by_eta > 0.1
    with pytest.warns(WingdWarning, match="lengths to the tip"):
        pair = a.wingd.displacement().isel(frame=0) - b.wingd.displacement().isel(frame=0)
    assert pair.sel(arc_length=28.0).sigma.item() > np.hypot(0.3, 0.3) * 0.08


def test_wings_with_other_sections_are_refused(shape):
    other = fly(Wing(name="B", seed=2), [2.0], seed=6)
    kinked = other["ground_position"].values.copy()
    kinked[11:, 0] += 0.7 * (kinked[11:, 1] - kinked[10, 1])
    other["ground_position"] = ("eta", "axis"), kinked
    with pytest.raises(WingdError, match="bending axes differ"):
        difference(shape, opened(other))


# --- power --------------------------------------------------------------------------------------------------------


def test_more_stations_and_quantities_do_not_dilute_the_test():
    """A model 2 % too stiff (30 mm at the tip of dev): 32 stations of 3 quantities gave p = 0.8, 4 of z 0.003."""
    from wingd.backend import open_shape

    quantities = shape_quantities(open_shape(DATA / "base-dev.nc").isel(frame=[2]))
    stiff = {k: Values(0.02 * v.value.assign_attrs(v.value.attrs), v.factors) for k, v in quantities.items()}
    for name, v in stiff.items():
        v.value.name, v.value.attrs = name, quantities[name].value.attrs

    def p(names, count, full=False):
        etas = list(np.linspace(1 / count, 1, count))
        return chi_square_test([stiff[n].sel(eta=etas) for n in names], full).p

    every = ("displacement_z", "slope", "twist")
    assert p(every, 32, full=True) > 0.1
    assert p(every, 32) < 0.03
    assert p(("displacement_z",), 32) < 0.01
    assert p(("displacement_z",), 4) < 0.01
    assert p(every, 32) == pytest.approx(p(every, 16), rel=0.5)


def test_a_computation_too_stiff_outboard_is_named_where_it_differs(shape):
    arcs = Wing().arc
    right = compare(shape, table())
    assert right.test().p > 0.01
    step = np.where(arcs > 18.6, 0.06 * (arcs - 18.6), 0.0)
    found = compare(shape, table(displacement_z_m=bend(arcs, 2.0)[0] - step)).test()
    assert found.significant
    band = found.bands[found.bands["quantity"] == "displacement_z"].iloc[-1]
    assert 18.6 <= band.from_m <= 24 and band.to_m == 30
    assert band.largest == pytest.approx(0.684, abs=0.03) and band.sigma_largest > 0
    assert "displacement_z differs by more than 2 sigma at" in str(found)


def test_slopes_of_another_computation_are_found(shape):
    found = compare(shape, table(slope_deg=1.05 * table()["slope_deg"])).test()
    assert found.p < 0.01
    assert set(found.bands["quantity"]) == {"slope"}


# --- equal loads --------------------------------------------------------------------------------------------------


def test_errors_of_one_instrument_are_common_to_both_sides():
    """A scale error of the weight counted twice: sigma 60 mm instead of 1.3 mm."""
    frames = opened(fly(Wing(), [2.0, 1.95], seed=5))
    effect = pd.DataFrame({"arc_length_m": [0, 30], "displacement_z_m": [0, 1e-4]})
    pair = [frames.isel(frame=[k]) for k in (0, 1)]
    plain = difference(*pair)["displacement_z"]
    found = difference(*pair, load=[(effect, "weight_kg")])["displacement_z"]
    # 1000 kg apart, of a weight with a bias of 300 kg: nothing of the bias is left.
    assert found.value.values[-1] == pytest.approx(plain.value.values[-1] - 0.1)
    np.testing.assert_allclose(found.sigma, plain.sigma)
    scale = [p.assign(sigma_weight_kg=0.01 * p["weight_kg"]) for p in pair]
    of_scale = difference(*scale, load=[(effect, "weight_kg")])["displacement_z"]
    expected = np.hypot(plain.sigma.values[-1], 0.01 * 1000 * 1e-4)
    assert of_scale.sigma.values[-1] == pytest.approx(expected, rel=1e-9)
    # Two aircraft have two instruments.
    other = pair[1].assign_coords(recorder_id=("frame", ["R2"]))
    apart = difference(pair[0], other, load=[(effect, "weight_kg")])["displacement_z"]
    assert apart.sigma.values[-1] == pytest.approx(
        np.hypot(plain.sigma.values[-1], np.hypot(300, 300) * 1e-4), rel=1e-9
    )


def test_load_correction_against_a_computation(shape):
    effect = pd.DataFrame({"arc_length_m": [0, 30], "displacement_z_m": [0, 1e-5]})
    plain = compare(shape, table())["displacement_z"]
    found = compare(shape, table(), load=[(effect, "weight_kg=58000")])["displacement_z"]
    assert found.value.values[-1] == pytest.approx(plain.value.values[-1] - 0.02)
    assert found.sigma.values[-1] == pytest.approx(np.hypot(plain.sigma.values[-1], 300e-5))
    tonnes = compare(shape, table(), load=[(effect.assign(displacement_z_m=[0, 1e-2]), "weight_t=58")])[
        "displacement_z"
    ]
    np.testing.assert_allclose(tonnes.value, found.value)
    np.testing.assert_allclose(tonnes.sigma, found.sigma)
    for bad, message in [
        ("weight_kg", "computation's value"),
        ("fuel_kg=1", "no quantity"),
        ("1,x", "not a number"),
        ("1,-2", "negative"),
    ]:
        with pytest.raises(WingdError, match=message):
            compare(shape, table(), load=[(effect, bad)])


# --- tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("arc_length_m,displacement_z_m,sigma_z_m\n0,0,1\n", "'sigma_z_m' is not read; write sigma_displacement_z_m"),
        ("arc_length_m,Displacement_Z_m\n0,0\n", "write displacement_z_m"),
        ("arc_length_m,displacement_z_mm\n0,0\n", "write displacement_z_m"),
        ("arc_length_ft,displacement_z_m\n0,0\n", "write arc_length_m"),
        ("arc_length_m,slope_rad\n0,0\n", "write slope_deg"),
        ("eta,displacement_z_m\n0,0\n", "no column arc_length_m"),
        ("arc_length_m\n0\n", "no quantity to compare"),
        (
            "arc_length_m,displacement_z_m\n0,0\n5,1\n5,2\n9,3\n",
            "line 4, arc_length_m = 5: is the station of line 3 too",
        ),
        ("arc_length_m,displacement_z_m\n5,0\n0,1\n", "line 3, arc_length_m = 0: is not outboard"),
        ("arc_length_m,displacement_z_m\n0,=1+1\n", "line 2, displacement_z_m = =1\\+1: is not a finite"),
        ("arc_length_m,displacement_z_m\n0,1e999\n", "not a finite number"),
        ("arc_length_m,displacement_z_m\n0,nan\nx,1\n", "line 2, displacement_z_m = nan: is not a finite"),
        ("arc_length_m,displacement_z_m,sigma_displacement_z_m\n0,1,-1\n", "is not negative"),
        ("arc_length_m,displacement_z_m,sigma_slope_deg\n0,1,1\n", "without slope_deg"),
        ("arc_length_m,displacement_z_m\n", "has no stations"),
        ("arc_length_m,displacement_z_m,displacement_z_m\n0,0,0\n", "displacement_z_m: occurs twice"),
        ("arc_length_m,displacement_z_m\n0,0\n9,1\n200,2\n", "line 4, arc_length_m = 200"),
        (
            "arc_length_m,displacement_z_m\n0,0\n9,100\n26,2300\n",
            "line 3, .* = 100: no point of a wing of 26 m moves so far",
        ),
        ("arc_length_m,displacement_z_m,sigma_displacement_z_m\n0,0,0\n5,1,\n", "line 3, .* = : is unknown"),
        ("arc_length_m;displacement_z_m\n0;0\n", "is separated by semicolons"),
        ("", "is empty"),
    ],
)
def test_tables_that_are_almost_right_are_errors(text, message, tmp_path, shape):
    file = tmp_path / "fem.csv"
    file.write_text(text)
    with pytest.raises(WingdError, match=message) as error:
        compare(shape, file)
    assert "\n" not in str(error.value)


def test_columns_that_are_not_read_are_named(tmp_path):
    file = tmp_path / "fem.csv"
    file.write_text("# from the model\narc_length_m,displacement_z_m,comment,von_mises\n0,0,a,1\n3,1,b,2\n")
    with pytest.warns(WingdWarning, match="not read: comment, von_mises"):
        found, _ = read_computation(file)
    assert list(found.columns) == ["arc_length_m", "displacement_z_m"]
    file.write_bytes("arc_length_m,displacement_z_m\n0,0\n".encode("utf-16"))
    with pytest.raises(WingdError, match="UTF-8"):
        read_computation(file)


def test_a_computation_that_ends_before_the_station_is_an_error(shape):
    with pytest.raises(WingdError, match="no stations around 30.000 m"):
        compare(shape, table(arcs=np.linspace(0, 25, 6)), eta=[0.5, 1.0])
    found = compare(shape, table(arcs=np.linspace(0, 30, 61)), eta=[0.25, 0.5, 0.75, 1])
    assert list(found.table()["eta"]) == [0.25, 0.5, 0.75, 1]


def test_independent_errors_of_a_computation(shape):
    found = compare(shape, table(sigma_displacement_z_m=np.full(21, 0.05)))["displacement_z"]
    np.testing.assert_allclose(found.sigma, np.hypot(shape.wingd.displacement().sigma, 0.05))


# --- thermal, sides, references -----------------------------------------------------------------------------------


def test_thermal_contraction_is_a_switch_and_a_sentence(shape):
    data = fly(Wing(), [2.0], seed=5, sampled=False)
    shrunk = data.copy(deep=True)
    shrunk["displacement"][:, :, 1] = -0.002 * data["arc_length"]
    shape = opened(shrunk).isel(frame=0)
    fem = table(displacement_y_m=0 * Wing().arc)
    with_it = compare(shape, fem)
    assert any("60 mm shorter" in n and "thermal=False" in n for n in with_it.notes)
    assert with_it["displacement_y"].value.values[-1] == pytest.approx(-0.06)
    without = compare(shape, fem, thermal=False)
    assert without["displacement_y"].value.values[-1] == pytest.approx(0.0, abs=1e-4)
    assert any("removed" in n for n in without.notes)
    # Heights shrink with the lengths.
    assert without["displacement_z"].value.values[-1] == pytest.approx(2.0 / 0.998 - 2.0, abs=1e-9)


def test_left_and_right():
    left = opened(fly(Wing(name="L", seed=1), [2.0], seed=5))
    right = opened(fly(Wing(name="R", seed=2, side="right"), [2.0], seed=6))
    with pytest.raises(WingdError, match="left and the right wing"):
        difference(left, right)
    found = difference(left, right, mirror=True)
    assert found.test().p > 0.001
    with pytest.raises(WingdError, match="omit mirror"):
        difference(left, left, mirror=True)
    direct = left.isel(frame=0).wingd.displacement() - right.wingd.mirror().isel(frame=0).wingd.displacement()
    np.testing.assert_allclose(direct.value, found["displacement_z"].value)
    assert np.isnan(right.wingd.mirror()["displacement"].sel(axis="y")).all()


def test_one_frame_on_both_sides_is_an_error():
    frames = opened(fly(Wing(), [2.0, 1.9], seed=5))
    with pytest.raises(WingdError, match="frame in common"):
        difference(frames, frames.isel(frame=[0]))


def with_references(data):
    """Add deflections of four markers against three references: bend on the ground, and a moved root."""
    places = np.array([[0.5, 10.0, 0], [-0.5, 15.0, 0], [0.4, 22.0, 0], [-0.4, 29.0, 0]])
    n, y = data.sizes["frame"], places[:, 1]
    survey = np.repeat(bend(y, 2.0)[0][None], n, axis=0)
    on_ground = 0.02 * (y / 30) ** 2
    root = 0.003 + 0.001 * y - 0.002 * places[:, 0]
    data = data.assign_coords(marker=["A", "B", "C", "D"], reference=["survey", "ground", "root"])
    stacked = np.stack([survey, survey - on_ground, survey - on_ground - root], axis=-1)
    dims = ("frame", "marker", "reference")
    data["marker_deflection"] = dims, stacked, {"units": "m"}
    data["sigma_marker_deflection"] = dims, np.full((n, 4, 3), 0.01)
    factor = np.repeat([[[0.01, 0, 0], [0.01, 0.002, 0], [0.01, 0.002, 0.003]]], 4, axis=0)[None].repeat(n, axis=0)
    data["marker_deflection_own"] = (*dims, "own"), np.concatenate([factor, np.zeros((n, 4, 3, 1))], axis=-1)
    data["marker_ground_position"] = ("marker", "axis"), places
    return data.drop_vars([v for v in data.variables if v == "marker_displacement"])


def test_references_of_the_vertical_displacement():
    data = (
        fly(Wing(), [2.0], seed=5, sampled=False)
        .drop_dims("marker", errors="ignore")
        .drop_vars("marker", errors="ignore")
    )
    shape = opened(with_references(data))
    arc, z = Wing().arc, shape.wingd.displacement()
    ground = shape.wingd.displacement("z", reference="ground")
    np.testing.assert_allclose((z.value - ground.value)[0], 0.02 * (arc / 30) ** 2, atol=1e-9)
    root = shape.wingd.displacement("z", reference="root")
    np.testing.assert_allclose((ground.value - root.value)[0], 0.003 + 0.001 * arc, atol=1e-9)
    assert (ground.sigma.values[0, -1] > 0) and "ground frame" in ground.label and "tangent at the root" in root.label
    assert shape.wingd.deflections("ground").value.shape == (1, 4)
    with pytest.raises(WingdError, match="survey"):
        opened(fly(Wing(), [2.0], seed=5)).wingd.displacement("z", reference="ground")
    with pytest.raises(WingdError, match='give "survey", "ground" or "root"'):
        shape.wingd.displacement("z", reference="wing")


def test_two_streamwise_twists():
    """The material chord line by default; the plane of the section by its name."""
    data = fly(Wing(), [2.0], seed=5)
    n = data.sizes["eta"]
    vector = np.zeros((1, n, 3))
    # A wing along y, flow along x and y: a rotation about y lifts the nose, bending about x tips the line up.
    vector[..., 1], vector[..., 0] = 0.03, 0.05
    dims = ("frame", "eta", "axis")
    data["rotation"] = dims, vector, {"units": "rad"}
    data["sigma_rotation"] = dims, np.full((1, n, 3), 0.001)
    data["rotation_own"] = (
        (*dims, "own"),
        np.concatenate([np.repeat(np.eye(3)[None, None] * 0.001, n, axis=1), np.zeros((1, n, 3, 1))], -1),
    )
    data["streamwise_twist"] = ("frame", "eta"), np.full((1, n), -0.02), {"units": "rad"}
    data["sigma_streamwise_twist"] = ("frame", "eta"), np.full((1, n), 0.001)
    data.attrs["flow_direction"] = [0.8, 0.6]
    shape = opened(data)
    chord = shape.wingd.streamwise_twist()
    # To first order: rotation about the axis to the right of the flow; aft down is nose up.
    assert chord.value.values[0, 0] == pytest.approx(0.8 * 0.03 - 0.6 * 0.05, abs=2e-4)
    assert chord.sigma.values[0, 0] == pytest.approx(0.001, rel=2e-3)
    assert shape.wingd.streamwise_twist("plane").value.values[0, 0] == -0.02
    assert "material chord" in chord.label
    with pytest.raises(WingdError, match='"chord" or "plane"'):
        shape.wingd.streamwise_twist("line")


# --- conditions ---------------------------------------------------------------------------------------------------


def test_where():
    frames = opened(fly(Wing(), [2.0] * 5, seed=5))
    assert list(frames.wingd.where("mach between .79 and .81 and weight_kg < 58500")["mach"].values) == pytest.approx(
        [0.80, 0.81]
    )
    assert frames.wingd.where("weight_t >= 58.9").sizes["frame"] == 2
    assert frames.wingd.where("weight_lb < 125000").sizes["frame"] == 1
    known = ["static_temperature_c", "pressure_altitude_m", "true_airspeed_m_s"]
    for text in ("static_temperature_k < 220", "static_temperature_f < -64"):
        _, inverse, shift, _, high = parse_conditions(text, known)[0]
        assert high * inverse + shift == pytest.approx(-53.15 if "_k" in text else -53.333, abs=1e-3)
    for text, message in [
        ("mach > 0.9", "no frame"),
        ("speed < 1", "no quantity 'speed'"),
        ("mach 0.8", "not understood"),
        ("mach between .8 and .7", "smaller number"),
        ("mach < .8 or", "not understood"),
    ]:
        with pytest.raises(WingdError, match=message):
            frames.wingd.where(text)


def test_a_computation_in_cad_axes():
    """Factors of the survey frame are turned with the values; the tie points have one of their own."""
    data = fly(Wing(), [2.0], seed=5)
    turn = np.array([[0, 0, 1.0], [0, 1.0, 0], [-1.0, 0, 0]])
    data["cad_from_survey"] = ("row", "column"), np.vstack([np.column_stack([turn, [1, 2, 3]]), [0, 0, 0, 1]])
    root = np.array([[1e-3, 0, 0, 0], [4e-4, 8e-4, 0, 0], [0, -3e-4, 6e-4, 0], [1e-4, 0, 2e-4, 5e-4]])
    data["cad_fit"] = ("parameter", "fit"), root
    data["fit_sources"] = "frame", ["ties"]
    shape = opened(data)
    x = shape.wingd.displacement("x", axes="cad")
    z = shape.wingd.displacement("z")
    np.testing.assert_allclose(x.value, z.value)
    # By differences: each source turns and lengthens the displacement by its column of the factor.
    moved = data["displacement"].values @ turn.T
    by_fit = np.zeros(moved.shape[:-1])
    for source in root.T * 1e-3:
        perturbed = Rotation.from_rotvec(source[:3]).apply(moved.reshape(-1, 3)) * (1 + source[3])
        by_fit = np.hypot(by_fit, (perturbed.reshape(moved.shape) - moved)[..., 0] * 1e3)
    np.testing.assert_allclose(x.sigma, np.hypot(z.sigma, by_fit), rtol=1e-4)
    assert by_fit.max() > 1e-4
    mean = shape.wingd.mean().wingd.displacement("x", axes="cad")
    np.testing.assert_allclose(mean.sigma, x.sigma[0], rtol=1e-9)
    fem = table().rename(columns={"displacement_z_m": "displacement_x_m"})[["arc_length_m", "displacement_x_m"]]
    found = compare(shape, fem, axes="cad")
    np.testing.assert_allclose(found["displacement_x"].sigma[1:], x.sigma[0, 1:])
    with pytest.raises(WingdError, match=r"add \[cad\]"):
        compare(opened(fly(Wing(), [2.0], seed=5)), fem, axes="cad")
