//! Shape of bending shared by a flight's frames, and the departure of single frames from it.
//!
//! `c_k = (r_k + progress * change_k + vertical_load * shortening_k * (a - middle)^2) a + constant_k + departure`, for each
//! curvature coefficient from the second on. The amplitude `a` is `c_0`. If frames vibrate, `a` is the combination of all
//! coefficients that bends the wing in its first mode: `c_0` also responds to a vibration in the second mode, which would
//! otherwise be taken for a change of shape with load.

use nalgebra::{DMatrix, DVector};

use super::hyperparameters::FlightHyperparameters;
use crate::adjust::ground::BendingAxis;
use crate::adjust::layout::ParameterLayout;
use crate::adjust::shapes::{
    CURVATURE_RATIOS, CurvatureTermValues, MAX_CURVATURE_TERMS, TYPICAL_CURVATURE_PER_M,
    beyond_fleet_covariance, burning_covariance, constant_bend_covariance, first_mode_amplitudes,
    shape_covariance, shortening_effect,
};
use crate::adjust::term::ColumnAllocator;
use crate::estimation::{Block, GroupPoint, Linearised, Prior};
use crate::widths::Unknown;

const MISSING_RATIO: &str =
    "the shape of bending cannot be determined; markers along the whole span are needed";

/// Range of amplitudes, relative to the largest, below which fuel burn is negligible.
const MIN_AMPLITUDE_RANGE: f64 = 0.1;

/// Prior of the fraction of the net load that stays vertical while the wing bends: weight does, lift rotates with the wing.
const VERTICAL_LOAD_FRACTION: f64 = 0.5;
const VERTICAL_LOAD_FRACTION_SIGMA: f64 = 0.5;

/// Amplitude weights if no frame vibrates.
const FIRST_COEFFICIENT: CurvatureTermValues = {
    let mut first = [0.0; MAX_CURVATURE_TERMS];
    first[0] = 1.0;
    first
};

/// Position of a frame between the heaviest and the lightest frame, which scales the changes of the ratios.
#[derive(Clone, Debug)]
pub enum ShapeProgress {
    /// Progress per frame, from its amplitude in an earlier solution.
    PerFrame(Vec<f64>),
    /// Progress is the amplitude's distance from the middle divided by this range, 1/m.
    ByAmplitude(f64),
}

/// Columns of the shared shape's unknowns.
#[derive(Clone, Copy, Debug)]
pub struct ShapeColumns {
    /// Ratios of the curvature coefficients to the first, from the second on.
    pub ratios: usize,
    /// Changes of the ratios from the heaviest frame to the lightest.
    pub changes: usize,
    /// Coefficients of a bend that is independent of the load, from the second on, 1/m; `None`: fixed at 0.
    pub constant_bend: Option<usize>,
    /// Fraction of the load that stays vertical while the wing bends.
    pub vertical_load: usize,
}

impl ShapeColumns {
    /// Allocates the columns for `terms` curvature terms. `constant_per_m`: prior tip deflection of a bend that is
    /// independent of the load, divided by the square of the length.
    pub fn allocate(columns: &mut ColumnAllocator, terms: usize, constant_per_m: f64) -> Self {
        let ratios = columns.allocate(terms - 1, MISSING_RATIO);
        let changes = columns.allocate(terms - 1, MISSING_RATIO);
        let constant = (constant_per_m > 0.0).then(|| columns.allocate(terms - 1, MISSING_RATIO));
        let lever = columns.allocate(1, MISSING_RATIO);
        if let Some(first) = constant {
            let covariance = constant_bend_covariance(terms) * constant_per_m.powi(2);
            columns
                .priors
                .push(Prior::centred(Unknown::ConstantBend, first, covariance));
        }
        if terms > 1 {
            columns.priors.push(Prior::centred(
                Unknown::Shape,
                ratios,
                shape_covariance(terms),
            ));
        }
        columns.priors.push(Prior::centred(
            Unknown::FuelBurn,
            changes,
            burning_covariance(terms),
        ));
        columns.priors.push(Prior::scalar(
            Unknown::VerticalLoad,
            lever,
            VERTICAL_LOAD_FRACTION,
            VERTICAL_LOAD_FRACTION_SIGMA,
        ));
        Self {
            ratios,
            changes,
            constant_bend: constant,
            vertical_load: lever,
        }
    }

    /// Columns of the ratios.
    pub fn ratio_columns(&self) -> std::ops::Range<usize> {
        self.ratios..self.changes
    }

    /// Sets the start value of the vertical load's fraction.
    pub fn set_start(&self, global: &mut DVector<f64>) {
        global[self.vertical_load] = VERTICAL_LOAD_FRACTION;
    }
}

/// Shape of bending shared by the frames.
#[derive(Clone, Debug)]
pub struct SharedShape {
    pub columns: ShapeColumns,
    /// Effect of the load that stays vertical on the ratios, per squared distance of the amplitude from the middle, m^2.
    /// The effect linear in the distance is far below that of burnt fuel, and is covered by it.
    shortening: [f64; CURVATURE_RATIOS],
    /// Amplitude midway between the heaviest and the lightest frame, 1/m.
    middle_per_m: f64,
    /// Position of a frame between the two, -0.5 to 0.5.
    progress: ShapeProgress,
    /// Weights of a frame's coefficients in its amplitude `a`.
    amplitude: CurvatureTermValues,
}

impl SharedShape {
    /// Creates the shape, counted from the middle amplitude, which is unknown before the first solution.
    pub fn new(
        columns: ShapeColumns,
        hyperparameters: &FlightHyperparameters,
        axis: &BendingAxis,
        is_first: bool,
    ) -> Self {
        let shortening = match is_first {
            true => [0.0; CURVATURE_RATIOS],
            false => shortening_effect(axis.length_m, |eta| axis.slope_rad(eta * axis.length_m)),
        };
        let amplitudes = &hyperparameters.amplitudes_per_m;
        let (low, high) = amplitudes
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(low, high), &a| {
                (low.min(a), high.max(a))
            });
        // The lift decreases as fuel is burnt, so the effect on the shape follows the amplitude. Only the prior of beam
        // shapes separates it from another shape with another pitch.
        let range = (high - low).max(MIN_AMPLITUDE_RANGE * high);
        let middle_per_m = 0.5 * (low + high);
        let progress = ShapeProgress::PerFrame(
            amplitudes
                .iter()
                .map(|a| (a - middle_per_m) / range)
                .collect(),
        );
        let amplitude = if hyperparameters.oscillation > 0.0 {
            *first_mode_amplitudes()
        } else {
            FIRST_COEFFICIENT
        };
        Self {
            columns,
            shortening,
            middle_per_m,
            progress,
            amplitude,
        }
    }

    /// Returns the shape for frames whose amplitude is not known in advance.
    pub fn with_amplitude_range(self, range_per_m: f64) -> Self {
        Self {
            progress: ShapeProgress::ByAmplitude(range_per_m),
            ..self
        }
    }

    /// Builds the block of a frame's departures, as observations.
    pub fn departure_block(
        terms: usize,
        hyperparameters: &FlightHyperparameters,
        frame: usize,
    ) -> Block {
        let [loads, oscillations] = Self::departure_covariances(terms, hyperparameters, frame);
        Block {
            observed: DVector::zeros(terms - 1),
            covariance: loads + oscillations,
        }
    }

    /// Covariances of a frame's departures due to other loads and to vibration.
    pub fn departure_covariances(
        terms: usize,
        hyperparameters: &FlightHyperparameters,
        frame: usize,
    ) -> [DMatrix<f64>; 2] {
        let FlightHyperparameters {
            departure,
            oscillation,
            ..
        } = hyperparameters;
        let loads = (departure * hyperparameters.amplitudes_per_m[frame]).powi(2);
        let oscillations = (oscillation * TYPICAL_CURVATURE_PER_M).powi(2);
        [
            shape_covariance(terms) * loads,
            beyond_fleet_covariance(terms) * oscillations,
        ]
    }

    /// Creates the conditions of the departures without the derivatives that change.
    pub fn empty_conditions(&self, layout: &ParameterLayout) -> Linearised {
        let n = layout.curvature_terms - 1;
        let ShapeColumns {
            ratios,
            changes,
            constant_bend: constant,
            vertical_load: lever,
        } = self.columns;
        let constant = constant.map_or(0..0, |first| first..first + n);
        let columns = (ratios..ratios + n)
            .chain(changes..changes + n)
            .chain([lever])
            .chain(constant)
            .collect();
        let mut empty = Linearised::empty(n, columns, layout.local, n);
        empty.observations = -DMatrix::identity(n, n);
        if self.columns.constant_bend.is_some() {
            empty
                .global
                .columns_mut(2 * n + 1, n)
                .copy_from(&empty.observations);
        }
        empty
    }

    /// Evaluates the conditions at a point.
    pub fn linearise(
        &self,
        layout: &ParameterLayout,
        at: &GroupPoint,
        departure: &DVector<f64>,
        out: &mut Linearised,
    ) {
        let n = layout.curvature_terms - 1;
        let ShapeColumns {
            ratios,
            changes,
            constant_bend: constant,
            vertical_load: lever,
        } = self.columns;
        let weights: Vec<f64> = self.amplitude.iter().take(n + 1).copied().collect();
        let amplitude: f64 = weights
            .iter()
            .zip(at.local.iter())
            .map(|(weight, c)| weight * c)
            .sum();
        let lever = at.global[lever];
        let off = amplitude - self.middle_per_m;
        let (progress, grows) = match &self.progress {
            ShapeProgress::PerFrame(list) => (list[at.group], 0.0),
            ShapeProgress::ByAmplitude(range) => (off / range, 1.0 / range),
        };
        for k in 0..n {
            let shortened = self.shortening[k] * off * off;
            let by_amplitude = 2.0 * self.shortening[k] * off;
            let change = at.global[changes + k];
            let ratio = at.global[ratios + k] + progress * change + lever * shortened;
            let constant = constant.map_or(0.0, |first| at.global[first + k]);
            out.misclosure[k] = at.local[k + 1] - ratio * amplitude - constant - departure[k];
            let by_all = -ratio - (grows * change + lever * by_amplitude) * amplitude;
            weights
                .iter()
                .enumerate()
                .for_each(|(j, weight)| out.local[(k, j)] = by_all * weight);
            out.local[(k, k + 1)] += 1.0;
            out.global[(k, k)] = -amplitude;
            out.global[(k, n + k)] = -amplitude * progress;
            out.global[(k, 2 * n)] = -amplitude * shortened;
        }
    }
}
