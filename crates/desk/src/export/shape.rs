//! Joint shapes of flights as a dataset (docs/shapes.md): motions of stations and markers, and factors of their covariance.

mod arrays;
mod reduction;

use std::collections::BTreeMap;
use std::rc::Rc;

use jiff::Timestamp;
use nalgebra::{DMatrix, DVector, Vector3};

use self::reduction::{add_moments, reduce_shapes};
use super::dataset::AttributeValue;
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::installation::Installation;
use wingd_measure::adjust::{GlobalTest, JointShape, ShapeMean};
use wingd_measure::geometry::TransformFit;
use wingd_measure::observation::Estimate;
use wingd_measure::setup::{Width, WingSide};

/// Version of the format; later versions add variables and change no meaning.
const FORMAT_VERSION: i32 = 2;
/// Fraction of the variance of a value, and of its deviation from the mean of the frames, that reduced factors may lose.
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
}

/// Array of the bending moments.
const MOMENT: &str = "bending_moment";
const AXES: [&str; 3] = ["x", "y", "z"];
/// References of a marker's deflections, as in [`crate::record::DeflectionReference`].
const REFERENCES: [&str; 3] = ["survey", "ground", "root"];

fn flatten<'a>(points: impl Iterator<Item = &'a Vector3<f64>>) -> Vec<f64> {
    points.flat_map(|p| p.iter().copied()).collect()
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
        (
            "root_offset_sigma_m",
            number(setup.uncertainty[Width::RootOffset]),
        ),
    ];
    facts.extend(setup.flow_direction.map(|flow| {
        (
            "flow_direction",
            AttributeValue::Numbers(vec![flow.x, flow.y]),
        )
    }));
    facts
}
