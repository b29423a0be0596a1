//! Stated standard deviations as claims that the data may refute.
//!
//! What all other information says about an unknown follows from the solution: the prior's residual divided by the prior's
//! covariance, and the part of that covariance that the solution took away. From both follow the probability of the
//! residual if the stated width is true, and the width that the data ask for.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::Solution;
use super::beam::RAISE_TERMS;
use crate::estimation::quality::chi_square_tail;
use crate::estimation::{Fit, Prior, Problem};
use crate::setup::{DEFAULT_REPEATABILITY_PX, Setup};
use crate::widths::{Unknown, Width};

/// Unknowns whose stated widths are tested. The widths of skin and vibrations are estimated from the frames instead; a wrong
/// scale of the images is a wrong image, and diagnosed as such.
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
/// Significance level from which a stated width is contradicted: named, and wider in the result. With all widths of an
/// installation, less than 2 % of correct installations have a remark.
const CONTRADICTION_ALPHA: f64 = 1e-3;
/// Fraction of the default below which a stated width is narrow: five times as precise as usual.
pub const NARROW_FRACTION: f64 = 0.2;
/// Ratio of the tip's standard deviation with the default to that with the stated width from which on a narrow width is decisive.
pub const SENSITIVE_RATIO: f64 = 1.3;
/// Candidate increases of a stated variance, as powers of two.
const INCREASES: std::ops::Range<i32> = -2..14;

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
pub struct WidenedPriors(Vec<(Unknown, f64)>);

impl WidenedPriors {
    /// Returns whether no width is increased.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
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
        TESTED.iter().any(|unknown| {
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
    /// Mean square of the unknown's values, in stated variances.
    square: f64,
}

impl WidthEvidence {
    /// Evidence from independent scores; see the fields.
    pub fn new(mut directions: Vec<(f64, f64)>, current: f64) -> Self {
        directions.retain(|(_, information)| *information > MIN_DETERMINED / (1.0 + current));
        Self {
            directions,
            current,
            square: 0.0,
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
        let evidence = Self::new(pairs.collect(), current);
        (!evidence.directions.is_empty()).then_some(Self {
            square: square / n as f64,
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
    /// probable than small ones (a density of 1 over the increase). `None` if the data do not contradict the stated width.
    fn increase(&self) -> Option<(f64, f64)> {
        let best = self.best_increase().filter(|_| self.is_contradicted());
        best.map(|(increase, gain)| (increase, gain - increase.ln_1p()))
    }

    /// Returns whether the stated width is to be called contradicted.
    fn is_contradicted(&self) -> bool {
        self.probability() < CONTRADICTION_ALPHA
    }

    /// Probability of so large a residual if the stated width is true.
    pub fn probability(&self) -> f64 {
        let one = |(score, information): &(f64, f64)| {
            score / (information * (1.0 - self.current * information).max(MIN_DETERMINED))
        };
        chi_square_tail(
            self.directions.len() as f64,
            self.directions.iter().map(one).sum(),
        )
    }
}

fn all_evidence<'a>(
    problem: &'a Problem,
    fit: &'a Fit,
    widened: &'a WidenedPriors,
) -> impl Iterator<Item = (Unknown, WidthEvidence)> + 'a {
    TESTED.into_iter().filter_map(|unknown| {
        Some((
            unknown,
            WidthEvidence::from_fit(problem, fit, unknown, widened)?,
        ))
    })
}

/// Largest number of widths that are increased in one result.
pub const WIDENING_PASSES: usize = 3;

/// Returns the increases that a solution asks for, each counted from the stated width: of those that are increased already,
/// and of the one whose increase explains the data best. One residual may refute several widths, such as those of the
/// mounting's and the root's rotation; the smallest increase is the most probable.
pub fn widen_refuted_priors(
    problem: &Problem,
    fit: &Fit,
    widened: &WidenedPriors,
) -> WidenedPriors {
    let asked =
        |(unknown, evidence): (Unknown, WidthEvidence)| Some((unknown, evidence.increase()?));
    let (mut again, new): (Vec<_>, Vec<_>) = all_evidence(problem, fit, widened)
        .filter_map(asked)
        .partition(|(unknown, _)| widened.increase(*unknown) > 0.0);
    again.extend(new.into_iter().max_by(|(_, a), (_, b)| a.1.total_cmp(&b.1)));
    WidenedPriors(
        again
            .into_iter()
            .map(|(unknown, (increase, _))| (unknown, increase))
            .collect(),
    )
}

/// Words of the remark on a contradicted width.
const CONTRADICTED: &str = "is contradicted: the";

/// Returns whether the data contradict a stated width of a result.
pub fn is_width_contradicted(solution: &Solution) -> bool {
    solution
        .remarks
        .iter()
        .any(|remark| remark.contains(CONTRADICTED))
}

/// Formats a positive number with two significant digits.
pub fn two_digits(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 6.0);
    format!("{value:.0$}", decimals as usize)
}

/// A width that `installation.toml` states, or its default.
pub struct StatedWidth {
    /// Section and key.
    pub key: String,
    /// Unit of the key.
    pub unit: &'static str,
    /// Stated value, in the unit of the key.
    pub value: f64,
    /// Its default.
    pub default: f64,
}

impl StatedWidth {
    /// Finds the width of an unknown. `stayed`: the camera is stated to have stayed since the ground frames.
    pub fn of_unknown(setup: &Setup, unknown: Unknown, stayed: bool) -> Self {
        let row = Width::ROWS
            .iter()
            .find(|row| row.unknowns.contains(&unknown));
        match (unknown, row) {
            (Unknown::MountingRotation, _) if !stayed => Self {
                key: "camera.mount_repeatability_px".into(),
                unit: "px",
                value: setup.mount_repeatability_px,
                default: DEFAULT_REPEATABILITY_PX,
            },
            (_, Some(row)) => Self {
                key: format!("{}.{}", row.section, row.key),
                unit: row.unit.name,
                value: setup.uncertainty[row.width] / row.unit.factor,
                default: row.default_for(setup.reach_m()) / row.unit.factor,
            },
            (_, None) => Self {
                key: "thermal.sigma_k".into(),
                unit: "times the stated value",
                value: 1.0,
                default: 1.0,
            },
        }
    }

    /// Increase of the prior's covariance from the stated width to the default; `None` if the stated one is not much narrower.
    pub fn increase_to_default(
        &self,
        unknown: Unknown,
        stated: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        (self.value < NARROW_FRACTION * self.default).then(|| match unknown {
            Unknown::AxisHeight => {
                axis_height_covariance(self.default) - axis_height_covariance(self.value)
            }
            _ => stated * ((self.default / self.value).powi(2) - 1.0),
        })
    }
}

/// Remark that names the stated width that the data contradict most, if one is widened. `stayed`: the camera is stated
/// to have stayed since the ground frames.
pub fn contradiction_remark(
    setup: &Setup,
    stayed: bool,
    (problem, fit): (&Problem, &Fit),
    widened: &WidenedPriors,
) -> Option<String> {
    if widened.is_empty() {
        return None;
    }
    let contradicted =
        all_evidence(problem, fit, widened).filter(|(_, evidence)| evidence.current > 0.0);
    let (unknown, evidence) =
        contradicted.min_by(|a, b| a.1.probability().total_cmp(&b.1.probability()))?;
    let StatedWidth {
        key,
        unit,
        value: stated,
        ..
    } = StatedWidth::of_unknown(setup, unknown, stayed);
    // The rotation is named by its size, other unknowns by the root mean square of their values.
    let values = if unknown == Unknown::MountingRotation {
        3.0
    } else {
        1.0
    };
    let (step, counted) = match unknown {
        Unknown::AxisHeight => (
            AXIS_HEIGHT_STEP_M,
            stated.hypot(AXIS_HEIGHT_STEP_M * evidence.current.sqrt()),
        ),
        _ => (stated, stated * (1.0 + evidence.current).sqrt()),
    };
    let moved = if stayed && unknown == Unknown::MountingRotation {
        "; the camera did not stay as it was"
    } else {
        ""
    };
    Some(format!(
        "{key} = {stated} {CONTRADICTED} {} is off by about {} {unit}{moved}. The result counts with {} {unit}",
        unknown.name(),
        two_digits(step * (values * evidence.square).sqrt()),
        two_digits(counted),
    ))
}
