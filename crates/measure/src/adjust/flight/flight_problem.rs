//! A flight prepared for the estimation engine: shared unknowns, one group per frame, and survey and ground frame as the
//! last group. A frame alone has its survey and ground frame in its own group, so that each marker's position on the ground
//! is an observation and not an unknown.

use std::sync::Arc;

use nalgebra::{DVector, Matrix3};

use super::frames::Flight;
use super::knowledge::{EarlierFrames, Knowledge};
use super::shape::{ShapeColumns, SharedShape};
use crate::adjust::beam::{Bending, MAX_TWIST_TERMS};
use crate::adjust::budget::BlockMembers;
use crate::adjust::flight_prior::InvariantParameter;
use crate::adjust::input::AdjustmentInput;
use crate::adjust::layout::{
    BlockMember, GroundPositions, MarkerMotions, MountingColumns, ParameterLayout,
};
use crate::adjust::marker_state::DimensionDerivatives;
use crate::adjust::scene::WingScene;
use crate::adjust::term::{ColumnAllocator, ParameterScope, PlacedTerm};
use crate::adjust::terms::{self, SharedTerms};
use crate::estimation::{
    EstimationResult, Fit, GroupPoint, Linearised, Problem, SolveOptions, solve_groups,
};
use crate::setup::Thermal;
use crate::widths::{Unknown, Width};

const MISSING_GROUND: &str = "a marker's position on the ground cannot be determined";

/// A flight prepared for the estimation engine.
pub struct FlightProblem {
    /// Column layout of each frame.
    pub layouts: Vec<ParameterLayout>,
    /// Members of each frame's blocks.
    pub members: Vec<Vec<BlockMember>>,
    /// Members of the last group's blocks, with survey and ground-frame image.
    pub ground_members: Vec<BlockMember>,
    /// Problem for the estimation engine.
    pub problem: Problem,
    /// Shape of the curvature that the frames share; `None`: a frame alone.
    pub shape: Option<SharedShape>,
    /// Flight-invariant parameters with their columns.
    pub invariant: Vec<(InvariantParameter, usize)>,
    /// Nominal values of all global parameters.
    pub nominal: DVector<f64>,
    /// Column of the common displacement.
    pub displacement_column: Option<usize>,
    /// Column layout of the last group; `None` if there are only frames.
    pub ground: Option<ParameterLayout>,
}

/// Terms that the frames of one mounting share, its rotation first.
struct MountingTerms {
    placed: Vec<PlacedTerm>,
    columns: MountingColumns,
}

impl MountingTerms {
    fn allocate(input: &AdjustmentInput, stayed: bool, columns: &mut ColumnAllocator) -> Self {
        let first = columns.missing.len();
        let terms = [
            vec![terms::mounting_rotation(input, stayed)],
            terms::mounting_terms(input, stayed),
        ]
        .concat();
        let placed = columns.allocate_terms(terms);
        Self {
            placed,
            columns: MountingColumns {
                first,
                count: columns.missing.len() - first,
            },
        }
    }
}

/// Covariance of a frame's rotation about its mounting's; `None` without a drift. The mount's repeatability, common to these
/// frames, counts once and not once per frame.
fn frame_rotation_covariance(flight: &Flight) -> Option<Matrix3<f64>> {
    let hyperparameters = &flight.hyperparameters;
    match hyperparameters.mountings.are_assigned() {
        false => Some(
            terms::mounting_rotation_prior(&flight.input)
                .covariance
                .fixed_view::<3, 3>(0, 0)
                .into_owned(),
        ),
        true => (hyperparameters.drift_rad > 0.0)
            .then(|| hyperparameters.drift_covariance(&flight.input.scene.camera_from_wing)),
    }
}

/// Derivatives of a frame's marker positions with respect to the estimated dimensions, if they do not follow its unknowns; see
/// [`FlightHyperparameters::smoothed_bending`](super::hyperparameters::FlightHyperparameters::smoothed_bending).
fn dimension_derivatives(
    flight: &Flight,
    frame: usize,
    scale: f64,
) -> Option<DimensionDerivatives> {
    let smoothed = flight.hyperparameters.smoothed_bending(frame)?;
    let (curvature_per_m, twist_rad) = (&smoothed.curvature_per_m[..], &smoothed.twist_rad[..]);
    let bending = Bending {
        curvature_per_m,
        twist_rad,
        scale,
        ..Bending::UNBENT
    };
    Some(flight.input.scene.dimension_derivatives(&bending))
}

/// Unknowns of a flight, with their columns.
struct FlightUnknowns {
    columns: ColumnAllocator,
    shared: SharedTerms,
    displacement_column: Option<usize>,
    head: usize,
    shape: Option<ShapeColumns>,
    mountings: Vec<MountingTerms>,
    /// First column of the markers' positions and motions.
    markers: usize,
    positions: GroundPositions,
    motions: Arc<MarkerMotions>,
    curvature_terms: usize,
}

impl FlightUnknowns {
    fn allocate(flight: &Flight) -> Self {
        let (input, mountings) = (&flight.input, &flight.hyperparameters.mountings);
        let is_alone = flight.knowledge.is_alone();
        let curvature_terms = input.options.count_curvature_terms(!is_alone);
        let mut columns = ColumnAllocator::global(&flight.widened);
        let mut shared = terms::allocate_shared_terms(input, &mut columns);
        let common = columns.allocate_terms(terms::flight_terms(input, is_alone));
        shared.placed.extend(common);
        let displacement = flight.common_displacement.as_ref().map(|displacement| {
            let first = columns.missing.len();
            shared
                .placed
                .push(columns.allocate_term(displacement.term(input)));
            first
        });
        let head = columns.missing.len();
        let constant_m = input.setup.uncertainty[Width::ConstantBend];
        let constant_per_m = constant_m / input.scene.ground.axis.length_m.powi(2);
        let shape = (!is_alone)
            .then(|| ShapeColumns::allocate(&mut columns, curvature_terms, constant_per_m));
        let allocate = |mounting| {
            MountingTerms::allocate(input, mountings.is_ground_mounting(mounting), &mut columns)
        };
        let mountings = (0..mountings.count()).map(allocate).collect();
        let markers = columns.missing.len();
        let positions = if is_alone {
            GroundPositions::Observed
        } else {
            let count = 3 * input.setup.markers.len();
            GroundPositions::Global(columns.allocate(count, MISSING_GROUND))
        };
        let motions = Arc::new(MarkerMotions::allocate(
            input,
            &flight.prior_scales,
            &mut columns,
        ));
        Self {
            columns,
            shared,
            displacement_column: displacement,
            head,
            shape,
            mountings,
            markers,
            positions,
            motions,
            curvature_terms,
        }
    }

    /// Layout of one frame: its own coefficients of curvature and twist, its rotation about its mounting's and its
    /// displacements, and the unknowns that it shares.
    fn frame_layout(&self, flight: &Flight, frame: usize) -> ParameterLayout {
        let (input, hyperparameters) = (&flight.input, &flight.hyperparameters);
        let is_alone = flight.knowledge.is_alone();
        let mounting = &self.mountings[hyperparameters.mountings.mounting_of_frame(frame)];
        let amplitude_per_m = is_alone.then_some(hyperparameters.amplitudes_per_m[frame]);
        let mut columns = ColumnAllocator::local();
        let mut own = columns.allocate_terms([
            terms::curvature_term(self.curvature_terms, amplitude_per_m),
            terms::twist_term(input.options.twist_terms.min(MAX_TWIST_TERMS)),
        ]);
        let rotation = frame_rotation_covariance(flight);
        let rotation = columns.allocate_terms(rotation.iter().map(terms::frame_rotation));
        let (seen, scales) = (&flight.frames[frame], &flight.prior_scales);
        own.extend(rotation.iter().cloned());
        own.extend(columns.allocate_terms(terms::frame_terms(input, seen, scales, is_alone)));
        let expected_scale = input.setup.thermal.as_ref().map_or(1.0, Thermal::scale);
        ParameterLayout {
            terms: [&own[..], &mounting.placed, &self.shared.placed].concat(),
            curvature: own[0].scope,
            curvature_terms: own[0].term.size,
            twist: own[1].scope,
            twist_terms: own[1].term.size,
            rotation: rotation
                .iter()
                .map(|placed| placed.scope)
                .chain([ParameterScope::Global(mounting.columns.first)])
                .collect(),
            axis_height: self.shared.axis_height,
            expected_scale,
            ground_positions: self.positions,
            motions: self.motions.clone(),
            dimension_derivatives: dimension_derivatives(flight, frame, expected_scale),
            root: self.shared.root.clone(),
            head: self.head,
            mounting: mounting.columns,
            local: own.iter().map(|placed| placed.term.size).sum(),
        }
    }

    /// Flight-invariant parameters with their columns.
    fn invariant_parameters(&self, input: &AdjustmentInput) -> Vec<(InvariantParameter, usize)> {
        let mut all = vec![];
        let mut add = |unknown: Unknown, marker, first: usize, count: usize| {
            all.extend((0..count).map(|index| {
                (
                    InvariantParameter {
                        unknown,
                        index,
                        marker,
                    },
                    first + index,
                )
            }));
        };
        for PlacedTerm { term, scope } in &self.shared.placed {
            if let ParameterScope::Global(first) = scope
                && term.unknown.is_lasting()
            {
                add(term.unknown, None, *first, term.size);
            }
        }
        if let Some(shape) = self.shape {
            let ratios = shape.ratio_columns();
            add(Unknown::Shape, None, ratios.start, ratios.len());
        }
        for (marker, surveyed) in input.setup.markers.iter().enumerate() {
            let moves = self.motions.columns(marker);
            if let GroundPositions::Global(first) = self.positions {
                add(Unknown::Survey, Some(marker), first + 3 * marker, 3);
            }
            let motion = if surveyed.fixed {
                Unknown::FixedTargetMotion
            } else {
                Unknown::SkinMotion
            };
            add(motion, Some(marker), moves.start, moves.len());
        }
        all
    }

    /// Nominal values of the global parameters.
    fn nominal_values(&self, input: &AdjustmentInput) -> DVector<f64> {
        let mut nominal = DVector::zeros(self.columns.missing.len());
        if let Some(shape) = self.shape {
            shape.set_start(&mut nominal);
        }
        if let GroundPositions::Global(first) = self.positions {
            for (k, station) in input.scene.ground.stations.iter().enumerate() {
                nominal
                    .rows_mut(first + 3 * k, 3)
                    .copy_from(&station.surveyed_m);
            }
        }
        nominal
    }

    /// Start values of the global parameters.
    fn start_values(&self, flight: &Flight, from: Option<&Fit>) -> DVector<f64> {
        let mut start = self.nominal_values(&flight.input);
        let Some(fit) = from else { return start };
        let (shared, of_markers) = (self.mountings[0].columns.first, start.len() - self.markers);
        start
            .rows_mut(0, shared)
            .copy_from(&fit.global.rows(0, shared));
        for (mounting, MountingTerms { columns, .. }) in self.mountings.iter().enumerate() {
            let mean = flight.hyperparameters.mounting_mean(mounting);
            let known = columns.count.min(mean.len());
            start
                .rows_mut(columns.first, known)
                .copy_from(&mean.rows(0, known));
        }
        let old = fit.global.rows(fit.global.len() - of_markers, of_markers);
        start.rows_mut(self.markers, of_markers).copy_from(&old);
        start
    }
}

impl FlightProblem {
    /// Prepares a flight, starting from an earlier solution if there is one.
    pub fn new(flight: &Flight, from: Option<&Fit>) -> Self {
        if let Knowledge::After(earlier) = flight.knowledge {
            return Self::after_frames(flight, earlier, from);
        }
        let unknowns = FlightUnknowns::allocate(flight);
        let layouts: Vec<_> = (0..flight.frames.len())
            .map(|f| unknowns.frame_layout(flight, f))
            .collect();
        let frames = layouts
            .iter()
            .enumerate()
            .map(|(frame, layout)| flight.frame_group(frame, layout, from));
        let (mut groups, members): (Vec<_>, Vec<_>) = frames.unzip();
        let mut ground_members = vec![];
        if unknowns.positions != GroundPositions::Observed {
            let (ground, of_markers) = flight.ground_group();
            groups.push(ground);
            ground_members = of_markers;
        }
        let start = unknowns.start_values(flight, from);
        let (invariant, nominal) = (
            unknowns.invariant_parameters(&flight.input),
            unknowns.nominal_values(&flight.input),
        );
        let (displacement, prior) = (
            unknowns.displacement_column,
            flight.input.options.flight_prior.as_deref(),
        );
        let known = prior.and_then(|prior| prior.information_prior(&invariant, &nominal));
        let axis = &flight.input.scene.ground.axis;
        let shape = unknowns.shape.map(|columns| {
            SharedShape::new(columns, &flight.hyperparameters, axis, from.is_none())
        });
        let ColumnAllocator {
            missing, priors, ..
        } = unknowns.columns;
        let problem = Problem {
            start,
            missing,
            priors,
            known,
            groups,
        };
        let ground = match unknowns.positions {
            GroundPositions::Observed => None,
            GroundPositions::Global(_) => layouts.first().map(ParameterLayout::ground_layout),
        };
        Self {
            layouts,
            members,
            ground_members,
            problem,
            shape,
            invariant,
            nominal,
            displacement_column: displacement,
            ground,
        }
    }

    /// Prepares a frame with the state after earlier frames, whose columns it has.
    fn after_frames(flight: &Flight, earlier: &EarlierFrames, from: Option<&Fit>) -> Self {
        let local = from.map_or(earlier.local, |fit| &fit.groups[0].local);
        let curvature_per_m = &local.as_slice()[..earlier.layout.curvature_terms];
        let layout =
            earlier
                .twist
                .fix_derivatives(flight.input.scene, &earlier.layout, curvature_per_m);
        let (mut group, members) = flight.frame_group(0, &layout, None);
        group.local.copy_from(local);
        let problem = Problem {
            start: from.map_or(&earlier.known.mean, |fit| &fit.global).clone(),
            missing: earlier.model.missing.clone(),
            priors: vec![],
            known: Some(earlier.known.clone()),
            groups: vec![group],
        };
        Self {
            layouts: vec![layout],
            members: vec![members],
            ground_members: vec![],
            problem,
            shape: earlier.model.shape.clone(),
            invariant: vec![],
            nominal: DVector::zeros(0),
            displacement_column: None,
            ground: None,
        }
    }

    /// Members of the blocks.
    pub fn block_members(&self) -> BlockMembers<'_> {
        BlockMembers {
            members: &self.members,
            ground: &self.ground_members,
        }
    }

    /// Linearises all blocks of a group at a point.
    ///
    /// # Errors
    /// Returns an error if a marker is behind the camera.
    pub fn linearise(
        &self,
        scene: &WingScene,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> EstimationResult<()> {
        let (layout, members) = match (self.layouts.get(at.group), &self.ground) {
            (Some(layout), _) => (layout, &self.members[at.group]),
            (None, Some(layout)) => {
                return layout.linearise(scene, &self.ground_members, at, blocks);
            }
            (None, None) => return Ok(()),
        };
        layout.linearise(scene, members, at, blocks)?;
        let Some((shape, departure)) = self.shape.as_ref().zip(at.observed.last()) else {
            return Ok(());
        };
        if blocks.len() == members.len() {
            blocks.push(shape.empty_conditions(layout));
        }
        shape.linearise(layout, at, departure, &mut blocks[members.len()]);
        Ok(())
    }

    /// Solves the flight problem with the given solver options.
    ///
    /// # Errors
    /// Returns an error if the conditions cannot be evaluated or the normal equations are singular.
    pub fn solve(&self, scene: &WingScene, solve_options: &SolveOptions) -> EstimationResult<Fit> {
        solve_groups(&self.problem, solve_options, |at, blocks| {
            self.linearise(scene, at, blocks)
        })
    }
}
