//! Prior for the flight-invariant parameters, from earlier flights (docs/adjustment/learning.md).
//!
//! Each flight contributes its normal equations, reduced by all unknowns that are specific to it (Helmert blocking). They
//! hold the information of its images only: priors of the installation and ground frames are excluded because every later
//! adjustment includes them. No information is therefore counted twice, and the equations of several flights can be added.
//! If part of a parameter is specific to a flight, the variance of that part is added once per contributing flight and once
//! for the flight that is solved.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::shapes::{burning_covariance, shape_covariance};
use super::{AdjustError, AdjustResult, Estimate};
use crate::estimation::InformationPrior;
use crate::setup::Setup;
use crate::widths::{Unknown, Width};

/// Fraction of the variance of skin and fixed-target motion that repeats from flight to flight. Pressure, cold and cruise
/// suction recur; fuel load and manoeuvres do not. The value 0.5 is an assumption.
const REPEATED_FRACTION: f64 = 0.5;
/// Variance of the shape of bending between flights, as a fraction of the variance that burning all fuel causes. A random
/// amount of fuel has 50 % of that change as rms about its mean, 25 % of its variance; payload, speed and the reference
/// amplitude are assumed to add another 25 %.
const SHAPE_BETWEEN_FLIGHTS_FRACTION: f64 = 0.5;
/// Minimum ratio of information from images to prior information, per combination of parameters. Combinations below it are
/// dropped because rounding would dominate them.
const MIN_INFORMATION_FRACTION: f64 = 1e-3;

/// A parameter that all flights of an installation share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvariantParameter {
    pub unknown: Unknown,
    /// Index within the unknown.
    pub index: usize,
    /// Index in the survey, if the parameter belongs to a marker.
    pub marker: Option<usize>,
}

/// Normal equations of a flight for the invariant parameters, reduced by all other unknowns: `normal * (value - nominal) =
/// right`.
#[derive(Clone, Debug, PartialEq)]
pub struct ReducedNormals {
    /// The parameters, in the order of rows and columns.
    pub unknowns: Vec<InvariantParameter>,
    /// Normal matrix, positive semidefinite, in the parameters' units.
    pub normal: DMatrix<f64>,
    /// Right-hand side.
    pub right: DVector<f64>,
    /// Standard deviations of the parameters without the images of the flight.
    pub sigmas: DVector<f64>,
}

/// Information that one flight contributes, and the posterior estimates of the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightContribution {
    /// Normal equations from the flight's images.
    pub normals: ReducedNormals,
    /// Posterior estimates of the parameters minus their nominal values, given the installation's priors, the ground frames
    /// and earlier flights.
    pub posterior: Vec<Estimate>,
}

/// Prior for a later flight, from several flights.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightPrior {
    unknowns: Vec<InvariantParameter>,
    /// Least-squares estimates minus nominal values.
    mean: DVector<f64>,
    information: DMatrix<f64>,
    conditions: usize,
    flights: usize,
}

/// Parameters that consist of a repeating part and a part specific to each flight.
pub(super) struct RepeatingParameters {
    columns: Vec<usize>,
    /// Inverse covariance of the repeating part.
    repeated: DMatrix<f64>,
    /// Covariance of the part specific to a flight.
    own: DMatrix<f64>,
}

impl RepeatingParameters {
    /// Selects the repeating parameters among the invariant ones.
    ///
    /// # Errors
    /// Returns an error if a prior covariance is not positive definite.
    pub fn new(unknowns: &[InvariantParameter], setup: &Setup) -> AdjustResult<Self> {
        let columns_of = |unknown| -> Vec<usize> {
            (0..unknowns.len())
                .filter(|k| unknowns[*k].unknown == unknown)
                .collect()
        };
        let [shape, skin, targets] = [
            Unknown::Shape,
            Unknown::SkinMotion,
            Unknown::FixedTargetMotion,
        ]
        .map(columns_of);
        let ratios = shape.len();
        let moving = [&skin[..], &targets].concat();
        let columns = [&shape[..], &moving].concat();
        let mut repeated = DMatrix::zeros(columns.len(), columns.len());
        let mut own = repeated.clone();
        repeated
            .view_mut((0, 0), (ratios, ratios))
            .copy_from(&invert_matrix(shape_covariance(ratios + 1))?);
        own.view_mut((0, 0), (ratios, ratios))
            .copy_from(&(burning_covariance(ratios + 1) * SHAPE_BETWEEN_FLIGHTS_FRACTION));
        for (k, column) in moving.iter().enumerate() {
            let marker = unknowns[*column]
                .marker
                .and_then(|marker| setup.markers.get(marker));
            let fixed = marker
                .filter(|_| k >= skin.len())
                .map(|marker| marker.flight_motion_m);
            let variance = fixed
                .unwrap_or(setup.uncertainty[Width::SkinMotion])
                .powi(2);
            let at = (ratios + k, ratios + k);
            repeated[at] = 1.0 / (REPEATED_FRACTION * variance);
            own[at] = (1.0 - REPEATED_FRACTION) * variance;
        }
        Ok(Self {
            columns,
            repeated,
            own,
        })
    }

    /// Covariance of the part specific to a flight, for some of the invariant parameters.
    pub fn flight_covariance(&self, at: &[usize]) -> DMatrix<f64> {
        let position = |k: usize| self.columns.iter().position(|column| *column == at[k]);
        DMatrix::from_fn(at.len(), at.len(), |i, j| {
            position(i)
                .zip(position(j))
                .map_or(0.0, |position| self.own[position])
        })
    }

    /// Marginalizes the part specific to a flight: adds its variance to the prior of the sum. Used once per contributing
    /// flight and once for the flight that is solved.
    fn remove_flight_part(
        &self,
        normal: &mut DMatrix<f64>,
        right: &mut DVector<f64>,
    ) -> AdjustResult<()> {
        if self.columns.is_empty() {
            return Ok(());
        }
        let coupling = normal.select_columns(&self.columns);
        let inner =
            invert_matrix(invert_matrix(self.own.clone())? + coupling.select_rows(&self.columns))?;
        let gain = &coupling * inner;
        *right -= &gain * right.select_rows(&self.columns);
        *normal -= gain * coupling.transpose();
        Ok(())
    }

    /// Adds information of the repeating parameters to their rows and columns of a normal matrix, with a sign.
    fn add_information(&self, normal: &mut DMatrix<f64>, added: &DMatrix<f64>, sign: f64) {
        for (i, row) in self.columns.iter().enumerate() {
            for (j, column) in self.columns.iter().enumerate() {
                normal[(*row, *column)] += sign * added[(i, j)];
            }
        }
    }
}

fn invert_matrix(matrix: DMatrix<f64>) -> AdjustResult<DMatrix<f64>> {
    let singular = || {
        AdjustError::Input(
            "the information matrix in flight_prior.json is not positive definite; run `wingd learn` again".into(),
        )
    };
    matrix.cholesky().map(|c| c.inverse()).ok_or_else(singular)
}

impl FlightPrior {
    /// Combines the contributions of several flights; `None` without flights.
    ///
    /// # Errors
    /// Returns an error if the flights have different parameters, or a prior standard deviation is 0.
    pub fn from_flights(flights: &[&ReducedNormals], setup: &Setup) -> AdjustResult<Option<Self>> {
        let Some(first) = flights.first() else {
            return Ok(None);
        };
        let unknowns = first.unknowns.clone();
        let repeating = RepeatingParameters::new(&unknowns, setup)?;
        let mut normal = DMatrix::zeros(unknowns.len(), unknowns.len());
        let mut right = DVector::zeros(unknowns.len());
        for flight in flights {
            if flight.unknowns != unknowns {
                return Err(AdjustError::Input(
                    "the flights in flight_prior.json have different parameters; run `wingd learn` again".into(),
                ));
            }
            let (mut own, mut own_right) = (flight.normal.clone(), flight.right.clone());
            repeating.remove_flight_part(&mut own, &mut own_right)?;
            normal += own;
            right += own_right;
        }
        // The repeating part also holds for the next flight, apart from that flight's own part. The installation's prior
        // of the sum is already part of every adjustment, so it is subtracted.
        repeating.add_information(&mut normal, &repeating.repeated, 1.0);
        repeating.remove_flight_part(&mut normal, &mut right)?;
        if !repeating.columns.is_empty() {
            let nominal =
                invert_matrix(invert_matrix(repeating.repeated.clone())? + &repeating.own)?;
            repeating.add_information(&mut normal, &nominal, -1.0);
        }
        Ok(Some(Self::from_normals(
            (unknowns, &first.sigmas),
            &normal,
            &right,
            flights.len(),
        )))
    }

    /// Creates a prior without parameter combinations that the images do not determine, in units of the parameters'
    /// standard deviations.
    fn from_normals(
        (unknowns, unit): (Vec<InvariantParameter>, &DVector<f64>),
        normal: &DMatrix<f64>,
        right: &DVector<f64>,
        flights: usize,
    ) -> Self {
        let scaled = DMatrix::from_fn(unit.len(), unit.len(), |i, j| {
            unit[i] * normal[(i, j)] * unit[j]
        });
        let SymmetricEigen {
            eigenvectors,
            eigenvalues,
        } = SymmetricEigen::new(scaled);
        let determined: Vec<usize> = (0..unit.len())
            .filter(|k| eigenvalues[*k] > MIN_INFORMATION_FRACTION)
            .collect();
        let axes = eigenvectors.select_columns(&determined);
        let weights =
            DVector::from_iterator(determined.len(), determined.iter().map(|k| eigenvalues[*k]));
        let along = axes
            .tr_mul(&right.component_mul(unit))
            .component_div(&weights);
        let mean = (&axes * along).component_mul(unit);
        let rows = DMatrix::from_fn(determined.len(), unit.len(), |i, j| {
            weights[i].sqrt() * axes[(j, i)] / unit[j]
        });
        Self {
            unknowns,
            mean,
            information: rows.tr_mul(&rows),
            conditions: determined.len(),
            flights,
        }
    }

    /// Returns the prior with its mean at the nominal values, for predicting the precision of a flight.
    pub fn at_nominal(&self) -> Self {
        Self {
            mean: DVector::zeros(self.mean.len()),
            ..self.clone()
        }
    }

    /// Remark about the prior for a result.
    pub fn remark(&self, used: bool) -> String {
        let flights = if self.flights == 1 {
            "one flight".into()
        } else {
            format!("{} flights", self.flights)
        };
        match used {
            true => format!("adjusted with the prior from {flights}"),
            false => format!(
                "the prior from {flights} was not used: its number of curvature terms differs; run `wingd learn` again"
            ),
        }
    }

    /// Converts to an information prior on the given columns, whose nominal values are `nominal`; `None` if a column is
    /// missing.
    pub fn information_prior(
        &self,
        placed: &[(InvariantParameter, usize)],
        nominal: &DVector<f64>,
    ) -> Option<InformationPrior> {
        let column_of = |unknown: &InvariantParameter| {
            placed
                .iter()
                .find(|(other, _)| other == unknown)
                .map(|(_, column)| *column)
        };
        let columns: Vec<usize> = self.unknowns.iter().map(column_of).collect::<Option<_>>()?;
        let mut known = InformationPrior {
            mean: nominal.clone(),
            information: DMatrix::zeros(nominal.len(), nominal.len()),
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
