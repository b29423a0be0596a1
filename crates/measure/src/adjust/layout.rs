//! Column layout of a frame's unknowns.

mod conditions;

use std::sync::Arc;

use nalgebra::{DVector, Vector3};

use super::input::{AdjustmentInput, FrameObservations};
use super::marker_state::{DimensionDerivatives, MarkerState};
use super::prior_scales::PriorScales;
use super::term::{ColumnAllocator, ParameterScope, PlacedTerm};
use super::terms;
use super::values::UnknownValues;
use crate::estimation::{Gradient, Prior};
use crate::widths::{Unknown, Width};

/// Storage of the markers' positions on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundPositions {
    /// The first three observations of the marker's block.
    Observed,
    /// Global parameters, three per marker, from this column to the last.
    Global(usize),
}

/// Motion of individual markers in flight, one unknown per direction, shared by all frames: along the normal for the skin,
/// along all axes for a fixed target.
#[derive(Debug)]
pub struct MarkerMotions {
    /// Column of the first motion.
    first: usize,
    /// Directions of each marker on the ground (wing frame), and the index of its first unknown.
    per_marker: Vec<(Vec<Vector3<f64>>, usize)>,
}

const MISSING_MOTION: &str = "a marker's motion in flight cannot be determined";

impl MarkerMotions {
    /// Allocates the columns and their priors.
    pub fn allocate(
        input: &AdjustmentInput,
        scales: &PriorScales,
        columns: &mut ColumnAllocator,
    ) -> Self {
        let skin_motion_m = input.setup.uncertainty[Width::SkinMotion];
        let first = columns.missing.len();
        let mut per_marker = vec![];
        for (marker, station) in input.setup.markers.iter().zip(&input.scene.ground.stations) {
            let (unknown, sigma_m, directions) = if marker.fixed {
                let all = vec![Vector3::x(), Vector3::y(), Vector3::z()];
                (
                    Unknown::FixedTargetMotion,
                    scales.fixed_targets * marker.flight_motion_m,
                    all,
                )
            } else {
                (
                    Unknown::SkinMotion,
                    scales.skin * skin_motion_m,
                    vec![station.skin_normal],
                )
            };
            let directions = if sigma_m > 0.0 { directions } else { vec![] };
            let own = columns.allocate(directions.len(), MISSING_MOTION);
            let prior = |k| Prior::scalar(unknown, own + k, 0.0, sigma_m);
            columns.priors.extend((0..directions.len()).map(prior));
            per_marker.push((directions, own - first));
        }
        Self { first, per_marker }
    }

    /// Columns of a marker's motion.
    pub fn columns(&self, marker: usize) -> std::ops::Range<usize> {
        let (directions, own) = &self.per_marker[marker];
        self.first + own..self.first + own + directions.len()
    }

    /// Directions of a marker's motion on the ground, wing frame.
    pub fn directions(&self, marker: usize) -> &[Vector3<f64>] {
        &self.per_marker[marker].0
    }
}

/// Global parameters that are specific to a frame's mounting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MountingColumns {
    pub first: usize,
    pub count: usize,
}

/// Columns of all unknowns of one frame.
#[derive(Clone, Debug)]
pub struct ParameterLayout {
    /// Terms except the marker positions on the ground.
    pub terms: Vec<PlacedTerm>,
    /// Coefficients of the curvature (reported).
    pub curvature: ParameterScope,
    pub curvature_terms: usize,
    /// Coefficients of the twist (reported).
    pub twist: ParameterScope,
    pub twist_terms: usize,
    /// Components of the camera rotation (reported). The frames of a flight have a shared and an independent component.
    pub rotation: Vec<ParameterScope>,
    /// Height of the bending axis (reported).
    pub axis_height: ParameterScope,
    /// Expected thermal scale.
    pub expected_scale: f64,
    pub ground_positions: GroundPositions,
    /// Motion of each marker in flight.
    pub motions: Arc<MarkerMotions>,
    /// Derivatives of marker positions with respect to the estimated dimensions, if they do not follow the frame's unknowns.
    pub dimension_derivatives: Option<DimensionDerivatives>,
    /// The root's motion, which is excluded from deflections relative to the root tangent.
    pub root: Vec<PlacedTerm>,
    /// Number of leading global parameters that all blocks depend on.
    pub head: usize,
    /// Columns of the mounting.
    pub mounting: MountingColumns,
    /// Number of local parameters.
    pub local: usize,
}

impl ParameterLayout {
    /// Reads the values of a frame's unknowns.
    pub fn values(&self, global: &DVector<f64>, local: &DVector<f64>) -> UnknownValues {
        let mut values = UnknownValues {
            dimension_derivatives: self.dimension_derivatives.clone(),
            ..UnknownValues::nominal(self.expected_scale)
        };
        self.terms
            .iter()
            .for_each(|placed| placed.add_values(global, local, &mut values));
        values
    }

    /// Priors of the local parameters.
    pub fn local_priors(&self) -> Vec<Prior> {
        let priors_of = |placed: &PlacedTerm| match placed.scope {
            ParameterScope::Local(first) => placed
                .term
                .priors
                .iter()
                .map(|p| p.clone().shift_columns(first))
                .collect(),
            ParameterScope::Global(_) => vec![],
        };
        self.terms.iter().flat_map(priors_of).collect()
    }

    /// Local columns of an unknown, each with its prior standard deviation (mean 0).
    pub fn frame_columns(&self, unknown: Unknown) -> impl Iterator<Item = (usize, f64)> {
        self.terms
            .iter()
            .filter(move |placed| placed.term.unknown == unknown)
            .flat_map(|placed| {
                let first = if let ParameterScope::Local(first) = placed.scope {
                    Some(first)
                } else {
                    None
                };
                let sigma = |prior: &Prior| prior.covariance[(0, 0)].sqrt();
                let one = move |(k, prior)| first.map(|first| (first + k, sigma(prior)));
                placed.term.priors.iter().enumerate().filter_map(one)
            })
    }

    /// Returns the layout with the row times of another frame.
    pub fn with_row_times(
        &self,
        input: &AdjustmentInput,
        frame_observations: &FrameObservations,
    ) -> Self {
        let rows = terms::row_terms(input, frame_observations, &PriorScales::default());
        let row_term = |unknown| rows.iter().find(|term| term.unknown == unknown).cloned();
        let terms = self
            .terms
            .iter()
            .map(|placed| match row_term(placed.term.unknown) {
                Some(term) => PlacedTerm {
                    term: Arc::new(term),
                    scope: placed.scope,
                },
                None => placed.clone(),
            });
        Self {
            terms: terms.collect(),
            ..self.clone()
        }
    }

    /// Returns the part of the layout that concerns the ground frame, without bending and mounting.
    pub fn ground_layout(&self) -> Self {
        let shared = |placed: &&PlacedTerm| matches!(placed.scope, ParameterScope::Global(first) if first < self.head);
        Self {
            terms: self.terms.iter().filter(shared).cloned().collect(),
            mounting: MountingColumns { first: 0, count: 0 },
            local: 0,
            rotation: vec![],
            motions: self.motions.clone(),
            root: vec![],
            dimension_derivatives: None,
            ..*self
        }
    }

    /// Position of a marker on the ground, wing frame, m.
    pub fn ground_position(
        &self,
        marker: usize,
        global: &DVector<f64>,
        observed: &DVector<f64>,
    ) -> Vector3<f64> {
        match self.ground_positions {
            GroundPositions::Observed => Vector3::new(observed[0], observed[1], observed[2]),
            GroundPositions::Global(first) => {
                let c = first + 3 * marker;
                Vector3::new(global[c], global[c + 1], global[c + 2])
            }
        }
    }

    /// Position of a marker on the ground including its own in-flight motion, wing frame, m.
    pub fn moved_position(
        &self,
        marker: usize,
        ground_m: &Vector3<f64>,
        global: &DVector<f64>,
    ) -> Vector3<f64> {
        let columns = self.motions.columns(marker);
        let moved = self
            .motions
            .directions(marker)
            .iter()
            .zip(columns)
            .map(|(d, c)| d * global[c]);
        ground_m + moved.sum::<Vector3<f64>>()
    }

    /// Index of a global parameter among [`ParameterLayout::block_columns`].
    fn block_column(&self, first: usize) -> usize {
        if first < self.head {
            first
        } else {
            self.head + first - self.mounting.first
        }
    }

    /// Global columns of conditions on markers: the head, the mounting, and for each marker its position on the ground and
    /// its in-flight motion.
    pub fn block_columns(&self, markers: &[usize]) -> Vec<usize> {
        let own = markers.iter().flat_map(|&marker| {
            let position = match self.ground_positions {
                GroundPositions::Observed => 0..0,
                GroundPositions::Global(first) => first + 3 * marker..first + 3 * marker + 3,
            };
            position.chain(self.motions.columns(marker))
        });
        (0..self.head)
            .chain(self.mounting.first..self.mounting.first + self.mounting.count)
            .chain(own)
            .collect()
    }

    /// Index of the first marker's first column among [`ParameterLayout::block_columns`].
    pub fn survey_column(&self) -> usize {
        self.head + self.mounting.count
    }

    /// Index of the first marker's motion among [`ParameterLayout::block_columns`].
    fn motion_column(&self) -> usize {
        self.survey_column()
            + if self.ground_positions == GroundPositions::Observed {
                0
            } else {
                3
            }
    }

    /// Adds `value` to the derivative of a function with respect to an unknown. The columns of the gradient are
    /// [`ParameterLayout::block_columns`].
    pub fn add_derivative(
        &self,
        gradient: &mut Gradient,
        scope: ParameterScope,
        k: usize,
        function: usize,
        value: f64,
    ) {
        match scope {
            ParameterScope::Global(first) => {
                gradient.global[(self.block_column(first) + k, function)] += value
            }
            ParameterScope::Local(first) => gradient.local[(first + k, function)] += value,
        }
    }

    /// Adds `directions * d(position in flight)` to a gradient, one function per direction.
    pub fn add_position_derivative(
        &self,
        gradient: &mut Gradient,
        state: &MarkerState,
        directions: &[Vector3<f64>],
    ) {
        for (placed, k) in self.unknowns() {
            let by = placed.term.position_derivative(k, state);
            for (function, direction) in directions.iter().enumerate() {
                self.add_derivative(gradient, placed.scope, k, function, direction.dot(&by));
            }
        }
    }

    /// Iterates over all unknowns: the term and the column within it.
    pub fn unknowns(&self) -> impl Iterator<Item = (&PlacedTerm, usize)> {
        columns_of(&self.terms)
    }

    /// Iterates over the unknowns of the root's motion.
    pub fn root_unknowns(&self) -> impl Iterator<Item = (&PlacedTerm, usize)> {
        columns_of(&self.root)
    }
}

fn columns_of(terms: &[PlacedTerm]) -> impl Iterator<Item = (&PlacedTerm, usize)> {
    let columns = |placed: &PlacedTerm| 0..placed.term.size;
    terms
        .iter()
        .flat_map(move |placed| columns(placed).map(move |k| (placed, k)))
}

/// Marker of a block, and the position of its observations in the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockMember {
    /// Index in the survey.
    pub marker: usize,
    /// First of the two pixel coordinates in flight.
    pub flight: Option<usize>,
    /// First of the two pixel coordinates on ground.
    pub ground: Option<usize>,
}
