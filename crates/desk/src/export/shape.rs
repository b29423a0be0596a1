//! Joint shapes of flights as a dataset (docs/shapes.md): motions of stations and markers, and factors of their covariance.

use std::collections::BTreeMap;
use std::rc::Rc;

use jiff::Timestamp;
use nalgebra::{DMatrix, DVector, SMatrix, SymmetricEigen, Vector3};

use super::dataset::{ArrayDataset, ArrayValues, AttributeValue, NamedArray};
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::record::variant_name;
use wingd_measure::adjust::{GlobalTest, JointShape, ShapeMean, principal_sources};
use wingd_measure::geometry::TransformFit;
use wingd_measure::observation::Estimate;
use wingd_measure::setup::{Width, WingSide};
use wingd_measure::stress::{BendingCurvature, DEFAULT_STEPS};

/// Version of the format; later versions add variables and change no meaning.
const FORMAT_VERSION: i32 = 2;
/// Fraction of the variance that reduced factors may lose.
const LOST_VARIANCE: f64 = 1e-4;

/// Shape of a frame, or mean of several.
pub struct DatedShape {
    pub flight: String,
    /// Random id of the recorder's store, or empty.
    pub recorder_id: String,
    /// Series, or series and file.
    pub name: String,
    /// Time of the first frame's exposure with its standard deviation, s; `None` if it is not known.
    pub time: Option<(Timestamp, Option<f64>)>,
    pub time_synchronised: bool,
    /// Number of frames.
    pub count: usize,
    /// Aircraft data at the exposure, means of several frames.
    pub conditions: BTreeMap<Quantity, Estimate>,
    pub shape: ShapeMean,
    /// Status of the results, and the reason for a status other than `ok`.
    pub status: String,
    pub reason: Option<String>,
    pub global_test: Option<GlobalTest>,
    /// Mean variance factor of the adjustments.
    pub variance_factor: Option<f64>,
    /// True if factors are scaled by the root of the variance factor.
    pub posterior: bool,
    /// For each marker of the shape, whether it was used in no frame.
    pub predicted: Vec<bool>,
    /// Key of the results' inputs.
    pub inputs: String,
    /// Digests of the sources of errors, in the order of [`SOURCES`].
    pub sources: [String; 4],
}

/// Kinds of sources, common to an installation, a flight, a frame, and the tie points of a CAD model.
pub const SOURCES: [&str; 4] = ["lasting", "shared", "own", "fit"];
/// Basis of the reduced lasting factors.
const BASIS: &str = "lasting_basis";

/// Array of a shape.
struct ShapeArray {
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    /// Dimensions after `frame`.
    dimensions: Vec<&'static str>,
    /// Rows of its values in the functions of the shape.
    rows: Vec<usize>,
    /// True if it is also given in the CAD frame.
    in_cad: bool,
}

/// Arrays of stations: name, unit, meaning, and the first of its functions of each station ([`STATION_FUNCTIONS`]) with their
/// number.
///
/// [`STATION_FUNCTIONS`]: wingd_measure::adjust::STATION_FUNCTIONS
const STATION_ARRAYS: [(&str, &str, &str, usize, usize); 5] = [
    (
        "displacement",
        "m",
        "displacement of the bending axis relative to the survey",
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

/// Lists the arrays of a shape whose values are functions of it.
fn shape_arrays(shape: &JointShape) -> Vec<ShapeArray> {
    let stations = STATION_ARRAYS.map(|(name, unit, meaning, function, components)| {
        let rows = |s| (0..components).map(move |c| shape.station_function(function + c, s));
        ShapeArray {
            name,
            unit,
            meaning,
            dimensions: [&["eta"][..], &["axis"][..components / 3]].concat(),
            rows: (0..shape.arcs_m.len()).flat_map(rows).collect(),
            in_cad: unit == "m",
        }
    });
    let of_markers = |first: usize| (first..first + 3 * shape.markers.len()).collect();
    let markers = [
        ShapeArray {
            name: "marker_displacement",
            unit: "m",
            meaning: "displacement of the marker relative to the survey",
            dimensions: vec!["marker", "axis"],
            rows: of_markers(shape.marker_function(0)),
            in_cad: true,
        },
        ShapeArray {
            name: "marker_deflection",
            unit: "m",
            meaning: "vertical deflection of the marker, up",
            dimensions: vec!["marker", "reference"],
            rows: of_markers(shape.deflection_function(0)),
            in_cad: false,
        },
    ];
    let scale = ShapeArray {
        name: "thermal_scale",
        unit: "1",
        meaning: "length in flight over length on the ground",
        dimensions: vec![],
        rows: vec![shape.scale_function()],
        in_cad: false,
    };
    stations.into_iter().chain(markers).chain([scale]).collect()
}

/// Shape with reduced factors.
struct ReducedShape {
    dated: DatedShape,
    /// Standard deviations of the functions by all of their errors.
    sigmas: DVector<f64>,
    /// Standard deviations that the reduced factors do not carry, by the first three kinds of [`SOURCES`].
    rests: [DVector<f64>; 3],
    /// Basis of the lasting factors (sources x reduced sources).
    basis: Option<Rc<DMatrix<f64>>>,
    /// Displacements in the CAD frame, by array.
    cad: BTreeMap<&'static str, CadValues>,
    /// Factor of the moments by the errors of stiffness and root.
    stiffness: DMatrix<f64>,
}

/// Displacements in the CAD frame, three values each.
struct CadValues {
    values: Vec<f64>,
    sigmas: Vec<f64>,
    /// Factor of the errors of rotation and scale.
    fit: DMatrix<f64>,
}

/// Factors of the covariance, in the order of [`SOURCES`].
fn factors(shape: &ShapeMean) -> [&DMatrix<f64>; 3] {
    [&shape.lasting, &shape.shared, &shape.own]
}

/// Shapes of flights with the same stations and markers, for one file.
pub struct ShapeExport {
    shape: JointShape,
    marker_ids: Vec<String>,
    ground_m: Vec<f64>,
    marker_ground_m: Vec<f64>,
    cad: Option<TransformFit>,
    sections_m: Vec<f64>,
    arrays: Vec<ShapeArray>,
    shapes: Vec<ReducedShape>,
    facts: Vec<(&'static str, AttributeValue)>,
    /// True if factors are written without reduction.
    is_full: bool,
}

impl ShapeExport {
    /// Creates an export of an installation's flights without shapes; `is_full`: factors are not reduced.
    pub fn new(shape: &JointShape, installation: &Installation, is_full: bool) -> Self {
        let sections = installation.structure.as_ref().map(|s| &s.sections[..]);
        let sections_m = sections.unwrap_or_default().iter().map(|s| s.s_m).collect();
        let markers = || {
            shape
                .markers
                .iter()
                .map(|m| &installation.setup.markers[*m])
        };
        let mut export = Self {
            shape: JointShape {
                frames: vec![],
                ..shape.clone()
            },
            marker_ids: markers().map(|m| m.id.clone()).collect(),
            ground_m: flatten(shape.ground_m.iter()),
            marker_ground_m: flatten(markers().map(|m| &m.position_m)),
            cad: installation.cad.clone(),
            sections_m,
            arrays: shape_arrays(shape),
            shapes: vec![],
            facts: facts(shape, installation, is_full),
            is_full,
        };
        let first = shape.scale_function() + 1;
        export.arrays.push(ShapeArray {
            name: MOMENT,
            unit: "N m",
            meaning: "bending moment relative to the ground, positive if it bends the tip up",
            dimensions: vec!["section"],
            rows: (first..first + export.sections_m.len()).collect(),
            in_cad: false,
        });
        export
    }

    /// Returns true if both have the same stations, markers and frames of reference, so that one file holds them.
    pub fn has_same_places(&self, other: &Self) -> bool {
        let places = |one: &Self| {
            let cad = one.cad.as_ref().map(|fit| fit.transform);
            let sizes = (one.shape.curvature_terms, one.sections_m.clone());
            (
                one.shape.arcs_m.clone(),
                one.shape.length_m,
                one.marker_ids.clone(),
                one.marker_ground_m.clone(),
                cad,
                sizes,
                one.facts.clone(),
            )
        };
        places(self) == places(other)
    }

    /// Adds the shapes of a flight.
    pub fn add_flight(&mut self, dated: Vec<DatedShape>, installation: &Installation) {
        let mut shapes: Vec<ReducedShape> = dated
            .into_iter()
            .map(|dated| self.measure_shape(dated, installation))
            .collect();
        if !self.is_full {
            reduce_shapes(&mut shapes);
        }
        self.shapes.extend(shapes);
    }

    /// Appends the shapes of another export with the same places.
    pub fn append(&mut self, other: Self) {
        self.shapes.extend(other.shapes);
    }

    /// Adds the moments to a shape's functions, and computes standard deviations and displacements in the CAD frame.
    fn measure_shape(&self, mut dated: DatedShape, installation: &Installation) -> ReducedShape {
        let stiffness = add_moments(&mut dated.shape, &self.shape, installation);
        let shape = &dated.shape;
        let mut variances = DVector::zeros(shape.values.len());
        for factor in factors(shape) {
            let columns = factor.column_iter();
            columns.for_each(|column| variances += column.component_mul(&column));
        }
        let first = variances.len() - stiffness.nrows();
        for (k, row) in stiffness.row_iter().enumerate() {
            variances[first + k] += row.norm_squared();
        }
        let sigma = |k: usize| match shape.values[k].is_nan() {
            true => f64::NAN,
            false => variances[k].sqrt(),
        };
        let sigmas = DVector::from_fn(variances.len(), |k, _| sigma(k));
        let in_cad = self.arrays.iter().filter(|array| array.in_cad);
        let cad = self.cad.as_ref().map(|fit| {
            in_cad
                .map(|array| (array.name, CadValues::new(shape, &array.rows, fit)))
                .collect()
        });
        ReducedShape {
            cad: cad.unwrap_or_default(),
            rests: [0; 3].map(|_| DVector::zeros(0)),
            basis: None,
            dated,
            sigmas,
            stiffness,
        }
    }

    /// Creates the dataset; `attributes` of the store are included.
    pub fn to_dataset(&self, attributes: Vec<(String, AttributeValue)>) -> ArrayDataset {
        let columns = |kind: usize| {
            let of = |one: &ReducedShape| factors(&one.dated.shape)[kind].ncols();
            self.shapes.iter().map(of).max().unwrap_or(0)
        };
        let bases = self.shapes.iter().filter_map(|one| one.basis.as_ref());
        let sections = self.sections_m.len();
        let dimensions = vec![
            ("frame", self.shapes.len()),
            ("eta", self.shape.arcs_m.len()),
            ("marker", self.marker_ids.len()),
            ("axis", AXES.len()),
            ("reference", REFERENCES.len()),
            ("row", 4),
            ("column", 4),
            (SOURCES[0], columns(0)),
            (SOURCES[1], columns(1)),
            (SOURCES[2], columns(2)),
            (SOURCES[3], if self.cad.is_some() { 4 } else { 0 }),
            (
                "lasting_source",
                bases.map(|b| b.nrows()).max().unwrap_or(0),
            ),
            ("section", sections),
            ("stiffness", if sections > 0 { sections + 1 } else { 0 }),
        ];
        let facts = self.facts.iter().cloned();
        let mut data = ArrayDataset {
            dimensions,
            arrays: vec![],
            coordinates: vec!["arc_length", "time", "image", "flight", "recorder_id"],
            attributes: attributes
                .into_iter()
                .chain(facts.map(|(name, value)| (name.to_owned(), value)))
                .collect(),
        };
        self.add_places(&mut data);
        self.add_frames(&mut data);
        self.arrays
            .iter()
            .for_each(|array| self.add_functions(&mut data, array));
        data
    }

    /// Adds indices, and places on the ground.
    fn add_places(&self, data: &mut ArrayDataset) {
        let numbers = |values: Vec<f64>| ArrayValues::Numbers(values);
        let texts =
            |texts: &[&str]| ArrayValues::Texts(texts.iter().map(|t| (*t).to_owned()).collect());
        let arcs = &self.shape.arcs_m;
        // Rounded, so that a given fraction is found as such.
        let eta = |arc_m: &f64| (arc_m / self.shape.length_m * 1e12).round() * 1e-12;
        let mut add = |name: &str, unit, meaning: &str, dimensions: &[&'static str], values| {
            add_array(data, (name, unit, meaning), dimensions, values)
        };
        let meaning = "arc length over that of the model's tip";
        let etas = arcs
            .iter()
            .map(eta)
            .map(|eta| format!("{eta:.12}").parse().unwrap_or(eta));
        add("eta", "1", meaning, &["eta"], numbers(etas.collect()));
        let meaning = "arc length from the bending root along the axis on the ground";
        add("arc_length", "m", meaning, &["eta"], numbers(arcs.clone()));
        let ids = ArrayValues::Texts(self.marker_ids.clone());
        add("marker", "", "id in the survey", &["marker"], ids);
        add(
            "axis",
            "",
            "axis of the frame of reference",
            &["axis"],
            texts(&AXES),
        );
        let meaning = "reference of a deflection";
        add("reference", "", meaning, &["reference"], texts(&REFERENCES));
        let meaning = "arc length of a section of known stiffness from the bending root";
        add(
            "section",
            "m",
            meaning,
            &["section"],
            numbers(self.sections_m.clone()),
        );
        for source in &SOURCES {
            let count = data_size(&data.dimensions, source);
            let counts = numbers((0..count).map(|k| k as f64).collect());
            add_array(data, (source, "1", "source of errors"), &[source], counts);
        }
        let mut add = |name: &str, unit, meaning: &str, dimensions: &[&'static str], values| {
            add_array(data, (name, unit, meaning), dimensions, values)
        };
        let meaning = "bending axis on the ground, survey frame";
        let values = numbers(self.ground_m.clone());
        add("ground_position", "m", meaning, &["eta", "axis"], values);
        let values = numbers(self.marker_ground_m.clone());
        let meaning = "surveyed position, survey frame";
        add(
            "marker_ground_position",
            "m",
            meaning,
            &["marker", "axis"],
            values,
        );
        if let Some(fit) = &self.cad {
            let linear = fit.transform.rotation.matrix() * fit.transform.scale;
            let entry = |i: usize, j: usize| match (i, j) {
                (3, _) => f64::from(u8::from(j == 3)),
                (_, 3) => fit.transform.translation_m[i],
                _ => linear[(i, j)],
            };
            let matrix = (0..4).flat_map(|i| (0..4).map(move |j| entry(i, j)));
            let meaning = "transform of points from the survey to the CAD frame, m";
            add(
                "cad_from_survey",
                "1",
                meaning,
                &["row", "column"],
                numbers(matrix.collect()),
            );
        }
    }

    /// Adds names, times, tests, conditions and digests of the frames.
    fn add_frames(&self, data: &mut ArrayDataset) {
        let shapes = || self.shapes.iter().map(|one| &one.dated);
        let texts =
            |text: &dyn Fn(&DatedShape) -> String| ArrayValues::Texts(shapes().map(text).collect());
        let numbers = |value: &dyn Fn(&DatedShape) -> f64| {
            ArrayValues::Numbers(shapes().map(value).collect())
        };
        let flags =
            |flag: &dyn Fn(&DatedShape) -> bool| ArrayValues::Flags(shapes().map(flag).collect());
        let mut add = |name: &str, unit: &'static str, meaning: &str, values: ArrayValues| {
            add_array(data, (name, unit, meaning), &["frame"], values);
        };
        add(
            "image",
            "",
            "series and file, or series",
            texts(&|one| one.name.clone()),
        );
        add("flight", "", "flight", texts(&|one| one.flight.clone()));
        let ids = texts(&|one| one.recorder_id.clone());
        add("recorder_id", "", "id of the recorder's store", ids);
        let time = |one: &DatedShape| {
            one.time
                .map(|(time, _)| time.as_microsecond() as f64 * 1e-6)
        };
        let seconds = numbers(&|one| time(one).unwrap_or(f64::NAN));
        let meaning = "middle of the exposure, of the first frame";
        add(
            "time",
            "seconds since 1970-01-01 00:00:00",
            meaning,
            seconds,
        );
        let sigma = |one: &DatedShape| one.time.and_then(|(_, sigma)| sigma);
        let sigmas = numbers(&|one| sigma(one).unwrap_or(f64::NAN));
        add("sigma_time", "s", "standard deviation of the time", sigmas);
        let meaning = "1 if the clock was set by a reference";
        add(
            "time_synchronised",
            "1",
            meaning,
            flags(&|one| one.time_synchronised),
        );
        let meaning = "number of frames, of which the shape is the mean";
        add("frames", "1", meaning, numbers(&|one| one.count as f64));
        add(
            "status",
            "",
            "status of the result",
            texts(&|one| one.status.clone()),
        );
        let reasons = texts(&|one| one.reason.clone().unwrap_or_default());
        add("reason", "", "reason for a status other than ok", reasons);
        let meaning = "1 if the frames of the flight were adjusted jointly";
        add(
            "jointly",
            "1",
            meaning,
            flags(&|one| one.shape.lasting.ncols() > 0),
        );
        let tests = texts(&|one| one.global_test.map(variant_name).unwrap_or_default());
        add(
            "global_test",
            "",
            "test of the adjustment: passed or rejected",
            tests,
        );
        let factors = numbers(&|one| one.variance_factor.unwrap_or(f64::NAN));
        add(
            "variance_factor",
            "1",
            "variance factor of the adjustment",
            factors,
        );
        let meaning = "1 if the factors are scaled by the root of the variance factor";
        add("posterior", "1", meaning, flags(&|one| one.posterior));
        add(
            "inputs",
            "",
            "key of the results' inputs",
            texts(&|one| one.inputs.clone()),
        );
        for (kind, name) in SOURCES.iter().enumerate() {
            let digests = texts(&|one| one.sources[kind].clone());
            let meaning = "digest of the sources of errors";
            add(&format!("{name}_sources"), "", meaning, digests);
        }
        let mut quantities: Vec<_> = shapes()
            .flat_map(|one| one.conditions.keys().copied())
            .collect();
        quantities.sort_unstable();
        quantities.dedup();
        for quantity in quantities {
            let (name, unit) = (quantity.name(), condition_unit(quantity));
            let value = |one: &DatedShape| one.conditions.get(&quantity).map(|e| e.value);
            let values = numbers(&|one| value(one).unwrap_or(f64::NAN));
            add(name, unit, "aircraft data at the exposure", values);
            let sigma = |one: &DatedShape| one.conditions.get(&quantity).and_then(|e| e.sigma);
            let sigmas = numbers(&|one| sigma(one).unwrap_or(f64::NAN));
            add(
                &format!("sigma_{name}"),
                unit,
                "standard deviation of the instrument",
                sigmas,
            );
        }
        let predicted = shapes()
            .flat_map(|one| one.predicted.iter().copied())
            .collect();
        let meaning = "1 if the marker was not used and the adjusted shape predicts it";
        let array = ("predicted", "1", meaning);
        add_array(
            data,
            array,
            &["frame", "marker"],
            ArrayValues::Flags(predicted),
        );
        let sizes = ["lasting_source", SOURCES[0]].map(|name| data_size(&data.dimensions, name));
        let bases = self.shapes.iter().map(|one| one.basis.as_deref());
        let entries = bases
            .flat_map(|basis| padded_entries(basis, sizes))
            .collect();
        let array = (BASIS, "1", "basis of the reduced lasting factors");
        let dimensions = ["frame", "lasting_source", SOURCES[0]];
        add_array(data, array, &dimensions, ArrayValues::Singles(entries));
    }

    /// Adds values, standard deviations and factors of functions; displacements in the CAD frame too, if there is one.
    fn add_functions(&self, data: &mut ArrayDataset, array: &ShapeArray) {
        let ShapeArray {
            name,
            unit,
            meaning,
            rows,
            ..
        } = array;
        let dimensions = [&["frame"], &array.dimensions[..]].concat();
        let meaning_in = |frame: &str| match dimensions.contains(&"axis") {
            true => format!("{meaning}, {frame} frame"),
            false => (*meaning).to_owned(),
        };
        let meaning = meaning_in("survey");
        let all = |of: &dyn Fn(&ReducedShape, usize) -> f64| {
            let of_shape = |one| rows.iter().map(move |row| of(one, *row));
            ArrayValues::Numbers(self.shapes.iter().flat_map(of_shape).collect())
        };
        let values = all(&|one, row| one.dated.shape.values[row]);
        add_array(data, (name, unit, &meaning), &dimensions, values);
        let text = format!("standard deviation: {meaning}");
        let sigmas = all(&|one, row| one.sigmas[row]);
        add_array(
            data,
            (&format!("sigma_{name}"), unit, &text),
            &dimensions,
            sigmas,
        );
        if self
            .shapes
            .iter()
            .any(|one| one.dated.shape.scatter.is_some())
        {
            let text = format!("standard deviation of single frames about their mean: {meaning}");
            let scatter = |one: &ReducedShape, row: usize| {
                let of_shape = one.dated.shape.scatter.as_ref()?;
                of_shape.get(row).copied()
            };
            let values = all(&|one, row| scatter(one, row).unwrap_or(f64::NAN));
            add_array(
                data,
                (&format!("scatter_{name}"), unit, &text),
                &dimensions,
                values,
            );
        }
        for (kind, source) in SOURCES[..3].iter().enumerate() {
            let size = data_size(&data.dimensions, source);
            let entries = self.shapes.iter().flat_map(|one| {
                let factor = factors(&one.dated.shape)[kind];
                rows.iter().flat_map(move |row| {
                    (0..size).map(move |k| factor.get((*row, k)).copied().unwrap_or(0.0))
                })
            });
            let text = format!("factor of the covariance, sources {source}: {meaning}");
            let with_sources = [&dimensions[..], &[source]].concat();
            let values = match self.is_full {
                true => ArrayValues::Numbers(entries.collect()),
                false => ArrayValues::Singles(entries.map(|entry| entry as f32).collect()),
            };
            add_array(
                data,
                (&format!("{name}_{source}"), unit, &text),
                &with_sources,
                values,
            );
            if !self.is_full && size > 0 {
                let text = format!("standard deviation beside {name}_{source}: {meaning}");
                let rest = all(&|one, row| one.rests[kind].get(row).copied().unwrap_or(0.0));
                let array = (&*format!("{name}_{source}_rest"), *unit, &*text);
                add_array(data, array, &dimensions, rest);
            }
        }
        if *name == MOMENT {
            let size = data_size(&data.dimensions, "stiffness");
            let shapes = self.shapes.iter();
            let entries =
                shapes.flat_map(|one| padded_entries(Some(&one.stiffness), [rows.len(), size]));
            let text = "factor of the errors of stiffness and root, common to an installation";
            let array = (&*format!("{name}_stiffness"), *unit, text);
            let dimensions = ["frame", "section", "stiffness"];
            add_array(
                data,
                array,
                &dimensions,
                ArrayValues::Numbers(entries.map(f64::from).collect()),
            );
        }
        if array.in_cad && self.cad.is_some() {
            self.add_cad(data, array, &dimensions, &meaning_in("CAD"));
        }
    }

    fn add_cad(
        &self,
        data: &mut ArrayDataset,
        ShapeArray { name, unit, .. }: &ShapeArray,
        dimensions: &[&'static str],
        meaning: &str,
    ) {
        let all = |of: &dyn Fn(&CadValues) -> Vec<f64>| {
            let shapes = self.shapes.iter().filter_map(|one| one.cad.get(name));
            ArrayValues::Numbers(shapes.flat_map(of).collect())
        };
        let values = all(&|cad| cad.values.clone());
        add_array(
            data,
            (&format!("{name}_cad"), unit, meaning),
            dimensions,
            values,
        );
        let text = format!("standard deviation: {meaning}");
        let sigmas = all(&|cad| cad.sigmas.clone());
        add_array(
            data,
            (&format!("sigma_{name}_cad"), unit, &text),
            dimensions,
            sigmas,
        );
        let text = format!("factor of the covariance, sources fit: {meaning}");
        let fit = all(&|cad| cad.fit.transpose().iter().copied().collect());
        let with_sources = [dimensions, &[SOURCES[3]]].concat();
        add_array(
            data,
            (&format!("{name}_cad_fit"), unit, &text),
            &with_sources,
            fit,
        );
    }
}

/// Array of the bending moments.
const MOMENT: &str = "bending_moment";
const AXES: [&str; 3] = ["x", "y", "z"];
/// References of a marker's deflections, as in [`crate::record::DeflectionReference`].
const REFERENCES: [&str; 3] = ["survey", "ground", "root"];

fn flatten<'a>(points: impl Iterator<Item = &'a Vector3<f64>>) -> Vec<f64> {
    points.flat_map(|p| p.iter().copied()).collect()
}

fn data_size(dimensions: &[(&'static str, usize)], name: &str) -> usize {
    let found = dimensions.iter().find(|(dimension, _)| *dimension == name);
    found.map_or(0, |(_, size)| *size)
}

/// Entries of a matrix row by row, filled with zeros to a size.
fn padded_entries(
    matrix: Option<&DMatrix<f64>>,
    [rows, columns]: [usize; 2],
) -> impl Iterator<Item = f32> {
    let entry = move |i: usize, j: usize| {
        let known = matrix.and_then(|matrix| matrix.get((i, j)));
        known.map_or(0.0, |entry| *entry as f32)
    };
    (0..rows).flat_map(move |i| (0..columns).map(move |j| entry(i, j)))
}

/// Returns the unit of aircraft data by the suffix of its name.
fn condition_unit(quantity: Quantity) -> &'static str {
    const UNITS: [(&str, &str); 7] = [
        ("_m_s", "m s-1"),
        ("_m", "m"),
        ("_c", "degree_Celsius"),
        ("_hpa", "hPa"),
        ("_kg", "kg"),
        ("_deg", "degree"),
        ("_percent", "percent"),
    ];
    let has_suffix = |(suffix, _): &&(&str, &str)| quantity.name().ends_with(suffix);
    UNITS.iter().find(has_suffix).map_or("1", |(_, unit)| unit)
}

/// Adds the moments at the installation's sections to the functions of a shape, and returns their factor by the errors of
/// stiffness (one source for each section) and root (moments x sources).
fn add_moments(
    mean: &mut ShapeMean,
    shape: &JointShape,
    installation: &Installation,
) -> DMatrix<f64> {
    let sections = installation.structure.as_ref().map(|s| &s.sections[..]);
    let sections = sections.unwrap_or_default();
    let (first, count) = (shape.curvature_function(), shape.curvature_terms);
    let curvature = BendingCurvature {
        coefficients_per_m: mean.values.rows(first, count).into_owned(),
        covariance: DMatrix::zeros(count, count),
        length_m: shape.length_m,
        root_sigma_m: installation.setup.uncertainty[Width::RootOffset],
        steps: DEFAULT_STEPS,
    };
    let rows = mean.values.len();
    let mut stiffness = DMatrix::zeros(sections.len(), sections.len() + 1);
    let mut linear = DMatrix::zeros(sections.len(), count);
    for (k, section) in sections.iter().enumerate() {
        let moment = curvature.moment_function(section);
        stiffness[(k, k)] = moment.by_stiffness;
        stiffness[(k, sections.len())] = moment.by_root;
        linear.set_row(k, &moment.by_coefficient.transpose());
    }
    let extend = |matrix: &DMatrix<f64>| {
        let added = &linear * matrix.rows(first, count);
        let mut all = matrix.clone().resize_vertically(rows + sections.len(), 0.0);
        all.rows_mut(rows, sections.len()).copy_from(&added);
        all
    };
    mean.lasting = extend(&mean.lasting);
    mean.shared = extend(&mean.shared);
    mean.own = extend(&mean.own);
    let added = &linear * mean.values.rows(first, count);
    let joined = mean.values.iter().chain(added.iter()).copied();
    mean.values = DVector::from_iterator(rows + sections.len(), joined);
    stiffness
}

/// Reduces the factors of a flight's shapes to the sources that carry their variance and that of their differences.
fn reduce_shapes(shapes: &mut [ReducedShape]) {
    let take = |shapes: &[ReducedShape], kind: usize| -> Vec<DMatrix<f64>> {
        let of = |one: &ReducedShape| factors(&one.dated.shape)[kind].clone();
        shapes.iter().map(of).collect()
    };
    let [lasting, shared] = [0, 1].map(|kind| common_basis(&take(shapes, kind)));
    let basis = Rc::new(lasting);
    for one in shapes {
        let own = common_basis(std::slice::from_ref(&one.dated.shape.own));
        let shape = &mut one.dated.shape;
        let parts = [
            (&mut shape.lasting, &*basis),
            (&mut shape.shared, &shared),
            (&mut shape.own, &own),
        ];
        one.rests = parts.map(|(factor, basis)| {
            let reduced = &*factor * basis;
            let rest = |k: usize| {
                let lost = factor.row(k).norm_squared() - reduced.row(k).norm_squared();
                lost.max(0.0).sqrt()
            };
            let rests = DVector::from_fn(factor.nrows(), |k, _| rest(k));
            *factor = reduced;
            rests
        });
        one.basis = Some(Rc::clone(&basis)).filter(|basis| basis.ncols() > 0);
    }
}

/// Deviations from the mean of the frames below this fraction of a value's standard deviation are rounding.
const MIN_DEVIATION: f64 = 1e-9;

/// Returns the basis (sources x reduced sources) that carries the variance of factors with common sources, and that of
/// their deviations from the mean: in differences of frames, common errors cancel.
fn common_basis(factors: &[DMatrix<f64>]) -> DMatrix<f64> {
    let Some(first) = factors.first() else {
        return DMatrix::zeros(0, 0);
    };
    let (rows, sources) = first.shape();
    let sum = factors
        .iter()
        .fold(DMatrix::zeros(rows, sources), |sum, factor| sum + factor);
    let mean = sum / factors.len() as f64;
    let deviation = |factor: &DMatrix<f64>| {
        let mut off = factor - &mean;
        for (mut row, of_factor) in off.row_iter_mut().zip(factor.row_iter()) {
            if row.norm() <= MIN_DEVIATION * of_factor.norm() {
                row.fill(0.0);
            }
        }
        off
    };
    let deviations: Vec<_> = factors.iter().map(deviation).collect();
    let all = [factors, &deviations].concat();
    let known = |factor: &DMatrix<f64>| factor.row_iter().filter(|row| row.norm() > 0.0).count();
    let count: usize = all.iter().map(known).sum();
    principal_sources(&all, LOST_VARIANCE * count as f64)
}

impl CadValues {
    /// Transforms displacements, three values each, to the CAD frame. Its sources are those of rotation and scale.
    fn new(shape: &ShapeMean, rows: &[usize], fit: &TransformFit) -> Self {
        let linear = fit.transform.rotation.matrix() * fit.transform.scale;
        let of_fit = fit_factor(fit);
        let mut by_fit = DMatrix::zeros(rows.len(), of_fit.ncols());
        let (mut values, mut sigmas) = (vec![], vec![]);
        for (k, triple) in rows.chunks_exact(3).enumerate() {
            let moved = linear * Vector3::from_fn(|i, _| shape.values[triple[i]]);
            let mut jacobian = SMatrix::<f64, 3, 4>::zeros();
            jacobian
                .fixed_columns_mut::<3>(0)
                .copy_from(&-moved.cross_matrix());
            jacobian.set_column(3, &(moved / fit.transform.scale));
            let of_triple = jacobian * of_fit;
            by_fit.rows_mut(3 * k, 3).copy_from(&of_triple);
            let turned = factors(shape).map(|factor| linear * factor.select_rows(triple));
            let variance = |row: usize| {
                let parts = turned.iter().map(|factor| factor.row(row).norm_squared());
                parts.sum::<f64>() + of_triple.row(row).norm_squared()
            };
            values.extend(moved.iter());
            sigmas.extend((0..3).map(|row| match moved[row].is_nan() {
                true => f64::NAN,
                false => variance(row).sqrt(),
            }));
        }
        Self {
            values,
            sigmas,
            fit: by_fit,
        }
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

/// Attributes that say how to read the arrays.
fn facts(
    shape: &JointShape,
    installation: &Installation,
    is_full: bool,
) -> Vec<(&'static str, AttributeValue)> {
    let errors = "value = truth + lasting u + shared s + own e, all of u, s, e independent with standard deviation 1: u is \
         common to all flights with the same installation, s to the frames of a flight, e belongs to each frame; frames that \
         were adjusted singly have own alone, and the errors that they have in common are not known; displacements in the CAD \
         frame: + fit c, with c common to all flights with the same tie points; NAME_SOURCE_rest is the standard deviation \
         that reduced factors do not carry";
    let text = |text: &str| AttributeValue::Text(text.to_owned());
    let number = |number: f64| AttributeValue::Numbers(vec![number]);
    let setup = &installation.setup;
    let side = match setup.side() {
        Some(WingSide::Left) => "left",
        Some(WingSide::Right) => "right",
        None => "",
    };
    let mut facts = vec![
        ("Conventions", text("CF-1.8")),
        ("format", text("wingd shape")),
        ("format_version", AttributeValue::Count(FORMAT_VERSION)),
        ("title", text("shape of a wing in flight")),
        ("installation", text(&setup.name)),
        ("side", text(side)),
        (
            "frame_of_reference",
            text("survey frame of the installation; z up"),
        ),
        ("reference", text("survey")),
        ("errors", text(errors)),
        ("factors", text(if is_full { "full" } else { "reduced" })),
        ("length_to_tip_m", number(shape.length_m)),
        ("outermost_marker_m", number(shape.reach_m)),
    ];
    facts.extend(setup.flow_direction.map(|flow| {
        (
            "flow_direction",
            AttributeValue::Numbers(vec![flow.x, flow.y]),
        )
    }));
    facts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two factors of forty sources: one source carries nearly all, another the difference, the others are small.
    fn two_factors() -> [DMatrix<f64>; 2] {
        [1.0, -1.0].map(|sign| {
            DMatrix::from_fn(12, 40, |row, source| match source {
                0 => 1.0 + row as f64,
                1 => sign * 1e-2,
                _ => 1e-4 * ((row * 40 + source) as f64).sin(),
            })
        })
    }

    #[test]
    fn reduced_factors_carry_the_variance_of_values_and_of_differences() {
        let factors = two_factors();
        let basis = common_basis(&factors);
        assert!(
            basis.ncols() >= 2 && basis.ncols() < 12,
            "{}",
            basis.ncols()
        );
        let carried = |factor: &DMatrix<f64>| {
            let reduced = factor * &basis;
            let lost = 1.0 - reduced.norm_squared() / factor.norm_squared();
            assert!((0.0..2.0 * LOST_VARIANCE).contains(&lost), "{lost}");
        };
        factors.iter().for_each(carried);
        carried(&(&factors[0] - &factors[1]));
        // Factors without sources, as those of frames that were adjusted singly, stay so.
        assert_eq!(common_basis(&[DMatrix::zeros(3, 0)]).ncols(), 0);
    }

    #[test]
    fn conditions_have_the_unit_of_their_name() {
        let unit = |name: &str| {
            let named = Quantity::ALL.into_iter().find(|one| one.name() == name);
            condition_unit(named.unwrap())
        };
        assert_eq!(unit("mach"), "1");
        assert_eq!(unit("pressure_altitude_m"), "m");
        assert_eq!(unit("true_airspeed_m_s"), "m s-1");
        assert_eq!(unit("static_temperature_c"), "degree_Celsius");
        assert_eq!(unit("load_factor"), "1");
    }
}
