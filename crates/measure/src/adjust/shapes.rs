//! Shape of bent wings: the reference curvature `m`, the curvature functions derived from it, and the spread of the shapes
//! of a fleet of wings.
//!
//! A cantilever's curvature is its bending moment divided by its stiffness. The reference includes the free end (no moment,
//! hence no curvature) and the taper. A few polynomials times the reference therefore follow a real wing to 1 mm, compared
//! with 10 mm for a plain polynomial of four terms.

use std::sync::LazyLock;

use nalgebra::{DMatrix, SMatrix, SVector};

/// Largest number of curvature terms.
pub const MAX_CURVATURE_TERMS: usize = 10;
/// Number of ratios of the terms to the first.
pub const CURVATURE_RATIOS: usize = MAX_CURVATURE_TERMS - 1;

/// Values, one per curvature term.
pub type CurvatureTermValues = [f64; MAX_CURVATURE_TERMS];

/// Curvature that is typical in flight, 1/m: the start of every solution, and the reference for vibration.
pub const TYPICAL_CURVATURE_PER_M: f64 = 5e-3;
/// Curvature below which the wing counts as unbent, 1/m (0.1 m at 32 m).
const MIN_CURVATURE_PER_M: f64 = 2e-4;

/// Returns the amplitude with which shapes are weighted, 1/m: a leading curvature coefficient, not below that of an unbent
/// wing.
pub fn bounded_amplitude(curvature_per_m: f64) -> f64 {
    curvature_per_m.abs().max(MIN_CURVATURE_PER_M)
}

const TABLE: usize = 1025;
/// Step in the table at which beams are compared.
const STRIDE: usize = 8;

/// Tapered cantilever.
#[derive(Clone, Copy, Debug)]
struct TaperedBeam {
    taper: f64,
    /// Chord at the root over that of the straight taper from [`CHORD_BREAK`] on, minus 1.
    root_extension: f64,
    /// Exponent of the chord in the bending stiffness; 3: skins of constant thickness.
    power: f64,
}

/// Place of the break of the trailing edge, as a fraction of the length: an airliner's.
const CHORD_BREAK: f64 = 0.35;

const REFERENCE: TaperedBeam = TaperedBeam {
    taper: 0.3,
    root_extension: 0.0,
    power: 3.0,
};

/// Range of [`TaperedBeam::taper`] in the fleet.
const TAPER_RANGE: [f64; 2] = [0.2, 0.45];
/// Range of [`TaperedBeam::root_extension`].
const ROOT_EXTENSION_RANGE: [f64; 2] = [0.0, 0.35];
/// Range of [`TaperedBeam::power`].
const POWER_RANGE: [f64; 2] = [2.5, 4.0];
/// Range of the fraction of triangular load in an otherwise elliptic lift distribution.
const TRIANGULAR_RANGE: [f64; 2] = [0.0, 1.0];
/// Range of the fuel weight over lift at the root; the weight is proportional to the chord.
const FUEL_RANGE: [f64; 2] = [0.0, 0.35];
/// Range of the end of the tanks as a fraction of the span.
const TANK_END_RANGE: [f64; 2] = [0.55, 0.85];

/// Three points with nearly the spread of a uniform distribution over a range.
fn sample_range([low, high]: [f64; 2]) -> [f64; 3] {
    [0.11, 0.5, 0.89].map(|share| low + (high - low) * share)
}

/// Effects that the beams of the fleet do not include (steps in stiffness, engines, stores): standard deviations of the
/// coefficients' ratios.
const BEYOND_FLEET: [f64; CURVATURE_RATIOS] =
    [0.1, 0.07, 0.05, 0.035, 0.025, 0.02, 0.015, 0.012, 0.01];

/// Exponent of the chord in the mass, for a box of skins, fuel and ribs.
const MASS_POWER: i32 = 2;

/// Changes of a beam's shape while fuel is burnt that the fleet does not include, as a factor of [`BEYOND_FLEET`].
const BEYOND_BURNING: f64 = 0.05;

/// Mean square of the fraction of fuel that a flight burns, for a uniform distribution.
pub const MEAN_SQUARE_BURNT: f64 = 1.0 / 3.0;

/// Range of possible kinks, as fractions of the length: joints at the fuselage and at the trailing-edge break, engines.
const KINKS: std::ops::RangeInclusive<f64> = 0.1..=0.6;

/// Largest curvature at which the shortening is computed, 1/m: 4 m at the tip of a 33 m wing.
const STRONG_CURVATURE_PER_M: f64 = 0.01;
/// Number of iterations; each gains two digits.
const SHORTENING_PASSES: usize = 4;

/// Elliptic lift distribution at `eta`, relative to the root.
fn elliptic_lift(eta: f64) -> f64 {
    (1.0 - eta * eta).max(0.0).sqrt()
}

impl TaperedBeam {
    fn chord_at(&self, eta: f64) -> f64 {
        (1.0 - (1.0 - self.taper) * eta)
            * (1.0 + self.root_extension * (1.0 - eta / CHORD_BREAK).max(0.0))
    }

    /// Bending moment over stiffness at `count` points from root to tip, in arbitrary units, for the mean load on each interval,
    /// with lever arms shortened to the horizontal fraction of each interval.
    fn curvature_under(
        &self,
        count: usize,
        load: impl Fn(usize) -> f64,
        horizontal: impl Fn(usize) -> f64,
    ) -> Vec<f64> {
        let step = 1.0 / (count - 1) as f64;
        let (mut shear, mut moment) = (0.0, 0.0);
        let mut curvature = vec![0.0; count];
        for k in (0..count - 1).rev() {
            let added = step * load(k);
            moment += step * horizontal(k) * (shear + 0.5 * added);
            shear += added;
            curvature[k] = moment / self.chord_at(k as f64 * step).powf(self.power);
        }
        curvature
    }
}

/// Values of a function of eta in the middle of the intervals between `count` points.
fn at_middles(count: usize, value: impl Fn(f64) -> f64) -> impl Fn(usize) -> f64 {
    let step = 1.0 / (count - 1) as f64;
    move |k| value((k as f64 + 0.5) * step)
}

/// Covariance of ratios of curvature coefficients to the first.
type RatioCovariance = SMatrix<f64, CURVATURE_RATIOS, CURVATURE_RATIOS>;

/// Integrals of m P_k from 0 to eta, per unit of length.
static SHAPES: LazyLock<Vec<CurvatureTermValues>> = LazyLock::new(tabulate_basis_integrals);

static FLEET: LazyLock<FleetCovariances> = LazyLock::new(FleetCovariances::new);

/// Prior covariance of the ratios c_k / c_0 of `terms` coefficients, starting with the second.
pub fn shape_covariance(terms: usize) -> DMatrix<f64> {
    leading_block(&FLEET.shape, terms)
}

fn leading_block(covariance: &RatioCovariance, terms: usize) -> DMatrix<f64> {
    let n = terms.saturating_sub(1);
    DMatrix::from_fn(n, n, |i, j| covariance[(i, j)])
}

/// Covariance of the change of the ratios c_k / c_0 of `terms` coefficients, starting with the second, from the heaviest
/// frame of a flight to the lightest, if a random fraction of the fuel is burnt.
pub fn burning_covariance(terms: usize) -> DMatrix<f64> {
    leading_block(&FLEET.burnt, terms)
}

/// Part of [`shape_covariance`] that no load of a beam explains: any smooth shape, for example a vibration in the second
/// mode.
pub fn beyond_fleet_covariance(terms: usize) -> DMatrix<f64> {
    leading_block(&beyond_fleet_variances(1.0), terms)
}

/// Covariance of the coefficients c_k, k = 1.., of a bend that is independent of the load and raises the tip by one wing
/// length, times that length. Skins of different temperature bend a box of constant height, or of a height tapered like the
/// chord; a loose joint is a kink anywhere inboard. Temperature and joints have equal weight.
pub fn constant_bend_covariance(terms: usize) -> DMatrix<f64> {
    leading_block(&CONSTANT_COVARIANCE, terms)
}

static CONSTANT_COVARIANCE: LazyLock<RatioCovariance> =
    LazyLock::new(compute_constant_bend_covariance);

fn compute_constant_bend_covariance() -> RatioCovariance {
    let fit = RatioFit::new();
    let count = fit.basis.len();
    let step = 1.0 / (count - 1) as f64;
    let thermal = [0.0, 1.0].map(|power| -> Vec<f64> {
        (0..count)
            .map(|k| REFERENCE.chord_at(k as f64 * step).powf(-power))
            .collect()
    });
    let kink = |at: usize| (0..count).map(|k| f64::from(u8::from(k == at))).collect();
    let kinks: Vec<Vec<f64>> = (0..count)
        .filter(|k| KINKS.contains(&(*k as f64 * step)))
        .map(kink)
        .collect();
    let mut sum = SMatrix::zeros();
    for (shapes, weight) in [(&thermal[..], 0.25), (&kinks, 0.5 / kinks.len() as f64)] {
        for shape in shapes {
            let rise = integrate_twice(step, shape)[count - 1];
            let c = fit
                .fit_basis_coefficients(shape)
                .fixed_rows::<CURVATURE_RATIOS>(1)
                / rise;
            sum += c * c.transpose() * weight;
        }
    }
    sum
}

/// First-mode deflection of the reference beam caused by each curvature `m P_k`, relative to `m`. Vibrations in other modes
/// do not contribute because the modes are orthogonal with respect to mass.
static FIRST_MODE: LazyLock<CurvatureTermValues> = LazyLock::new(compute_first_bending_mode);

/// First-mode amplitude of each curvature basis function, relative to the reference curvature.
pub fn first_mode_amplitudes() -> &'static CurvatureTermValues {
    &FIRST_MODE
}

fn compute_first_bending_mode() -> CurvatureTermValues {
    let step = 1.0 / (TABLE - 1) as f64;
    let at = |k: usize| k as f64 * step;
    let mass = |k: usize| REFERENCE.chord_at(at(k)).powi(MASS_POWER);
    // Stodola's iteration from a parabola: each pass reduces the second mode to 2.5 %, (1.875 / 4.694)^4.
    let mut deflection: Vec<f64> = (0..TABLE).map(|k| at(k).powi(2)).collect();
    for _ in 0..3 {
        let inertia = |k: usize| 0.5 * (mass(k) * deflection[k] + mass(k + 1) * deflection[k + 1]);
        let curvature = REFERENCE.curvature_under(TABLE, inertia, |_| 1.0);
        deflection = integrate_twice(step, &curvature);
    }
    let values = sample_basis(TABLE);
    let share = |j: usize| -> f64 {
        let curvature: Vec<f64> = values.iter().map(|all| all[j]).collect();
        integrate_twice(step, &curvature)
            .iter()
            .enumerate()
            .map(|(k, w)| mass(k) * deflection[k] * w)
            .sum()
    };
    let whole = share(0);
    std::array::from_fn(|j| share(j) / whole)
}

fn integrate_twice(step: f64, curvature: &[f64]) -> Vec<f64> {
    let (mut slope, mut rise) = (0.0, 0.0);
    let mut out = vec![0.0];
    for pair in curvature.windows(2) {
        let next = slope + 0.5 * step * (pair[0] + pair[1]);
        rise += 0.5 * step * (slope + next);
        slope = next;
        out.push(rise);
    }
    out
}

/// Samples m P_k at `count` points; m has mean 1.
fn sample_basis(count: usize) -> Vec<CurvatureTermValues> {
    let curvature = REFERENCE.curvature_under(count, at_middles(count, elliptic_lift), |_| 1.0);
    let mean = curvature.iter().sum::<f64>() / (count - 1) as f64;
    let at = |k: usize| {
        legendre_polynomials(2.0 * k as f64 / (count - 1) as f64 - 1.0)
            .map(|p| p * curvature[k] / mean)
    };
    (0..count).map(at).collect()
}

fn tabulate_basis_integrals() -> Vec<CurvatureTermValues> {
    let step = 1.0 / (TABLE - 1) as f64;
    let values = sample_basis(TABLE);
    let mut sums = vec![[0.0; MAX_CURVATURE_TERMS]; TABLE];
    for k in 1..TABLE {
        let before = sums[k - 1];
        sums[k] =
            std::array::from_fn(|j| before[j] + 0.5 * step * (values[k - 1][j] + values[k][j]));
    }
    sums
}

/// Covariances of the ratios c_k / c_0, k = 1.., including effects beyond the fleet.
struct FleetCovariances {
    /// Over the fleet.
    shape: RatioCovariance,
    /// Of the change due to fuel burnt in a flight, which burns a random fraction of it.
    burnt: RatioCovariance,
}

impl FleetCovariances {
    /// Fits the fleet's beams with the basis, once per kind of load: the coefficients are linear in it.
    fn new() -> Self {
        let fit = RatioFit::new();
        let ratios_of =
            |c: SVector<f64, MAX_CURVATURE_TERMS>| c.fixed_rows::<CURVATURE_RATIOS>(1) / c[0];
        let (mut shapes, mut changes) = (Vec::new(), Vec::new());
        for beam in sample_fleet_beams() {
            let under = |load: &dyn Fn(f64) -> f64| {
                let count = fit.basis.len();
                let curvature = beam.curvature_under(count, at_middles(count, load), |_| 1.0);
                fit.fit_basis_coefficients(&curvature)
            };
            let elliptic = under(&elliptic_lift);
            let triangular = under(&|eta| 1.0 - eta);
            let tanks = sample_range(TANK_END_RANGE)
                .map(|end| under(&|eta| if eta < end { beam.chord_at(eta) } else { 0.0 }));
            for share in sample_range(TRIANGULAR_RANGE) {
                let lift = elliptic + (triangular - elliptic) * share;
                for tank in &tanks {
                    for fuel in sample_range(FUEL_RANGE) {
                        shapes.push(ratios_of(lift - tank * fuel));
                        changes.push(shapes[shapes.len() - 1] - ratios_of(lift));
                    }
                }
            }
        }
        Self {
            shape: beyond_fleet_variances(1.0) + mean_square(&shapes),
            burnt: beyond_fleet_variances(BEYOND_BURNING)
                + mean_square(&changes) * MEAN_SQUARE_BURNT,
        }
    }
}

fn mean_square(all: &[SVector<f64, CURVATURE_RATIOS>]) -> RatioCovariance {
    let squares = all.iter().map(|r| r * r.transpose());
    squares.sum::<RatioCovariance>() / all.len() as f64
}

fn sample_fleet_beams() -> Vec<TaperedBeam> {
    let mut beams = Vec::new();
    for taper in sample_range(TAPER_RANGE) {
        for root_extension in sample_range(ROOT_EXTENSION_RANGE) {
            for power in sample_range(POWER_RANGE) {
                beams.push(TaperedBeam {
                    taper,
                    root_extension,
                    power,
                });
            }
        }
    }
    beams
}

fn beyond_fleet_variances(share: f64) -> RatioCovariance {
    SMatrix::from_diagonal(&SVector::from(BEYOND_FLEET).map(|s| (s * share).powi(2)))
}

/// Least-squares fit of curvatures with the basis.
struct RatioFit {
    basis: Vec<SVector<f64, MAX_CURVATURE_TERMS>>,
    inverse: SMatrix<f64, MAX_CURVATURE_TERMS, MAX_CURVATURE_TERMS>,
}

impl RatioFit {
    fn new() -> Self {
        let basis: Vec<_> = sample_basis(TABLE / STRIDE + 1)
            .into_iter()
            .map(SVector::from)
            .collect();
        let normal: SMatrix<f64, MAX_CURVATURE_TERMS, MAX_CURVATURE_TERMS> = basis
            .iter()
            .fold(SMatrix::zeros(), |sum, b| sum + b * b.transpose());
        Self {
            basis,
            inverse: normal.try_inverse().unwrap_or_else(SMatrix::zeros),
        }
    }

    fn fit_basis_coefficients(&self, curvature: &[f64]) -> SVector<f64, MAX_CURVATURE_TERMS> {
        let right = self
            .basis
            .iter()
            .zip(curvature)
            .fold(SVector::zeros(), |sum, (b, k)| sum + b * *k);
        self.inverse * right
    }
}

/// Half the second derivatives of the ratios c_k / c_0 with respect to the amplitude c_0, m^2, if the load stays vertical
/// while the beam rotates and its lever arms shorten. Computed for the reference beam on an unbent axis of this length and
/// these slopes (over s/L).
pub fn shortening_effect(length_m: f64, slope_rad: impl Fn(f64) -> f64) -> [f64; CURVATURE_RATIOS] {
    let fit = RatioFit::new();
    let at =
        |share: f64| shortened_ratios(&fit, length_m, &slope_rad, share * STRONG_CURVATURE_PER_M);
    let bend = at(0.0) - at(0.5) * 2.0 + at(1.0);
    (bend * (2.0 / STRONG_CURVATURE_PER_M.powi(2))).into()
}

/// Ratios for a vertically loaded reference beam that is bent to an amplitude.
fn shortened_ratios(
    fit: &RatioFit,
    length_m: f64,
    slope_rad: impl Fn(f64) -> f64,
    amplitude: f64,
) -> SVector<f64, CURVATURE_RATIOS> {
    let count = fit.basis.len();
    let step = 1.0 / (count - 1) as f64;
    let mut bent = vec![0.0; count];
    let mut ratios = SVector::zeros();
    for _ in 0..SHORTENING_PASSES {
        let curvature = REFERENCE.curvature_under(count, at_middles(count, elliptic_lift), |k| {
            (slope_rad(k as f64 * step) + bent[k]).cos()
        });
        let c = fit.fit_basis_coefficients(&curvature);
        ratios = c.fixed_rows::<CURVATURE_RATIOS>(1) / c[0];
        let scale = amplitude * length_m * step / c[0];
        for k in 1..count {
            bent[k] = bent[k - 1] + 0.5 * scale * (curvature[k - 1] + curvature[k]);
        }
    }
    ratios
}

/// Values of m P_k from 0 to 1.
static VALUES: LazyLock<Vec<CurvatureTermValues>> = LazyLock::new(|| sample_basis(TABLE));

/// Values of m P_k at `eta`; the curvature is their sum weighted by the coefficients.
pub fn curvature_basis(eta: f64) -> [f64; MAX_CURVATURE_TERMS] {
    interpolate_table(&VALUES, eta)
}

/// Integrals of m P_k from the root to `eta`, per unit of length.
pub fn curvature_integrals(eta: f64) -> CurvatureTermValues {
    interpolate_table(&SHAPES, eta)
}

fn interpolate_table(table: &[CurvatureTermValues], eta: f64) -> CurvatureTermValues {
    let at = eta.clamp(0.0, 1.0) * (TABLE - 1) as f64;
    let k = (at as usize).min(TABLE - 2);
    let t = at - k as f64;
    std::array::from_fn(|j| table[k][j] + t * (table[k + 1][j] - table[k][j]))
}

/// Legendre polynomials of degree 0 to N - 1.
pub fn legendre_polynomials<const N: usize>(x: f64) -> [f64; N] {
    let mut p = [1.0; N];
    if N > 1 {
        p[1] = x;
    }
    for k in 2..N {
        let n = k as f64;
        p[k] = ((2.0 * n - 1.0) * x * p[k - 1] - (n - 1.0) * p[k - 2]) / n;
    }
    p
}
