//! Causes of a misfit: unknowns whose prior standard deviations the data refute. A significant one counts in the solution,
//! with the larger prior standard deviation that the data ask for, or makes the result doubtful.
//!
//! What all other information says about an unknown follows from the solution: the prior's residual divided by the prior's
//! covariance, and the part of that covariance that the solution took away. From both follow the probability of the
//! residual if the prior is true, and the prior that the data ask for, without another solution.
//!
//! Scale and aspect of the image come first: one unknown that explains all markers is more probable than several.

mod remarks;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::beam::RAISE_TERMS;
use super::{VarianceBudget, VarianceShare};
use crate::estimation::quality::chi_square_tail;
use crate::estimation::{Fit, Prior, Problem};
use crate::ordering::sort_by_value;
use crate::widths::Unknown;

pub use remarks::{StatedWidth, cause_remarks, two_digits};

/// Causes in the image: they are tried before all others, and before outliers are removed.
pub const IN_IMAGE: [Unknown; 2] = [Unknown::FlightScale, Unknown::Aspect];
/// Further causes. The prior standard deviations of skin and vibrations are estimated from the frames instead.
pub const TESTED: [Unknown; 13] = [
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

/// Fraction of a stated variance that the data must determine for a direction to be tested: below, the linear model does not
/// carry as far as the residual asks.
const MIN_DETERMINED: f64 = 2e-3;
/// The same for scale and aspect of the image, in which the model is linear: changes of 300 standard deviations, 1.5 % of aspect.
const MIN_DETERMINED_IMAGE: f64 = 1e-5;
/// Significance level from which a stated width is contradicted: named, and wider in the result. With all widths of an
/// installation, less than 2 % of correct installations have a remark.
const CONTRADICTION_ALPHA: f64 = 1e-3;
/// Fraction of the default below which a stated width is narrow: five times as precise as usual.
pub const NARROW_FRACTION: f64 = 0.2;
/// Ratio of the tip's standard deviation with the default to that with the stated width from which on a narrow width is decisive.
pub const SENSITIVE_RATIO: f64 = 1.3;
/// Candidate increases of a stated variance, as powers of two.
const INCREASES: std::ops::Range<i32> = -2..20;
/// Increase of the variance of scale and aspect if nothing is known about them: standard deviations of 5 % and 1.3 % by default.
const WIDEST: f64 = 65_536.0;
/// Difference of the logarithms of two causes' probabilities below which they explain the data equally well: odds of 20 to 1.
const ALIKE: f64 = 3.0;

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
const AXIS_HEIGHT_STEP_M: f64 = 0.01;
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
pub struct WidenedPriors {
    increases: Vec<(Unknown, f64)>,
    /// Whether they were found without outliers.
    is_settled: bool,
    /// Other causes that explain the data equally well.
    pub alternatives: Vec<WidenedPriors>,
}

impl WidenedPriors {
    /// Returns whether no width is increased.
    pub fn is_empty(&self) -> bool {
        self.increases.is_empty()
    }

    /// Returns the causes in the image, with the widest priors.
    pub fn free_image() -> Self {
        Self {
            increases: IN_IMAGE.map(|cause| (cause, WIDEST)).to_vec(),
            ..Self::default()
        }
    }

    /// Returns whether no cause was looked for yet.
    pub fn is_unsettled(&self) -> bool {
        self.is_empty() && !self.is_settled
    }

    /// Returns the names of the causes.
    fn names(&self) -> String {
        let names: Vec<&str> = self.increases.iter().map(|(one, _)| one.name()).collect();
        names.join(" with ")
    }

    /// Returns whether the image has another scale or aspect.
    pub fn has_image_cause(&self) -> bool {
        IN_IMAGE.iter().any(|cause| self.increase(*cause) > 0.0)
    }

    /// Returns the increase of an unknown's variance; 0: it has its stated width.
    pub fn increase(&self, unknown: Unknown) -> f64 {
        self.increases
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
        IN_IMAGE.iter().chain(&TESTED).any(|unknown| {
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
    current: f64,
    /// Least fraction of the stated variance that the data determine.
    least: f64,
    /// Mean square of the unknown's values, in stated variances.
    square: f64,
    /// Value and standard deviation of the unknown's first parameter.
    first: (f64, f64),
}

impl WidthEvidence {
    /// Evidence from independent scores; see the fields.
    pub fn new(directions: Vec<(f64, f64)>, current: f64) -> Self {
        Self::determined(directions, current, MIN_DETERMINED)
    }

    fn determined(mut directions: Vec<(f64, f64)>, current: f64, least: f64) -> Self {
        directions.retain(|(_, information)| *information > least / (1.0 + current));
        Self {
            directions,
            current,
            least,
            square: 0.0,
            first: (0.0, 0.0),
        }
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
        let (mut weight, mut root) = (DMatrix::zeros(n, n), DMatrix::zeros(n, n));
        let (mut first, mut square) = (0, 0.0);
        for prior in own {
            let size = prior.columns.len();
            let one = match unknown {
                Unknown::AxisHeight => step(unknown, &prior.covariance),
                _ => &prior.covariance / (1.0 + current),
            };
            let factor = one.cholesky()?;
            let values = off.rows(first, size).into_owned();
            square += values.dot(&factor.solve(&values));
            let at = ((first, first), (size, size));
            root.view_mut(at.0, at.1).copy_from(&factor.l());
            weight
                .view_mut(at.0, at.1)
                .copy_from(&prior.covariance.clone().cholesky()?.inverse());
            first += size;
        }
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
        let evidence = Self::determined(pairs.collect(), current, least);
        let variance = fit.covariance[(columns[0], columns[0])];
        (!evidence.directions.is_empty()).then_some(Self {
            square: square / n as f64,
            first: (off[0], variance.max(0.0).sqrt()),
            ..evidence
        })
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
            .filter(|(_, gain)| *gain > 0.0)
            .map_or(0.0, |(increase, _)| increase)
    }

    /// Increase that the data ask for, and how much more probable it makes them, as a logarithm; wide increases are less
    /// probable than small ones (a density of 1 over the increase). `None` if the data, whose variance factor is `factor`, do
    /// not contradict the prior.
    fn increase(&self, factor: f64) -> Option<(f64, f64)> {
        let best = self
            .best_increase()
            .filter(|_| self.tail(factor) < CONTRADICTION_ALPHA);
        best.map(|(increase, gain)| (increase, gain - increase.ln_1p()))
    }

    /// Probability of so large a residual if the stated width is true.
    pub fn probability(&self) -> f64 {
        self.tail(1.0)
    }

    /// Probability of so large a residual if the prior is true and all variances are larger by `factor`.
    fn tail(&self, factor: f64) -> f64 {
        let one = |(score, information): &(f64, f64)| {
            score / (information * (1.0 - self.current * information).max(self.least))
        };
        let square: f64 = self.directions.iter().map(one).sum();
        chi_square_tail(self.directions.len() as f64, square / factor)
    }
}

fn all_evidence<'a>(
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

/// Difference of the tip deflections with one cause and with another, over the standard deviation, from which on a result is
/// doubtful: the wrong choice adds as much as all other errors.
const MAX_SPREAD: f64 = 1.0;
/// Fraction of the variance of the tip deflection by scale and aspect of the image from which on they are not separable from it:
/// the standard deviation is three times as large as without them.
const MAX_IMAGE_SHARE: f64 = 0.9;

/// Returns why another scale or aspect of the image leaves the deflection open.
pub fn inseparable_image(widened: &WidenedPriors, budget: &VarianceBudget) -> Option<String> {
    let is_of_image = |share: &&VarianceShare| share.source == Unknown::FlightScale.source();
    let share = budget.shares.iter().find(is_of_image)?.share;
    (widened.has_image_cause() && share > MAX_IMAGE_SHARE).then(|| {
        "the image has another scale or aspect than the ground frames, and the markers hardly separate it from the deflection"
            .into()
    })
}

/// Largest number of solutions in which causes are freed one after the other.
pub const FREEING_PASSES: usize = 4;

/// Returns the causes that a solution asks to free, whose outliers are removed and whose variance factor is `factor`: those that
/// are free and still significant, and the best new one. One residual may refute several priors, such as those of the mounting's
/// and the root's rotation; the smallest increase is the most probable.
pub fn asked_causes(
    problem: &Problem,
    fit: &Fit,
    widened: &WidenedPriors,
    factor: f64,
) -> WidenedPriors {
    let all = [&IN_IMAGE[..], &TESTED].concat();
    asked_among(&all, problem, fit, widened, factor)
}

/// Returns the causes in the image that a solution with all observations asks to free: its outliers may be consequences.
pub fn asked_image_causes(problem: &Problem, fit: &Fit) -> WidenedPriors {
    WidenedPriors {
        is_settled: false,
        ..asked_among(&IN_IMAGE, problem, fit, &WidenedPriors::default(), 1.0)
    }
}

fn asked_among(
    causes: &[Unknown],
    problem: &Problem,
    fit: &Fit,
    widened: &WidenedPriors,
    factor: f64,
) -> WidenedPriors {
    let asked = all_evidence(problem, fit, widened, causes)
        .filter_map(|(unknown, evidence)| Some((unknown, evidence.increase(factor)?)));
    let (again, mut new): (Vec<_>, Vec<_>) =
        asked.partition(|(unknown, _)| widened.increase(*unknown) > 0.0);
    if new.iter().any(|(unknown, _)| IN_IMAGE.contains(unknown)) {
        new.retain(|(unknown, _)| IN_IMAGE.contains(unknown));
    }
    sort_by_value(&mut new, |(_, (_, gain))| -gain);
    let with = |one: Option<&(Unknown, (f64, f64))>| WidenedPriors {
        increases: again
            .iter()
            .chain(one)
            .map(|(unknown, (increase, _))| (*unknown, *increase))
            .collect(),
        is_settled: true,
        alternatives: vec![],
    };
    let least = new.first().map_or(0.0, |(_, (_, gain))| gain - ALIKE);
    let alike = new.iter().skip(1).filter(|(_, (_, gain))| *gain > least);
    let alternatives = widened.alternatives.iter().cloned();
    WidenedPriors {
        alternatives: alternatives
            .chain(alike.map(|one| with(Some(one))))
            .collect(),
        ..with(new.first())
    }
}

/// Returns why another cause, which explains the data equally well, leaves a deflection open: with the causes `free` it has a value
/// and a standard deviation, with the other ones another value.
pub fn find_spread(
    (free, other): (&WidenedPriors, &WidenedPriors),
    (value, sigma): (f64, f64),
    other_value: f64,
) -> Option<String> {
    let spread = (other_value - value).abs();
    (spread > MAX_SPREAD * sigma).then(|| {
        format!(
            "two causes explain the image equally well, with tip deflections that differ by {:.0} mm: {}, or {}",
            1e3 * spread,
            free.names(),
            other.names()
        )
    })
}
