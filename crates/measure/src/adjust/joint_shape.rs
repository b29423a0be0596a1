//! Joint shape of the frames of a flight: motions of the wing's stations and markers with the covariance of all of them.
//!
//! The covariance is given as factors of independent sources with standard deviation 1, `value = true value + lasting u +
//! shared s + own e`: `u` is common to all flights of an installation, `s` to the frames of a flight, `e` belongs to one
//! frame. The matrix itself is of no use: a few combinations hold nearly all of the variance, and its inverse is noise.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};

use super::Solution;
use super::curve::AxisCurve;
use super::outcome::{FrameOutcome, MovedSection, MovedSections, SectionFunction};
use crate::estimation::Gradient;
use crate::widths::Unknown;

/// Functions of each station, in order: displacement of the bending axis in the survey frame, changes of slope and incidence
/// (tip up and nose up positive), and the rotation vector of the section in the survey frame.
pub const STATION_FUNCTIONS: [&str; 9] = [
    "displacement_x_m",
    "displacement_y_m",
    "displacement_z_m",
    "slope_rad",
    "twist_rad",
    "streamwise_twist_rad",
    "rotation_x_rad",
    "rotation_y_rad",
    "rotation_z_rad",
];

/// Largest part of a variance that a reduced factor may lose.
const LOST_VARIANCE: f64 = 1e-7;

/// Stations along the bending axis.
#[derive(Clone, Debug, PartialEq)]
pub enum StationChoice {
    /// Stations of the curves in the results, from the root to the outermost marker, and the tip of the model.
    Standard,
    /// Fractions, 0 to 1, of the length from the bending root to the tip of the model.
    Fractions(Vec<f64>),
}

/// Motions of stations and markers in all frames of a flight, with their joint covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct JointShape {
    /// Arc lengths of the stations from the bending root on the ground, m.
    pub arcs_m: Vec<f64>,
    /// Arc length from the bending root to the tip of the model, m.
    pub length_m: f64,
    /// Arc length of the outermost marker, m.
    pub reach_m: f64,
    /// Bending axis on the ground at the stations, survey frame, m.
    pub ground_m: Vec<Vector3<f64>>,
    /// Indices in the survey of the markers on the wing, in order.
    pub markers: Vec<usize>,
    /// Number of coefficients of the curvature.
    pub curvature_terms: usize,
    /// Frames, in order, and their results.
    pub frames: Vec<FrameShape>,
    pub solutions: Vec<Solution>,
    /// Indices of the frames that have no shape because they contradict the others, and why.
    pub left_out: Vec<(usize, String)>,
}

/// Shape in one frame, or mean of several. Functions are those of stations, displacements and deflections of markers, coefficients of the
/// curvature, and the thermal scale, by the methods of [`JointShape`]; a value that does not exist is NaN, and its rows of the
/// factors are 0.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameShape {
    /// Values of the functions.
    pub values: DVector<f64>,
    /// Factors of the errors that all flights of the installation share, of those that all frames of the flight share, and of
    /// the frame's own (functions x sources).
    pub factors: [DMatrix<f64>; 3],
}

impl JointShape {
    /// Returns the index of a station's function; see [`STATION_FUNCTIONS`].
    pub fn station_function(&self, function: usize, station: usize) -> usize {
        function * self.arcs_m.len() + station
    }

    /// Returns the index of the first of the three components of a marker's displacement, survey frame, m.
    pub fn marker_function(&self, marker: usize) -> usize {
        STATION_FUNCTIONS.len() * self.arcs_m.len() + 3 * marker
    }

    /// Returns the index of the first of the three deflections of a marker, by [`super::DeflectionReference`], m.
    pub fn deflection_function(&self, marker: usize) -> usize {
        self.marker_function(self.markers.len() + marker)
    }

    /// Returns the index of the first coefficient of the curvature, 1/m.
    pub fn curvature_function(&self) -> usize {
        self.deflection_function(self.markers.len())
    }

    /// Returns the index of the thermal scale, the length in flight over the length on the ground.
    pub fn scale_function(&self) -> usize {
        self.curvature_function() + self.curvature_terms
    }
}

/// Functions of a frame before the covariance of the shared parameters is known.
pub(super) struct ShapeFunctions {
    pub values: DVector<f64>,
    /// Derivatives with respect to the global parameters (functions x parameters).
    pub by_global: DMatrix<f64>,
    /// Factor of the frame's own errors.
    pub own: DMatrix<f64>,
}

/// Stations of a scene, wing markers, and the axis on the ground.
pub(super) fn empty_shape(outcome: &FrameOutcome, choice: &StationChoice) -> JointShape {
    let scene = outcome.solved.input.scene;
    let (ground, length_m) = (&scene.ground, scene.ground.axis.length_m);
    let standard = AxisCurve::standard_arcs_m(scene);
    let reach_m = standard.last().copied().unwrap_or_default();
    let arcs_m = match choice {
        StationChoice::Standard => [&standard[..], &[length_m]].concat(),
        StationChoice::Fractions(list) => list.iter().map(|eta| eta * length_m).collect(),
    };
    let MovedSections { curve, .. } = outcome.moved_sections(arcs_m);
    let ground_m = curve
        .flat
        .iter()
        .map(|section| ground.frame.survey_point(&section.axis_m))
        .collect();
    let markers = (0..ground.stations.len())
        .filter(|k| !scene.is_fixed(*k))
        .collect();
    JointShape {
        arcs_m: curve.arcs_m,
        length_m,
        reach_m,
        ground_m,
        markers,
        curvature_terms: outcome.layout.curvature_terms,
        frames: vec![],
        left_out: vec![],
        solutions: vec![],
    }
}

impl FrameOutcome<'_> {
    /// Evaluates the functions of a shape's stations and markers in this frame.
    pub(super) fn shape_functions(&self, shape: &JointShape) -> ShapeFunctions {
        let moved = self.moved_sections(shape.arcs_m.clone());
        let sections = &moved.sections;
        let survey_from_wing = self
            .solved
            .input
            .scene
            .ground
            .frame
            .wing_from_survey
            .inverse();
        let axes: [Vector3<f64>; 3] =
            std::array::from_fn(|k| survey_from_wing.inverse() * Vector3::ith(k, 1.0));
        let flow = self.flow_in_wing();
        let functions: Vec<Vec<SectionFunction>> = (0..STATION_FUNCTIONS.len())
            .map(|f| {
                let of_section = |section: &MovedSection| match f {
                    0..3 => section.displacement(&axes[f]),
                    3 => section.slope(),
                    4 => section.twist(),
                    5 => flow.map_or(SectionFunction::UNKNOWN, |aft| {
                        section.streamwise_twist(&aft)
                    }),
                    _ => section.rotation(&axes[f - 6]),
                };
                sections.iter().map(of_section).collect()
            })
            .collect();
        let count = shape.scale_function() + 1;
        let mut gradient = self.empty_gradient(count, &shape.markers);
        self.add_section_functions(&mut gradient, &moved, &functions);
        let mut values: Vec<f64> = functions.iter().flatten().map(|f| f.value).collect();
        let mut deflections = Vec::with_capacity(3 * shape.markers.len());
        for (k, &marker) in shape.markers.iter().enumerate() {
            let (ground, state) = self.ground_position_and_flight_state(marker);
            let moved = state.carried.position_m - ground;
            let first = shape.deflection_function(k);
            let mut directions = vec![Vector3::zeros(); count];
            directions[values.len()..values.len() + 3].copy_from_slice(&axes);
            directions[first..first + 3].fill(Vector3::y());
            let on_ground: Vec<_> = directions.iter().map(|d| -d).collect();
            self.add_position(&mut gradient, &state, &directions, &on_ground);
            let references = [first, first + 1, first + 2];
            self.add_reference_derivatives(&mut gradient, &state, &moved, references);
            values.extend(axes.map(|axis| axis.dot(&moved)));
            let of_marker = self.marker_deflections(&state, &ground);
            deflections.extend(of_marker.unwrap_or([f64::NAN; 3]));
        }
        values.extend(deflections);
        values.extend(&self.values.curvature_per_m[..shape.curvature_terms]);
        values.push(self.values.scale);
        self.add_parameter_derivatives(&mut gradient, shape);
        let (by_global, own) = self
            .solved
            .fit
            .propagate_factors(self.solved.group, &gradient);
        let scale = self.scale();
        ShapeFunctions {
            values: values.into(),
            by_global: by_global * scale,
            own: own * scale,
        }
    }

    /// Adds the derivatives of the curvature's coefficients and of the thermal scale.
    fn add_parameter_derivatives(&self, gradient: &mut Gradient, shape: &JointShape) {
        let layout = self.layout;
        for k in 0..shape.curvature_terms {
            let function = shape.curvature_function() + k;
            layout.add_derivative(gradient, layout.curvature, k, function, 1.0);
        }
        for (placed, k) in layout.unknowns() {
            if placed.term.unknown == Unknown::ThermalScale {
                layout.add_derivative(gradient, placed.scope, k, shape.scale_function(), 1.0);
            }
        }
    }
}

/// Reduces factors of frames to fewer common sources.
pub(super) fn reduce_factors(factors: Vec<DMatrix<f64>>) -> Vec<DMatrix<f64>> {
    let basis = principal_sources(&factors, LOST_VARIANCE);
    factors.into_iter().map(|factor| factor * &basis).collect()
}

/// Returns an orthonormal basis (sources x reduced sources), in which no row loses more than `lost` of its variance.
pub fn principal_sources(factors: &[DMatrix<f64>], lost: f64) -> DMatrix<f64> {
    let sources = factors.first().map_or(0, DMatrix::ncols);
    if sources == 0 {
        return DMatrix::zeros(0, 0);
    }
    let mut normal = DMatrix::zeros(sources, sources);
    for factor in factors {
        let mut scaled = factor.clone();
        for mut row in scaled.row_iter_mut() {
            row.try_normalize_mut(0.0);
        }
        normal.gemm_tr(1.0, &scaled, &scaled, 1.0);
    }
    let SymmetricEigen {
        eigenvectors,
        eigenvalues,
    } = SymmetricEigen::new(normal);
    let mut order = Vec::from_iter(0..sources);
    order.sort_by(|a, b| eigenvalues[*b].total_cmp(&eigenvalues[*a]));
    let directions = eigenvectors.select_columns(&order);
    let mut kept = 0;
    for factor in factors {
        for row in (factor * &directions).row_iter() {
            let mut left = lost * row.norm_squared();
            let omits = |entry: &&f64| {
                left -= *entry * *entry;
                left >= 0.0
            };
            kept = kept.max(sources - row.iter().rev().take_while(omits).count());
        }
    }
    directions.columns(0, kept).into_owned()
}
