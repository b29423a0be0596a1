//! Curvature of a solution with its covariance, for live results and bending moments.

use nalgebra::DMatrix;

use crate::installation::Installation;
use crate::record::MomentRecord;
use wingd_measure::adjust::{Parameter, ParameterKind, Solution};
use wingd_measure::setup::{StiffnessSection, Width};
use wingd_measure::stress::{BendingCurvature, DEFAULT_STEPS};

/// Curvature coefficients, in the order of the record's `curvature_per_m`, with their covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct CurvatureEstimate {
    /// Coefficients, 1/m.
    pub per_m: Vec<f64>,
    /// Upper triangle of the covariance, row by row, 1/m².
    pub covariance: Vec<f64>,
}

impl CurvatureEstimate {
    /// Extracts the curvature of a solution; `None` if a coefficient has no standard deviation.
    pub(super) fn from_solution(solution: &Solution) -> Option<Self> {
        let before = |p: &&Parameter| p.kind != ParameterKind::Curvature;
        let first: usize = solution
            .parameters
            .iter()
            .take_while(before)
            .map(|p| p.values.len())
            .sum();
        let own = &solution.parameters.iter().find(|p| !before(p))?.values;
        let sigmas: Vec<f64> = own.iter().map(|e| e.sigma).collect::<Option<_>>()?;
        let correlation =
            |i: usize, j: usize| solution.correlation.get((first + i, first + j)).copied();
        let mut covariance = vec![];
        for (i, row) in sigmas.iter().enumerate() {
            for (j, column) in sigmas.iter().enumerate().skip(i) {
                covariance.push(row * column * correlation(i, j)?);
            }
        }
        Some(Self {
            per_m: own.iter().map(|e| e.value).collect(),
            covariance,
        })
    }

    /// Returns the covariance of the coefficients, 1/m².
    pub(super) fn covariance_matrix(&self) -> DMatrix<f64> {
        let (terms, mut entries) = (self.per_m.len(), self.covariance.iter());
        let mut matrix = DMatrix::zeros(terms, terms);
        for (i, j) in (0..terms).flat_map(|i| (i..terms).map(move |j| (i, j))) {
            let entry = entries.next().copied().unwrap_or(f64::NAN);
            (matrix[(i, j)], matrix[(j, i)]) = (entry, entry);
        }
        matrix
    }
}

/// Returns the bending moments at the sections whose stiffness the installation gives.
pub(super) fn moment_records(installation: &Installation, s: &Solution) -> Vec<MomentRecord> {
    let sections = installation.structure.as_ref();
    let estimate = CurvatureEstimate::from_solution(s);
    let curvature = estimate.map(|estimate| BendingCurvature {
        covariance: estimate.covariance_matrix(),
        coefficients_per_m: estimate.per_m.into(),
        length_m: s.axis_length_m,
        root_sigma_m: installation.setup.uncertainty[Width::RootOffset],
        steps: DEFAULT_STEPS,
    });
    let record = |section: &StiffnessSection| {
        let is_on_wing = section.s_m <= s.axis_length_m;
        let moment = curvature.as_ref().filter(|_| is_on_wing);
        let moment = moment.map(|curvature| curvature.bending_moment(section));
        MomentRecord {
            arc_length_m: section.s_m,
            bending_moment_nm: moment.map(|m| m.value),
            sigma_bending_moment_nm: moment.map(|m| m.sigma),
            sigma_stiffness_nm: moment.map(|m| m.sigma_by_stiffness),
        }
    };
    sections.into_iter().flatten().map(record).collect()
}
