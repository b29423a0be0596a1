//! What earlier flights told of all that stays the same from flight to flight (docs/adjustment/learning.md).
//!
//! Each flight leaves its normal equations, reduced by all that is its own (Helmert's blocking): what its images alone say of
//! the unknowns that flights have in common, without what the installation states and the ground frames show, which every
//! later adjustment has by itself. So nothing is counted twice, and the equations of several flights add up. An unknown of
//! which a flight has a part of its own enters with that part's variance, once for each flight that taught and once for
//! the one that is solved.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::shapes::{burning_covariance, shape_covariance};
use super::{AdjustError, Estimate};
use crate::estimation::InformationPrior;
use crate::setup::Setup;

/// The ratios of the curvature's coefficients.
pub const SHAPE: &str = "shape of bending";
/// Places of the markers on ground.
pub const SURVEY: &str = "survey";
/// Motions of markers on the wing in flight.
pub const SKIN: &str = "motion of the skin";
/// Of fixed marks.
pub const MARKS: &str = "motion of the fixed marks";
/// Terms that all flights of an installation have in common: of survey, ground frame, camera, panes and drawings. Not
/// here is what each flight has anew: mounting, temperature, the camera in flight, the root's motion, the panes' bow, loads.
pub const LASTING: [&str; 10] = [
    "rotation on ground",
    "projection centre",
    "panes' shift",
    "height of the bending axis",
    "interior orientation",
    "root offset",
    "chord offset of the bending axis",
    "direction of the span",
    "bend between survey and ground frame",
    "vertical of the survey",
];

/// Share of the variance of what skin and marks move by in flight that repeats from flight to flight. Pressure, cold
/// and the cruise's suction come again, fuel and manoeuvres do not: half, an assumption.
const REPEATED: f64 = 0.5;
/// How far the shape of bending at the middle of one flight is from that of another, a share of the variance of what
/// burning all the fuel changes. The rms of any share of the fuel about its mean is half of that change's, a quarter
/// of its variance; payload, speed and the amplitude that the shape is counted at are taken to do as much again.
const SHAPE_BETWEEN_FLIGHTS: f64 = 0.5;
/// Combinations of unknowns of which images tell less than this share of what is known beforehand are not told: rounding
/// would have a say in them.
const MIN_INFORMATION_FRACTION: f64 = 1e-3;

/// An unknown that flights have in common.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvariantParameter {
    /// The term's name.
    pub term: Cow<'static, str>,
    /// Which of the term's unknowns.
    pub index: usize,
    /// Index in the survey, where it is a marker's.
    pub marker: Option<usize>,
}

/// A flight's normal equations for these, reduced by all else: `normal * (value - stated) = right`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReducedNormals {
    /// The unknowns, in order.
    pub unknowns: Vec<InvariantParameter>,
    /// Positive semidefinite, in the unknowns' units.
    pub normal: DMatrix<f64>,
    /// The right side.
    pub right: DVector<f64>,
    /// Standard deviations of the unknowns without these images.
    pub sigmas: DVector<f64>,
}

/// What a flight tells, and what is known with it.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightContribution {
    /// Told by its images.
    pub normals: ReducedNormals,
    /// The same unknowns, less what is stated, as they are known with all that the installation states, the ground frames
    /// show, earlier flights taught.
    pub known: Vec<Estimate>,
}

/// What several flights told, as a later one takes it.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightPrior {
    unknowns: Vec<InvariantParameter>,
    /// Less what is stated, at least squares.
    mean: DVector<f64>,
    information: DMatrix<f64>,
    conditions: usize,
    flights: usize,
}

/// Unknowns of which each flight has a part of its own.
struct Repeating {
    columns: Vec<usize>,
    /// Inverse covariance of the part that repeats.
    repeated: DMatrix<f64>,
    /// Covariance of a flight's own.
    own: DMatrix<f64>,
}

impl Repeating {
    fn new(unknowns: &[InvariantParameter], setup: &Setup) -> Result<Self, AdjustError> {
        let of = |name: &str| -> Vec<usize> {
            (0..unknowns.len()).filter(|k| unknowns[*k].term == name).collect()
        };
        let (shape, skin, marks) = (of(SHAPE), of(SKIN), of(MARKS));
        let ratios = shape.len();
        let moving = [&skin[..], &marks].concat();
        let columns = [&shape[..], &moving].concat();
        let mut repeated = DMatrix::zeros(columns.len(), columns.len());
        let mut own = repeated.clone();
        repeated.view_mut((0, 0), (ratios, ratios)).copy_from(&inverse(shape_covariance(ratios + 1))?);
        own.view_mut((0, 0), (ratios, ratios))
            .copy_from(&(burning_covariance(ratios + 1) * SHAPE_BETWEEN_FLIGHTS));
        for (k, column) in moving.iter().enumerate() {
            let marker = unknowns[*column].marker.and_then(|marker| setup.markers.get(marker));
            let fixed = marker.filter(|_| k >= skin.len()).map(|marker| marker.flight_motion_m);
            let variance = fixed.unwrap_or(setup.uncertainty.in_flight.skin_motion_m).powi(2);
            let at = (ratios + k, ratios + k);
            repeated[at] = 1.0 / (REPEATED * variance);
            own[at] = (1.0 - REPEATED) * variance;
        }
        Ok(Self { columns, repeated, own })
    }

    /// Takes a flight's own part out of what is known of the sum, or puts another flight's in: to what is known a noise is added.
    fn part(&self, normal: &mut DMatrix<f64>, right: &mut DVector<f64>) -> Result<(), AdjustError> {
        if self.columns.is_empty() {
            return Ok(());
        }
        let of = normal.select_columns(&self.columns);
        let inner = inverse(inverse(self.own.clone())? + of.select_rows(&self.columns))?;
        let gain = &of * inner;
        *right -= &gain * right.select_rows(&self.columns);
        *normal -= gain * of.transpose();
        Ok(())
    }

    fn add(&self, normal: &mut DMatrix<f64>, added: &DMatrix<f64>, sign: f64) {
        for (i, row) in self.columns.iter().enumerate() {
            for (j, column) in self.columns.iter().enumerate() {
                normal[(*row, *column)] += sign * added[(i, j)];
            }
        }
    }
}

fn inverse(matrix: DMatrix<f64>) -> Result<DMatrix<f64>, AdjustError> {
    let lost =
        || AdjustError::Input("what flights taught has lost its numerical meaning; learn again".into());
    matrix.cholesky().map(|c| c.inverse()).ok_or_else(lost)
}

impl FlightPrior {
    /// What these flights told together; `None` of none.
    ///
    /// # Errors
    /// Where they have not the same unknowns, or a width of 0.
    pub fn of(flights: &[&ReducedNormals], setup: &Setup) -> Result<Option<Self>, AdjustError> {
        let Some(first) = flights.first() else { return Ok(None) };
        let unknowns = first.unknowns.clone();
        let repeating = Repeating::new(&unknowns, setup)?;
        let mut normal = DMatrix::zeros(unknowns.len(), unknowns.len());
        let mut right = DVector::zeros(unknowns.len());
        for flight in flights {
            if flight.unknowns != unknowns {
                return Err(AdjustError::Input(
                    "flights were learnt with different unknowns; learn again".into(),
                ));
            }
            let (mut own, mut own_right) = (flight.normal.clone(), flight.right.clone());
            repeating.part(&mut own, &mut own_right)?;
            normal += own;
            right += own_right;
        }
        // What is known of the part that repeats is known of a next flight but for its own part; what an installation
        // states of the sum is there already.
        repeating.add(&mut normal, &repeating.repeated, 1.0);
        repeating.part(&mut normal, &mut right)?;
        if !repeating.columns.is_empty() {
            let stated = inverse(inverse(repeating.repeated.clone())? + &repeating.own)?;
            repeating.add(&mut normal, &stated, -1.0);
        }
        Ok(Some(Self::regular((unknowns, &first.sigmas), &normal, &right, flights.len())))
    }

    /// Without combinations of which nothing is told; in units of the unknowns' standard deviations.
    fn regular(
        (unknowns, unit): (Vec<InvariantParameter>, &DVector<f64>),
        normal: &DMatrix<f64>,
        right: &DVector<f64>,
        flights: usize,
    ) -> Self {
        let scaled = DMatrix::from_fn(unit.len(), unit.len(), |i, j| unit[i] * normal[(i, j)] * unit[j]);
        let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(scaled);
        let told: Vec<usize> =
            (0..unit.len()).filter(|k| eigenvalues[*k] > MIN_INFORMATION_FRACTION).collect();
        let axes = eigenvectors.select_columns(&told);
        let weights = DVector::from_iterator(told.len(), told.iter().map(|k| eigenvalues[*k]));
        let along = axes.tr_mul(&right.component_mul(unit)).component_div(&weights);
        let mean = (&axes * along).component_mul(unit);
        let rows =
            DMatrix::from_fn(told.len(), unit.len(), |i, j| weights[i].sqrt() * axes[(j, i)] / unit[j]);
        Self { unknowns, mean, information: rows.tr_mul(&rows), conditions: told.len(), flights }
    }

    /// The same of an installation that is as stated: what it is worth before a flight is seen.
    pub fn as_stated(&self) -> Self {
        Self { mean: DVector::zeros(self.mean.len()), ..self.clone() }
    }

    /// Whether it is of a curvature of so many terms.
    pub fn holds_for(&self, terms: usize) -> bool {
        self.unknowns.iter().filter(|unknown| unknown.term == SHAPE).count() + 1 == terms
    }

    /// What is said beside a result.
    pub fn remark(&self, used: bool) -> String {
        let flights = if self.flights == 1 { "a flight".into() } else { format!("{} flights", self.flights) };
        match used {
            true => format!("adjusted with what {flights} taught"),
            false => format!(
                "what {flights} taught is not used: it holds for another number of terms of the curvature"
            ),
        }
    }

    /// As knowledge of these columns among others, each with what is stated of it; `None` where one of them is not there.
    pub fn known(
        &self,
        placed: &[(InvariantParameter, usize)],
        stated: &DVector<f64>,
    ) -> Option<InformationPrior> {
        let of = |unknown: &InvariantParameter| {
            placed.iter().find(|(other, _)| other == unknown).map(|(_, column)| *column)
        };
        let columns: Vec<usize> = self.unknowns.iter().map(of).collect::<Option<_>>()?;
        let mut known = InformationPrior {
            mean: stated.clone(),
            information: DMatrix::zeros(stated.len(), stated.len()),
            conditions: self.conditions,
        };
        for (i, row) in columns.iter().enumerate() {
            known.mean[*row] += self.mean[i];
            for (j, column) in columns.iter().enumerate() {
                known.information[(*row, *column)] = self.information[(i, j)];
            }
        }
        Some(known)
    }
}
