//! Joint shape of a flight as a dataset: motions of stations and markers, and factors of their covariance.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, SMatrix, SymmetricEigen, Vector3};

use super::dataset::{ArrayDataset, ArrayValues, NamedArray};
use wingd_base::clock::Stamp;
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::record::variant_name;
use wingd_measure::adjust::GlobalTest;
use wingd_measure::adjust::JointShape;
use wingd_measure::adjust::ShapeMean;
use wingd_measure::geometry::TransformFit;

/// Shape of a frame, or mean of several.
pub struct DatedShape {
    /// Series, or series and file.
    pub name: String,
    /// Time of the first frame.
    pub stamp: Stamp,
    /// Number of frames.
    pub count: usize,
    /// Aircraft data at the exposure, means of several frames.
    pub conditions: BTreeMap<Quantity, f64>,
    pub shape: ShapeMean,
    pub global_test: Option<GlobalTest>,
    /// Mean variance factor of the adjustments.
    pub variance_factor: Option<f64>,
    /// True if factors are scaled by the root of the variance factor.
    pub posterior: bool,
    /// For each marker of the shape, whether it was used in no frame.
    pub predicted: Vec<bool>,
}

/// Array of a shape: name, unit, meaning, and the first of its functions of each station ([`STATION_FUNCTIONS`]).
///
/// [`STATION_FUNCTIONS`]: wingd_measure::adjust::STATION_FUNCTIONS
const STATION_ARRAYS: [(&str, &str, &str, usize, usize); 5] = [
    (
        "displacement",
        "m",
        "displacement of the bending axis against the survey",
        0,
        3,
    ),
    (
        "slope",
        "rad",
        "change of the slope along the span, tip up",
        3,
        1,
    ),
    (
        "twist",
        "rad",
        "twist about the bending axis, nose up",
        4,
        1,
    ),
    (
        "streamwise_twist",
        "rad",
        "change of the incidence in the vertical plane of the flow, nose up",
        5,
        1,
    ),
    ("rotation", "rad", "rotation vector of the section", 6, 3),
];

/// Function that returns a factor of the covariance.
type FactorGetter = fn(&ShapeMean) -> &DMatrix<f64>;

/// Factors of the covariance, by the dimension of their sources.
const FACTORS: [(&str, FactorGetter); 3] = [
    ("lasting", |s| &s.lasting),
    ("shared", |s| &s.shared),
    ("own", |s| &s.own),
];

/// Values of one frame for an array, with a factor for each kind of sources (values x sources).
struct FunctionValues {
    values: Vec<f64>,
    factors: Vec<(&'static str, DMatrix<f64>)>,
}

impl FunctionValues {
    /// Reads functions of a shape.
    fn of_rows(shape: &ShapeMean, rows: &[usize]) -> Self {
        let values = rows.iter().map(|row| shape.values[*row]).collect();
        let factors = FACTORS.map(|(name, factor)| (name, factor(shape).select_rows(rows)));
        Self {
            values,
            factors: factors.into(),
        }
    }

    /// Transforms displacements, three values each, to the CAD frame. Its sources are those of rotation and scale.
    fn in_cad(&self, fit: &TransformFit) -> Self {
        let linear = fit.transform.rotation.matrix() * fit.transform.scale;
        let of_fit = fit_factor(fit);
        let (mut values, mut factors) = (self.values.clone(), self.factors.clone());
        let mut by_fit = DMatrix::zeros(values.len(), of_fit.ncols());
        for (k, value) in values.chunks_exact_mut(3).enumerate() {
            let moved = linear * Vector3::from_column_slice(value);
            value.copy_from_slice(moved.as_slice());
            for (_, factor) in &mut factors {
                let turned = linear * factor.rows(3 * k, 3);
                factor.rows_mut(3 * k, 3).copy_from(&turned);
            }
            let mut jacobian = SMatrix::<f64, 3, 4>::zeros();
            jacobian
                .fixed_columns_mut::<3>(0)
                .copy_from(&-moved.cross_matrix());
            jacobian.set_column(3, &(moved / fit.transform.scale));
            by_fit.rows_mut(3 * k, 3).copy_from(&(jacobian * of_fit));
        }
        factors.push(("fit", by_fit));
        Self { values, factors }
    }

    fn sigmas(&self) -> Vec<f64> {
        let variance = |row: usize| {
            self.factors
                .iter()
                .map(|(_, factor)| factor.row(row).norm_squared())
                .sum::<f64>()
        };
        let sigma = |(row, value): (usize, &f64)| {
            if value.is_nan() {
                f64::NAN
            } else {
                variance(row).sqrt()
            }
        };
        self.values.iter().enumerate().map(sigma).collect()
    }
}

/// Symmetric root of the covariance of small rotation (rad) and scale of a fitted transform.
fn fit_factor(fit: &TransformFit) -> SMatrix<f64, 4, 4> {
    /// Rows of rotation and scale in the covariance of a fit; a displacement does not depend on the translation.
    const PARAMETERS: [usize; 4] = [0, 1, 2, 6];
    let covariance =
        SMatrix::<f64, 4, 4>::from_fn(|i, j| fit.covariance[(PARAMETERS[i], PARAMETERS[j])]);
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(covariance);
    eigenvectors
        * SMatrix::from_diagonal(&eigenvalues.map(|v| v.max(0.0).sqrt()))
        * eigenvectors.transpose()
}

/// Creates the dataset of the shapes of frames, or of means of them, at least one. `attributes` of the store are included.
pub fn shape_dataset(
    shapes: &[DatedShape],
    shape: &JointShape,
    installation: &Installation,
    jointly: bool,
    attributes: Vec<(String, String)>,
) -> ArrayDataset {
    let sources = |factor: FactorGetter| {
        shapes
            .iter()
            .map(|one| factor(&one.shape).ncols())
            .max()
            .unwrap_or(0)
    };
    let mut dimensions = vec![
        ("frame", shapes.len()),
        ("station", shape.arcs_m.len()),
        ("marker", shape.markers.len()),
        ("axis", 3),
        ("row", 4),
        ("column", 4),
        ("fit", if installation.cad.is_some() { 4 } else { 0 }),
    ];
    dimensions.extend(FACTORS.map(|(name, factor)| (name, sources(factor))));
    let mut data = ArrayDataset {
        dimensions,
        arrays: vec![],
        attributes,
    };
    add_stations(&mut data, shape, installation);
    add_frames(&mut data, shapes);
    let cad = installation.cad.as_ref();
    for (name, unit, meaning, function, components) in STATION_ARRAYS {
        let row = |station: usize, component: usize| {
            shape.station_function(function + component, station)
        };
        let rows: Vec<usize> = (0..shape.arcs_m.len())
            .flat_map(|s| (0..components).map(move |c| row(s, c)))
            .collect();
        let in_cad = cad.filter(|_| unit == "m");
        add_functions(
            &mut data,
            shapes,
            (name, unit, meaning),
            ("station", components),
            &rows,
            in_cad,
        );
    }
    let rows: Vec<usize> = (0..shape.markers.len())
        .flat_map(|m| (0..3).map(move |c| shape.marker_function(m) + c))
        .collect();
    let array = (
        "marker_displacement",
        "m",
        "displacement of the marker against the survey",
    );
    add_functions(&mut data, shapes, array, ("marker", 3), &rows, cad);
    add_facts(&mut data, shape, installation, jointly);
    data
}

fn add_array(
    data: &mut ArrayDataset,
    (name, unit, meaning): (&str, &'static str, &str),
    dimensions: &[&'static str],
    values: ArrayValues,
) {
    let (name, dimensions, meaning) = (name.to_owned(), dimensions.to_vec(), meaning.to_owned());
    data.arrays.push(NamedArray {
        name,
        dimensions,
        unit,
        meaning,
        values,
    });
}

/// Places on the ground.
fn add_stations(data: &mut ArrayDataset, shape: &JointShape, installation: &Installation) {
    let markers = || {
        shape
            .markers
            .iter()
            .map(|m| &installation.setup.markers[*m])
    };
    let numbers = |values: Vec<f64>| ArrayValues::Numbers(values);
    let eta = shape
        .arcs_m
        .iter()
        .map(|arc_m| arc_m / shape.length_m)
        .collect();
    let arc = (
        "arc_length",
        "m",
        "arc length from the bending root along the axis on the ground",
    );
    add_array(data, arc, &["station"], numbers(shape.arcs_m.clone()));
    add_array(
        data,
        ("eta", "", "arc length over that of the model's tip"),
        &["station"],
        numbers(eta),
    );
    let ground = (
        "ground_position",
        "m",
        "bending axis on the ground, survey frame",
    );
    let places = shape
        .ground_m
        .iter()
        .flat_map(|p| p.iter().copied())
        .collect();
    add_array(data, ground, &["station", "axis"], numbers(places));
    let surveyed = (
        "marker_ground_position",
        "m",
        "surveyed position, survey frame",
    );
    let places = markers()
        .flat_map(|m| m.position_m.iter().copied())
        .collect();
    add_array(data, surveyed, &["marker", "axis"], numbers(places));
    let ids = markers().map(|m| m.id.clone()).collect();
    add_array(
        data,
        ("marker_id", "", "id in the survey"),
        &["marker"],
        ArrayValues::Texts(ids),
    );
    if let Some(fit) = &installation.cad {
        let (linear, moved) = (
            fit.transform.rotation.matrix() * fit.transform.scale,
            fit.transform.translation_m,
        );
        let entry = |i: usize, j: usize| match (i, j) {
            (3, _) => f64::from(u8::from(j == 3)),
            (_, 3) => moved[i],
            _ => linear[(i, j)],
        };
        let matrix = (0..4)
            .flat_map(|i| (0..4).map(move |j| entry(i, j)))
            .collect();
        let meaning = "transform of points from the survey to the CAD frame, m";
        add_array(
            data,
            ("cad_from_survey", "", meaning),
            &["row", "column"],
            numbers(matrix),
        );
    }
}

/// Names, times, tests and conditions of the frames.
fn add_frames(data: &mut ArrayDataset, shapes: &[DatedShape]) {
    let texts = |text: &dyn Fn(&DatedShape) -> String| {
        ArrayValues::Texts(shapes.iter().map(text).collect())
    };
    let numbers = |value: &dyn Fn(&DatedShape) -> f64| {
        ArrayValues::Numbers(shapes.iter().map(value).collect())
    };
    let flags =
        |flag: &dyn Fn(&DatedShape) -> bool| ArrayValues::Flags(shapes.iter().map(flag).collect());
    let mut add = |name: &str, unit: &'static str, meaning: &str, values: ArrayValues| {
        add_array(data, (name, unit, meaning), &["frame"], values);
    };
    add(
        "image",
        "",
        "series and file, or series",
        texts(&|one| one.name.clone()),
    );
    add(
        "frames",
        "",
        "number of frames, of which the shape is the mean",
        numbers(&|one| one.count as f64),
    );
    let time = numbers(&|one| one.stamp.utc.as_microsecond() as f64 * 1e-6);
    add(
        "time",
        "seconds since 1970-01-01 00:00:00 UTC",
        "request to the camera, of the first frame",
        time,
    );
    let synchronised = flags(&|one| one.stamp.utc_synchronised);
    add(
        "time_synchronised",
        "",
        "1 if the clock was set by a reference",
        synchronised,
    );
    let test = texts(&|one| one.global_test.map(variant_name).unwrap_or_default());
    add(
        "global_test",
        "",
        "test of the adjustment: passed or rejected",
        test,
    );
    let factor = numbers(&|one| one.variance_factor.unwrap_or(f64::NAN));
    add(
        "variance_factor",
        "",
        "variance factor of the adjustment",
        factor,
    );
    let meaning = "1 if the factors are scaled by the root of the variance factor";
    add("posterior", "", meaning, flags(&|one| one.posterior));
    let mut quantities: Vec<_> = shapes
        .iter()
        .flat_map(|one| one.conditions.keys().copied())
        .collect();
    quantities.sort_unstable();
    quantities.dedup();
    for quantity in quantities {
        let value = numbers(&|one| one.conditions.get(&quantity).copied().unwrap_or(f64::NAN));
        add(quantity.name(), "", "aircraft data at the exposure", value);
    }
    let predicted = ArrayValues::Flags(
        shapes
            .iter()
            .flat_map(|one| one.predicted.iter().copied())
            .collect(),
    );
    let meaning = "1 if the marker was not used and the adjusted shape predicts it";
    add_array(
        data,
        ("predicted", "", meaning),
        &["frame", "marker"],
        predicted,
    );
}

/// Values, standard deviations and factors of functions, one row each; displacements in the CAD frame too, if there is one.
fn add_functions(
    data: &mut ArrayDataset,
    shapes: &[DatedShape],
    (name, unit, meaning): (&str, &'static str, &str),
    (place, components): (&'static str, usize),
    rows: &[usize],
    cad: Option<&TransformFit>,
) {
    let mut dimensions = vec!["frame", place];
    dimensions.extend((components > 1).then_some("axis"));
    let values: Vec<FunctionValues> = shapes
        .iter()
        .map(|one| FunctionValues::of_rows(&one.shape, rows))
        .collect();
    let meaning_in = |frame: &str| {
        if components > 1 {
            format!("{meaning}, {frame} frame")
        } else {
            meaning.to_owned()
        }
    };
    add_values(
        data,
        (name, unit, &meaning_in("survey")),
        &dimensions,
        &values,
    );
    if shapes.iter().any(|one| one.shape.scatter.is_some()) {
        let of = |one: &DatedShape| {
            rows.iter()
                .map(|row| one.shape.scatter.as_ref().map_or(f64::NAN, |s| s[*row]))
                .collect()
        };
        let scatter = shapes
            .iter()
            .flat_map(|one| -> Vec<f64> { of(one) })
            .collect();
        let text = format!(
            "standard deviation of single frames about their mean: {}",
            meaning_in("survey")
        );
        add_array(
            data,
            (&format!("scatter_{name}"), unit, &text),
            &dimensions,
            ArrayValues::Numbers(scatter),
        );
    }
    if let Some(fit) = cad {
        let in_cad: Vec<FunctionValues> = values.iter().map(|one| one.in_cad(fit)).collect();
        add_values(
            data,
            (&format!("{name}_cad"), unit, &meaning_in("CAD")),
            &dimensions,
            &in_cad,
        );
    }
}

/// Values, standard deviations and factors of a quantity.
fn add_values(
    data: &mut ArrayDataset,
    (name, unit, meaning): (&str, &'static str, &str),
    dimensions: &[&'static str],
    frames: &[FunctionValues],
) {
    let all = |values: &dyn Fn(&FunctionValues) -> Vec<f64>| {
        ArrayValues::Numbers(frames.iter().flat_map(values).collect())
    };
    add_array(
        data,
        (name, unit, meaning),
        dimensions,
        all(&|one| one.values.clone()),
    );
    let sigma = format!("standard deviation: {meaning}");
    add_array(
        data,
        (&format!("sigma_{name}"), unit, &sigma),
        dimensions,
        all(&FunctionValues::sigmas),
    );
    let kinds = frames.first().map_or(0, |one| one.factors.len());
    for kind in 0..kinds {
        let source = frames[0].factors[kind].0;
        let sources = data
            .dimensions
            .iter()
            .find(|(dimension, _)| *dimension == source)
            .map_or(0, |(_, size)| *size);
        let entries = |one: &FunctionValues| {
            let factor = &one.factors[kind].1;
            let entry = |row: usize, k: usize| factor.get((row, k)).copied().unwrap_or(0.0);
            (0..factor.nrows())
                .flat_map(|row| (0..sources).map(move |k| entry(row, k)))
                .collect()
        };
        if sources > 0 {
            let with_sources = [dimensions, &[source]].concat();
            let text = format!("factor of the covariance, sources {source}: {meaning}");
            add_array(
                data,
                (&format!("{name}_{source}"), unit, &text),
                &with_sources,
                all(&entries),
            );
        }
    }
}

/// Attributes that say how to read the arrays.
fn add_facts(
    data: &mut ArrayDataset,
    shape: &JointShape,
    installation: &Installation,
    jointly: bool,
) {
    let errors = match jointly {
        true => {
            "value = truth + lasting u + shared s + own e, all of u, s, e independent with standard deviation 1: u is common \
             to all flights with the same installation, s to the frames of this flight, e belongs to each frame"
        }
        false => {
            "value = truth + own e, with e independent with standard deviation 1 within a frame; the frames were adjusted \
             singly, so the errors that they have in common are not known: run `wingd solve STORE` to compare or average them"
        }
    };
    let of_fit = "; displacements in the CAD frame: + fit c, with c common to all flights with the same tie points";
    let errors = format!(
        "{errors}{}",
        if installation.cad.is_some() {
            of_fit
        } else {
            ""
        }
    );
    let thermal = installation
        .setup
        .thermal
        .as_ref()
        .map_or(1.0, |thermal| thermal.scale());
    let facts = [
        ("title", "shape of a wing in flight".to_owned()),
        ("installation", installation.setup.name.clone()),
        (
            "frame_of_reference",
            "survey frame of the installation; z up".to_owned(),
        ),
        (
            "reference",
            "the wing as surveyed, with its load at the survey".to_owned(),
        ),
        ("errors", errors),
        ("length_to_tip_m", format!("{:.6}", shape.length_m)),
        ("outermost_marker_m", format!("{:.6}", shape.reach_m)),
        ("thermal_scale", format!("{thermal:.9}")),
    ];
    data.attributes
        .extend(facts.map(|(name, text)| (name.to_owned(), text)));
    let flow = installation
        .setup
        .flow_direction
        .map(|flow| format!("{}, {}", flow.x, flow.y));
    let flow = flow
        .unwrap_or_else(|| "unknown: streamwise_twist is missing; give wing.flow_direction".into());
    data.attributes.push(("flow_direction".to_owned(), flow));
}
