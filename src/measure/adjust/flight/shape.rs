//! The shape of bending that a flight's frames share, and how far a frame may leave it.
//!
//! `c_k = (r_k + progress * change_k + lever * shortening_k * (a - middle)^2) a + constant_k + departure`, for every coefficient of the
//! curvature from the second on. The amplitude `a` is `c_0`; where frames swing, it is what of all coefficients bends the wing in its
//! first mode: `c_0` has a part in a swing of the second mode, which would pass for a change of the shape with the load.

use nalgebra::{DMatrix, DVector};

use super::hyperparameters::{FlightHyperparameters, USUAL_CURVATURE_PER_M};
use crate::adjust::ground::Axis;
use crate::adjust::layout::Layout;
use crate::adjust::shapes::{
    Integrals, MAX_CURVATURE_TERMS, RATIOS, beyond_fleet_covariance, burning_covariance,
    constant_bend_covariance, first_mode_shares, shape_covariance, shortening,
};
use crate::adjust::term::Columns;
use crate::estimation::{Block, GroupPoint, Linearised, Prior};

/// In a budget of variance.
const CONSTANT_BEND: &str = "bend that does not go with the load";
const MISSING_RATIO: &str =
    "the shape of bending cannot be determined; markers along the whole span are needed";

/// A flight whose amplitudes differ by less, over the largest, burns no fuel worth speaking of.
const MIN_RANGE: f64 = 0.1;

/// What is known of the share of the net load that stays vertical while the wing bends: weight does, deflection
/// turns with the wing.
const VERTICAL_SHARE: f64 = 0.5;
const VERTICAL_SHARE_SIGMA: f64 = 0.5;

/// The amplitude where no frame swings.
const FIRST_COEFFICIENT: Integrals = {
    let mut first = [0.0; MAX_CURVATURE_TERMS];
    first[0] = 1.0;
    first
};

/// How much of the ratios' changes a frame has.
#[derive(Clone, Debug)]
pub enum Progress {
    /// Per frame, as its amplitude in an earlier solution tells.
    OfFrames(Vec<f64>),
    /// The amplitude's distance from the middle over this, 1/m.
    OfAmplitude(f64),
}

/// Where the shared shape's unknowns stand.
#[derive(Clone, Copy, Debug)]
pub struct ShapeColumns {
    /// Ratios of the curvature's coefficients to the first, from the second on.
    pub ratios: usize,
    /// Changes of the ratios from the heaviest frame to the lightest.
    pub changes: usize,
    /// Coefficients of a bend that does not go with the load, from the second on, 1/m; `None`: held at 0.
    pub constant: Option<usize>,
    /// Share of the load that stays vertical while the wing bends.
    pub lever: usize,
}

impl ShapeColumns {
    /// Takes them, for so many terms of the curvature. `constant_per_m`: a bend that does not go with the load, at the tip over
    /// the square of the length.
    pub fn take(columns: &mut Columns, terms: usize, constant_per_m: f64) -> Self {
        let ratios = columns.take(terms - 1, MISSING_RATIO);
        let changes = columns.take(terms - 1, MISSING_RATIO);
        let constant = (constant_per_m > 0.0).then(|| columns.take(terms - 1, MISSING_RATIO));
        let lever = columns.take(1, MISSING_RATIO);
        if let Some(first) = constant {
            let covariance = constant_bend_covariance(terms) * constant_per_m.powi(2);
            columns.priors.push(Prior::centred(CONSTANT_BEND, first, covariance));
        }
        if terms > 1 {
            columns.priors.push(Prior::centred("shape of bending", ratios, shape_covariance(terms)));
        }
        columns.priors.push(Prior::centred("burning of fuel", changes, burning_covariance(terms)));
        columns.priors.push(Prior::scalar("load's turning", lever, VERTICAL_SHARE, VERTICAL_SHARE_SIGMA));
        Self { ratios, changes, constant, lever }
    }

    /// Its start.
    pub fn start(&self, global: &mut DVector<f64>) {
        global[self.lever] = VERTICAL_SHARE;
    }

    /// First column behind it.
    pub fn end(&self) -> usize {
        self.lever + 1
    }
}

/// The shared shape.
#[derive(Clone, Debug)]
pub struct SharedShape {
    /// Its unknowns.
    pub columns: ShapeColumns,
    /// What the load's staying vertical does to the ratios, times the square of the amplitude's distance from the middle,
    /// m^2. What goes with the distance itself is far below what burning fuel may do, and left to that.
    shortening: [f64; RATIOS],
    /// Amplitude half-way between the heaviest frame and the lightest, 1/m.
    middle_per_m: f64,
    /// Where a frame stands between the two, -0.5 to 0.5.
    progress: Progress,
    /// What of a frame's coefficients is its amplitude `a`.
    amplitude: Integrals,
}

impl SharedShape {
    /// Counted from the middle amplitude, which nothing tells before the first solution.
    pub fn new(columns: ShapeColumns, assumed: &FlightHyperparameters, axis: &Axis, is_first: bool) -> Self {
        let shortening = match is_first {
            true => [0.0; RATIOS],
            false => shortening(axis.length_m, |eta| axis.slope_rad(eta * axis.length_m)),
        };
        let amplitudes = &assumed.amplitudes_per_m;
        let (low, high) =
            amplitudes.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &a| (low.min(a), high.max(a)));
        // Fuel burns while the deflection falls: what its loss does to the shape goes with the amplitude, and
        // nothing but knowledge of beams tells that from another shape seen with another pitch.
        let range = (high - low).max(MIN_RANGE * high);
        let middle_per_m = 0.5 * (low + high);
        let progress = Progress::OfFrames(amplitudes.iter().map(|a| (a - middle_per_m) / range).collect());
        let amplitude = if assumed.swing > 0.0 { *first_mode_shares() } else { FIRST_COEFFICIENT };
        Self { columns, shortening, middle_per_m, progress, amplitude }
    }

    /// The same for frames whose amplitude nobody knows before.
    pub fn of_amplitude(self, range_per_m: f64) -> Self {
        Self { progress: Progress::OfAmplitude(range_per_m), ..self }
    }

    /// A frame's departures, as observations.
    pub fn block(terms: usize, assumed: &FlightHyperparameters, frame: usize) -> Block {
        let [loads, swings] = Self::components(terms, assumed, frame);
        Block { observed: DVector::zeros(terms - 1), covariance: loads + swings }
    }

    /// What the covariance of a frame's departures is the sum of: other loads, and swings.
    pub fn components(terms: usize, assumed: &FlightHyperparameters, frame: usize) -> [DMatrix<f64>; 2] {
        let FlightHyperparameters { departure, swing, .. } = assumed;
        let loads = (departure * assumed.amplitudes_per_m[frame]).powi(2);
        let swings = (swing * USUAL_CURVATURE_PER_M).powi(2);
        [shape_covariance(terms) * loads, beyond_fleet_covariance(terms) * swings]
    }

    /// Conditions of the departures, less the derivatives that change.
    pub fn empty(&self, layout: &Layout) -> Linearised {
        let n = layout.curvature_terms - 1;
        let ShapeColumns { ratios, changes, constant, lever } = self.columns;
        let constant = constant.map_or(0..0, |first| first..first + n);
        let columns =
            (ratios..ratios + n).chain(changes..changes + n).chain([lever]).chain(constant).collect();
        let mut empty = Linearised::empty(n, columns, layout.local, n);
        empty.observations = -DMatrix::identity(n, n);
        if self.columns.constant.is_some() {
            empty.global.columns_mut(2 * n + 1, n).copy_from(&empty.observations);
        }
        empty
    }

    /// The conditions at a point.
    pub fn linearise(
        &self,
        layout: &Layout,
        at: &GroupPoint,
        departure: &DVector<f64>,
        out: &mut Linearised,
    ) {
        let n = layout.curvature_terms - 1;
        let ShapeColumns { ratios, changes, constant, lever } = self.columns;
        let by: Vec<f64> = self.amplitude.iter().take(n + 1).copied().collect();
        let amplitude: f64 = by.iter().zip(at.local.iter()).map(|(by, c)| by * c).sum();
        let lever = at.global[lever];
        let off = amplitude - self.middle_per_m;
        let (progress, grows) = match &self.progress {
            Progress::OfFrames(list) => (list[at.group], 0.0),
            Progress::OfAmplitude(range) => (off / range, 1.0 / range),
        };
        for k in 0..n {
            let shortened = self.shortening[k] * off * off;
            let by_amplitude = 2.0 * self.shortening[k] * off;
            let change = at.global[changes + k];
            let ratio = at.global[ratios + k] + progress * change + lever * shortened;
            let constant = constant.map_or(0.0, |first| at.global[first + k]);
            out.misclosure[k] = at.local[k + 1] - ratio * amplitude - constant - departure[k];
            let by_all = -ratio - (grows * change + lever * by_amplitude) * amplitude;
            by.iter().enumerate().for_each(|(j, by)| out.local[(k, j)] = by_all * by);
            out.local[(k, k + 1)] += 1.0;
            out.global[(k, k)] = -amplitude;
            out.global[(k, n + k)] = -amplitude * progress;
            out.global[(k, 2 * n)] = -amplitude * shortened;
        }
    }
}
