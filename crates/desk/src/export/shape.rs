//! Joint shapes of flights as a dataset (docs/shapes.md): motions of stations and markers, and factors of their covariance.

mod arrays;
mod reduction;

use std::rc::Rc;

use jiff::Timestamp;
use nalgebra::{DMatrix, DVector};
use serde_json::{Value, json};

use self::reduction::{append_moments, reduce_shapes};
use super::dataset::ArrayDataset;
use wingd_evaluation::aircraft::AircraftState;
use wingd_evaluation::installation::Installation;
use wingd_measure::adjust::{FrameShape, GlobalTest, JointShape};
use wingd_measure::setup::{Width, WingSide};

/// Version of the format; later versions add variables and change no meaning.
const FORMAT_VERSION: i32 = 2;
/// Fraction of the variance of a value, and of its deviation from the mean of the frames, that reduced factors may lose.
const LOST_VARIANCE: f64 = 1e-4;

/// Shape of a frame.
pub struct DatedShape {
    pub flight: String,
    /// Random id of the recorder's store, or empty.
    pub recorder_id: String,
    /// Series and file.
    pub name: String,
    /// Time of the exposure with its standard deviation, s; `None` if it is not known.
    pub time: Option<(Timestamp, Option<f64>)>,
    /// Aircraft data at the exposure.
    pub conditions: AircraftState,
    pub shape: FrameShape,
    /// Status of the result, and the reason for a status other than `ok`.
    pub status: String,
    pub reason: Option<String>,
    pub global_test: Option<GlobalTest>,
    /// Variance factor of the adjustment.
    pub variance_factor: Option<f64>,
    /// For each marker of the shape, whether it was not used.
    pub predicted: Vec<bool>,
    /// Key of the result's inputs.
    pub inputs: String,
    /// Digests of the sources of errors, by the kinds of [`DIGESTS`].
    pub sources: [String; 4],
}

/// Kinds of sources: common to an installation, a flight, a frame, and the stiffness of sections.
const SOURCES: [&str; 4] = ["lasting", "shared", "own", "stiffness"];
/// Kinds of sources that have digests; the last is that of the tie points of a CAD model.
const DIGESTS: [&str; 4] = ["lasting", "shared", "own", "fit"];
/// Basis of the reduced lasting factors.
const BASIS: &str = "lasting_basis";
/// Axes of each frame of reference.
const AXES: [&str; 3] = ["x", "y", "z"];
/// References of a marker's deflections, as in [`wingd_measure::adjust::DeflectionReference`].
const REFERENCES: [&str; 3] = ["survey", "ground", "root"];

/// Array of functions of a shape.
#[derive(PartialEq)]
struct ShapeArray {
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    /// Dimensions after `frame`.
    dimensions: &'static [&'static str],
    /// Rows of its values in the functions of the shape.
    rows: Vec<usize>,
    /// Indices in [`SOURCES`] of the kinds whose factors are written.
    kinds: &'static [usize],
}

/// Lists the arrays of a shape with a number of sections. The moments, which follow from the adjusted functions, come after
/// them.
fn shape_arrays(shape: &JointShape, sections: usize) -> Vec<ShapeArray> {
    let array = |name, unit, meaning, dimensions, rows| ShapeArray {
        name,
        unit,
        meaning,
        dimensions,
        rows,
        kinds: &[0, 1, 2],
    };
    let contiguous = |first: usize, count: usize| Vec::from_iter(first..first + count);
    let (moments, markers) = (shape.scale_function() + 1, 3 * shape.markers.len());
    vec![
        array(
            "displacement",
            "m",
            "displacement of the bending axis relative to the survey, survey frame",
            &["eta", "axis"],
            station_rows(shape, 0, 3),
        ),
        array(
            "slope",
            "rad",
            "change of the slope along the span, tip up",
            &["eta"],
            station_rows(shape, 3, 1),
        ),
        array(
            "twist",
            "rad",
            "twist about the bending axis, nose up",
            &["eta"],
            station_rows(shape, 4, 1),
        ),
        array(
            "streamwise_twist",
            "rad",
            "change of the incidence in the vertical plane of the flow, nose up",
            &["eta"],
            station_rows(shape, 5, 1),
        ),
        array(
            "rotation",
            "rad",
            "rotation vector of the section, survey frame",
            &["eta", "axis"],
            station_rows(shape, 6, 3),
        ),
        array(
            "marker_displacement",
            "m",
            "displacement of the marker relative to the survey, survey frame",
            &["marker", "axis"],
            contiguous(shape.marker_function(0), markers),
        ),
        array(
            "marker_deflection",
            "m",
            "vertical deflection of the marker, up",
            &["marker", "reference"],
            contiguous(shape.deflection_function(0), markers),
        ),
        array(
            "thermal_scale",
            "1",
            "length in flight over length on the ground",
            &[],
            vec![shape.scale_function()],
        ),
        ShapeArray {
            kinds: &[0, 1, 2, 3],
            ..array(
                "bending_moment",
                "N m",
                "bending moment relative to the ground, positive if it bends the tip up",
                &["section"],
                contiguous(moments, sections),
            )
        },
    ]
}

/// Rows of the stations' functions, `count` of each from the one that has the index `first` in [`STATION_FUNCTIONS`].
///
/// [`STATION_FUNCTIONS`]: wingd_measure::adjust::STATION_FUNCTIONS
fn station_rows(shape: &JointShape, first: usize, count: usize) -> Vec<usize> {
    let of_station = |s| (first..first + count).map(move |f| shape.station_function(f, s));
    (0..shape.arcs_m.len()).flat_map(of_station).collect()
}

/// Shape as it is written.
struct ExportedShape {
    dated: DatedShape,
    /// Factors of the covariance by the kinds of [`SOURCES`] (functions x sources).
    factors: [DMatrix<f64>; 4],
    /// Standard deviations of the functions by all of their errors.
    sigmas: DVector<f64>,
    /// Standard deviations that the reduced factors do not carry, by the first three kinds.
    rests: [DVector<f64>; 3],
    /// Basis of the lasting factors (sources x reduced sources).
    basis: Option<Rc<DMatrix<f64>>>,
}

/// Shapes of flights with the same stations and markers, for one file.
pub struct ShapeExport {
    shape: JointShape,
    /// Places on the ground, and attributes.
    places: ArrayDataset,
    arrays: Vec<ShapeArray>,
    shapes: Vec<ExportedShape>,
    /// True if factors are written without reduction.
    is_full: bool,
}

impl ShapeExport {
    /// Creates an export of an installation's flights without shapes; `is_full`: factors are not reduced.
    pub fn new(shape: &JointShape, installation: &Installation, is_full: bool) -> Self {
        let facts = facts(shape, installation, is_full);
        let places = arrays::describe_places(shape, installation, facts);
        let arrays = shape_arrays(shape, places.size_of("section"));
        Self {
            shape: JointShape {
                frames: vec![],
                solutions: vec![],
                ..shape.clone()
            },
            places,
            arrays,
            shapes: vec![],
            is_full,
        }
    }

    /// Adds the shapes of a flight.
    pub fn add_flight(&mut self, dated: Vec<DatedShape>, installation: &Installation) {
        let measured = dated
            .into_iter()
            .map(|one| self.complete_shape(one, installation));
        let mut shapes = Vec::from_iter(measured);
        if !self.is_full {
            reduce_shapes(&mut shapes);
        }
        self.shapes.extend(shapes);
    }

    /// Returns true if both have the same stations, markers and frames of reference, so that one file holds them.
    pub fn has_same_places(&self, other: &Self) -> bool {
        // Each flight estimates the bending axis on the ground.
        let given = |one: &Self| {
            let mut places = one.places.clone();
            places
                .arrays
                .retain(|array| array.name != "ground_position");
            places
        };
        given(self) == given(other) && self.arrays == other.arrays
    }

    /// Appends the shapes of another export with the same places.
    pub fn append(&mut self, other: Self) {
        self.shapes.extend(other.shapes);
    }

    /// Adds the functions that follow from the adjusted ones, and computes standard deviations.
    fn complete_shape(&self, mut dated: DatedShape, installation: &Installation) -> ExportedShape {
        let shape = &mut dated.shape;
        let first = shape.values.len();
        let of_moments = append_moments(shape, &self.shape, installation);
        let count = shape.values.len();
        let mut stiffness = DMatrix::zeros(count, of_moments.ncols());
        let mut rows = stiffness.rows_mut(first, of_moments.nrows());
        rows.copy_from(&of_moments);
        let [lasting, shared, own] = std::mem::take(&mut shape.factors);
        let factors = [lasting, shared, own, stiffness];
        let sigma = |k: usize| match shape.values[k].is_nan() {
            true => f64::NAN,
            false => factors
                .iter()
                .map(|f| f.row(k).norm_squared())
                .sum::<f64>()
                .sqrt(),
        };
        ExportedShape {
            sigmas: DVector::from_fn(count, |k, _| sigma(k)),
            rests: Default::default(),
            basis: None,
            factors,
            dated,
        }
    }
}

/// Attributes that say how to read the arrays.
fn facts(
    shape: &JointShape,
    installation: &Installation,
    is_full: bool,
) -> Vec<(&'static str, Value)> {
    let errors = "value = truth + lasting u + shared s + own e, all of u, s, e independent with standard deviation 1: u is \
         common to all flights with the same installation, s to the frames of a flight, e belongs to each frame; frames that \
         were adjusted singly have own alone, and the errors that they have in common are not known; NAME_SOURCE_rest is the \
         standard deviation that reduced factors do not carry";
    let setup = &installation.setup;
    let side = match setup.side() {
        Some(WingSide::Left) => "left",
        Some(WingSide::Right) => "right",
        None => "",
    };
    let mut facts = vec![
        ("Conventions", json!("CF-1.8")),
        ("format", json!("wingd shape")),
        ("format_version", json!(FORMAT_VERSION)),
        ("title", json!("shape of a wing in flight")),
        ("installation", json!(setup.name)),
        ("side", json!(side)),
        (
            "frame_of_reference",
            json!("survey frame of the installation; z up"),
        ),
        ("reference", json!("survey")),
        ("errors", json!(errors)),
        ("factors", json!(if is_full { "full" } else { "reduced" })),
        ("length_to_tip_m", json!(shape.length_m)),
        ("outermost_marker_m", json!(shape.reach_m)),
        (
            "root_offset_sigma_m",
            json!(setup.uncertainty[Width::RootOffset]),
        ),
    ];
    let flow = setup
        .flow_direction
        .map(|flow| ("flow_direction", json!([flow.x, flow.y])));
    facts.extend(flow);
    facts
}
