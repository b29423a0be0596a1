//! Causes of a misfit: unknowns whose prior standard deviations the data refute. A significant one counts in the solution,
//! with the larger prior standard deviation that the data ask for, or makes the result doubtful.
//!
//! From the prior's residual and the part of its covariance that is left follow the probability of the residual if the prior
//! is true, and the prior that the data ask for. The most probable cause is freed first.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::beam::RAISE_TERMS;
use super::{VarianceBudget, VarianceShare};
use crate::estimation::quality::chi_square_tail;
use crate::estimation::{Fit, Prior, Problem};
use crate::widths::Unknown;

/// Registry of causes. Those of skin and vibrations are estimated from the frames instead.
pub const CAUSES: [Unknown; 15] = [
    Unknown::FlightScale,
    Unknown::Aspect,
    Unknown::MountingRotation,
    Unknown::MountingShift,
    Unknown::AxisHeight,
    Unknown::RootOffset,
    Unknown::ChordOffset,
    Unknown::SpanDirection,
    Unknown::Sweep,
    Unknown::GroundBend,
    Unknown::ConstantBend,
    Unknown::RootRotation,
    Unknown::RootShift,
    Unknown::FlightPrincipalPoint,
    Unknown::ThermalScale,
];
/// Causes in the image, which count before outliers are removed if they are more probable than all others: many outliers may
/// be their consequence.
pub const IN_IMAGE: [Unknown; 2] = [Unknown::FlightScale, Unknown::Aspect];

/// Fraction of a stated variance that the data must determine for a direction to be tested: below, the linear model does not
/// carry as far as the residual asks.
const MIN_DETERMINED: f64 = 2e-3;
/// The same for causes in the image, in which the model is linear: 300 standard deviations, 1.5 % of aspect.
const MIN_DETERMINED_IMAGE: f64 = 1e-5;
/// Probability that a cause counts in a result without errors, shared by all causes.
pub const CAUSES_ALPHA: f64 = 1e-3;
/// Fraction of the default below which a stated width is narrow: five times as precise as usual.
pub const NARROW_FRACTION: f64 = 0.2;
/// Ratio of the tip's standard deviation with the default to that with the stated width from which on a narrow width is decisive.
pub const SENSITIVE_RATIO: f64 = 1.3;
/// Candidate increases of a stated variance, as powers of two.
const INCREASES: std::ops::Range<i32> = -2..20;
/// Increase for causes in the image if nothing is known: standard deviations of 5 % (scale) and 1.3 % (aspect) by default.
const WIDEST: f64 = 65_536.0;
/// Distribution of the uncertainty of the axis height along the span: mean, then Legendre polynomials of degree 1 to 3. An
/// error in the relative height of the axis in a section is similar along the wing. The difference from root to tip (twice
/// the second value) is 40 % of the mean's standard deviation, the variation between the spars of different sections; the
/// bends are 50 % and 25 % of the slope. An assumption.
const SKIN_HEIGHT_SHAPE: [f64; RAISE_TERMS] = [1.0, 0.2, 0.1, 0.05];
/// Legendre polynomials of degree 0 to 3 on (0, 1) (rows) as powers of s/L (columns).
const LEGENDRE_BY_POWERS: [[f64; RAISE_TERMS]; RAISE_TERMS] = [
    [1.0, 0.0, 0.0, 0.0],
    [-1.0, 2.0, 0.0, 0.0],
    [1.0, -6.0, 6.0, 0.0],
    [-1.0, 12.0, -30.0, 20.0],
];

/// Step in which a stated skin height is widened, m: a drawing's precision.
pub const AXIS_HEIGHT_STEP_M: f64 = 0.01;
/// Standard deviation of the axis height that images of many frames ask for if nothing is wrong, m: wings are not exactly of
/// the family of shapes. Measured on sampled wings whose axis is known to 3 mm: up to 0.06 m in flights of 85 and 400 frames.
const AXIS_HEIGHT_MODEL_M: f64 = 0.02;

/// Covariance of the axis height by the skin height alone, whose mean has the standard deviation `sigma_m`.
pub fn axis_height_covariance(sigma_m: f64) -> DMatrix<f64> {
    let of_shape = |(doubt, powers): (f64, [f64; RAISE_TERMS])| {
        let powers = DVector::from_column_slice(&powers) * (doubt * sigma_m);
        &powers * powers.transpose()
    };
    SKIN_HEIGHT_SHAPE
        .into_iter()
        .zip(LEGENDRE_BY_POWERS)
        .map(of_shape)
        .sum()
}

/// Increases of the stated variances of some unknowns, as multiples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WidenedPriors(Vec<(Unknown, f64)>);

impl WidenedPriors {
    /// Returns whether none is increased.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns wide priors for the causes in the image if nothing is known about them.
    pub fn widest_image() -> Self {
        Self(IN_IMAGE.map(|cause| (cause, WIDEST)).to_vec())
    }

    /// Returns whether the image has another scale or aspect.
    pub fn has_image_cause(&self) -> bool {
        IN_IMAGE.iter().any(|cause| self.increase(*cause) > 0.0)
    }

    /// Returns the increase of an unknown's variance; 0: it has its stated width.
    pub fn increase(&self, unknown: Unknown) -> f64 {
        self.0
            .iter()
            .find(|(widened, _)| *widened == unknown)
            .map_or(0.0, |(_, increase)| *increase)
    }

    /// Adds the increase to the priors of a term with its stated widths.
    pub fn apply_to(&self, unknown: Unknown, prior: Prior) -> Prior {
        match self.increase(unknown) {
            0.0 => prior,
            increase => Prior {
                covariance: &prior.covariance + step(unknown, &prior.covariance) * increase,
                ..prior
            },
        }
    }

    /// Returns whether other unknowns are widened than in `other`, or by another size.
    pub fn differs_from(&self, other: &Self) -> bool {
        CAUSES.iter().any(|unknown| {
            let [a, b] = [self, other].map(|widened| 1.0 + widened.increase(*unknown));
            (a / b).ln().abs() > 1.0
        })
    }
}

/// Increase of a prior's covariance by one unit: for the axis the part that belongs to the skin height, else the stated
/// covariance.
fn step(unknown: Unknown, stated: &DMatrix<f64>) -> DMatrix<f64> {
    match unknown {
        Unknown::AxisHeight => axis_height_covariance(AXIS_HEIGHT_STEP_M),
        _ => stated.clone(),
    }
}

/// Evidence about the width of one unknown.
pub struct WidthEvidence {
    /// Squared score and information in independent directions, per unit of [`step`].
    directions: Vec<(f64, f64)>,
    /// Increase in the solution.
    pub current: f64,
    /// Least fraction of the stated variance that the data determine.
    least: f64,
    /// Mean square of the unknown's values, in stated variances.
    pub square: f64,
    /// Value and standard deviation of the unknown's first parameter.
    pub first: (f64, f64),
}

impl WidthEvidence {
    /// Evidence from independent scores; see the fields.
    pub fn new(directions: Vec<(f64, f64)>, current: f64) -> Self {
        Self {
            directions,
            current,
            least: MIN_DETERMINED,
            square: 0.0,
            first: (0.0, 0.0),
        }
        .determined()
    }

    /// Drops directions that the data hardly determine.
    fn determined(mut self) -> Self {
        let least = self.least / (1.0 + self.current);
        self.directions
            .retain(|(_, information)| *information > least);
        self
    }

    fn from_fit(
        problem: &Problem,
        fit: &Fit,
        unknown: Unknown,
        widened: &WidenedPriors,
    ) -> Option<Self> {
        let own: Vec<&Prior> = problem
            .priors
            .iter()
            .filter(|prior| prior.name.unknown == unknown.name())
            .collect();
        let columns: Vec<usize> = own
            .iter()
            .flat_map(|prior| prior.columns.iter().copied())
            .collect();
        let current = widened.increase(unknown);
        let n = columns.len();
        if n == 0 {
            return None;
        }
        let means = own.iter().flat_map(|prior| prior.mean.iter());
        let off = DVector::from_iterator(
            n,
            columns
                .iter()
                .zip(means)
                .map(|(column, mean)| fit.global[*column] - mean),
        );
        let (mut given, mut unit) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        let mut first = 0;
        for prior in own {
            let (at, size) = ((first, first), prior.covariance.shape());
            let stated = &prior.covariance / (1.0 + current);
            unit.view_mut(at, size).copy_from(&step(unknown, &stated));
            given.view_mut(at, size).copy_from(&prior.covariance);
            first += size.0;
        }
        let unit = unit.cholesky()?;
        let (weight, root) = (given.cholesky()?.inverse(), unit.l());
        let posterior = fit
            .covariance
            .select_columns(&columns)
            .select_rows(&columns);
        let information = &weight - &weight * posterior * &weight;
        let SymmetricEigen {
            eigenvectors,
            eigenvalues,
        } = SymmetricEigen::new(root.tr_mul(&information) * &root);
        let score = eigenvectors.tr_mul(&root.tr_mul(&(&weight * &off)));
        let model = if unknown == Unknown::AxisHeight {
            AXIS_HEIGHT_MODEL_M / AXIS_HEIGHT_STEP_M
        } else {
            0.0
        };
        let pairs = score
            .iter()
            .zip(eigenvalues.iter())
            .map(|(score, information)| {
                let kept = 1.0 / (1.0 + information * model * model);
                ((score * kept).powi(2), information * kept)
            });
        let least = match IN_IMAGE.contains(&unknown) {
            true => MIN_DETERMINED_IMAGE,
            false => MIN_DETERMINED,
        };
        let variance = fit.covariance[(columns[0], columns[0])];
        let evidence = Self {
            directions: pairs.collect(),
            current,
            least,
            square: off.dot(&unit.solve(&off)) / n as f64,
            first: (off[0], variance.max(0.0).sqrt()),
        };
        Some(evidence.determined()).filter(|evidence| !evidence.directions.is_empty())
    }

    /// Logarithm of the probability of the scores with an increase relative to that with the current one.
    fn gain(&self, increase: f64) -> f64 {
        let change = increase - self.current;
        let one = |(score, information): &(f64, f64)| {
            change * score / (1.0 + change * information) - (change * information).ln_1p()
        };
        0.5 * self.directions.iter().map(one).sum::<f64>()
    }

    /// Increase with which the data are most probable, and the logarithm of how much more probable they are.
    fn best_increase(&self) -> Option<(f64, f64)> {
        let found = INCREASES
            .map(|power| 2f64.powi(power))
            .map(|increase| (increase, self.gain(increase)));
        found.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Increase that makes the data more probable than none; 0 without one.
    pub fn likely_increase(&self) -> f64 {
        self.best_increase()
            .filter(|(_, gain)| *gain > self.gain(0.0))
            .map_or(0.0, |(increase, _)| increase)
    }

    /// Increase that the data ask for, and how much more probable it makes them, as a logarithm; wide increases are less
    /// probable than small ones (a density of 1 over the increase). `None` if the data, whose variance factor is `factor`, do
    /// not contradict the prior.
    fn increase(&self, factor: f64) -> Option<(f64, f64)> {
        let best = self
            .best_increase()
            .filter(|_| self.probability(factor) < CAUSES_ALPHA / CAUSES.len() as f64);
        best.map(|(increase, gain)| (increase, gain - increase.ln_1p()))
    }

    /// Probability of so large a residual if the prior is true and all variances are larger by `factor`.
    pub fn probability(&self, factor: f64) -> f64 {
        let one = |(score, information): &(f64, f64)| {
            score / (information * (1.0 - self.current * information).max(self.least))
        };
        let square: f64 = self.directions.iter().map(one).sum();
        chi_square_tail(self.directions.len() as f64, square / factor)
    }
}

/// Returns the evidence about the width of each of these causes that the data determine.
pub fn all_evidence<'a>(
    problem: &'a Problem,
    fit: &'a Fit,
    widened: &'a WidenedPriors,
    causes: &'a [Unknown],
) -> impl Iterator<Item = (Unknown, WidthEvidence)> + 'a {
    causes.iter().filter_map(|unknown| {
        Some((
            *unknown,
            WidthEvidence::from_fit(problem, fit, *unknown, widened)?,
        ))
    })
}

/// Fraction of the tip's variance by causes in the image from which on they are not separable from the deflection: its standard
/// deviation is three times as large as without them.
const MAX_IMAGE_SHARE: f64 = 0.9;

/// Returns why another scale or aspect of the image leaves the deflection open; `None` if the markers separate them.
pub fn inseparable_image(widened: &WidenedPriors, budget: &VarianceBudget) -> Option<String> {
    let is_open = |part: &VarianceShare| {
        part.source == Unknown::FlightScale.source() && part.share > MAX_IMAGE_SHARE
    };
    (widened.has_image_cause() && budget.shares.iter().any(is_open)).then(|| {
        "the image has another scale or aspect than the ground frames, which the markers hardly separate from the deflection"
            .into()
    })
}

/// Returns the causes that a solution asks to free: those that are free already, and the most probable new one. One residual
/// may refute several priors; the smallest increase is the most probable. `factor`: variance factor.
pub fn asked_causes(
    (problem, fit): (&Problem, &Fit),
    widened: &WidenedPriors,
    factor: f64,
) -> WidenedPriors {
    let mut causes = vec![];
    let mut new: Option<(Unknown, f64, f64)> = None;
    for (unknown, evidence) in all_evidence(problem, fit, widened, &CAUSES) {
        if evidence.current > 0.0 {
            causes.push((unknown, evidence.likely_increase()));
        } else if let Some((increase, gain)) = evidence.increase(factor)
            && new.is_none_or(|(.., best)| gain > best)
        {
            new = Some((unknown, increase, gain));
        }
    }
    causes.extend(new.map(|(unknown, increase, _)| (unknown, increase)));
    causes.retain(|(_, increase)| *increase > 0.0);
    WidenedPriors(causes)
}
