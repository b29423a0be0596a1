//! What bent wings look like: the reference curvature `m`, the curvatures that grow from it, and how
//! far the wings of a fleet spread around it.
//!
//! A cantilever's curvature is its bending moment over its stiffness. The reference carries the free
//! end (no moment, hence no curvature) and the taper, so that few polynomials times it follow a real
//! wing to a millimetre where a plain polynomial of four terms leaves ten.

use std::sync::LazyLock;

use nalgebra::{DMatrix, SMatrix, SVector};

/// Largest number of terms of the curvature.
pub const MAX_CURVATURE_TERMS: usize = 10;
/// Ratios of the terms to the first.
pub const RATIOS: usize = MAX_CURVATURE_TERMS - 1;

/// One value per term.
pub type Integrals = [f64; MAX_CURVATURE_TERMS];

const TABLE: usize = 1025;
/// Every so many points of the table are enough to compare beams.
const STRIDE: usize = 8;

/// A tapered cantilever and its load.
#[derive(Clone, Copy, Debug)]
struct Beam {
    /// Chord at the tip over chord at the root.
    taper: f64,
    /// Bending stiffness goes with this power of the chord; 3: skins of constant thickness.
    power: f64,
    /// Share of a triangular load in an otherwise elliptic deflection.
    triangular: f64,
    /// Weight of the fuel over the deflection at the root, proportional to the chord.
    relief: f64,
    /// Where the tanks end, over the span.
    reach: f64,
}

const REFERENCE: Beam = Beam { taper: 0.3, power: 3.0, triangular: 0.0, relief: 0.0, reach: 0.0 };

/// What the beams of a fleet have between them, low to high.
const FLEET: [Beam; 2] = [
    Beam { taper: 0.2, power: 2.5, triangular: 0.0, relief: 0.0, reach: 0.55 },
    Beam { taper: 0.45, power: 4.0, triangular: 1.0, relief: 0.35, reach: 0.85 },
];

/// What a beam of the fleet still leaves out (steps of the stiffness, engines, stores): standard
/// deviations of the coefficients' ratios.
const BEYOND_FLEET: [f64; RATIOS] = [0.1, 0.07, 0.05, 0.035, 0.025, 0.02, 0.015, 0.012, 0.01];

/// Mass goes with this power of the chord where it is a box of skins, of fuel and of ribs.
const MASS_POWER: i32 = 2;

/// The same for the change of a beam's shape while it loses its fuel, over the above.
const BEYOND_BURNING: f64 = 0.05;

/// Mean square of the share of its fuel that a flight burns: any share is as likely as another.
const BURNT: f64 = 1.0 / 3.0;

/// Where a wing may have a kink, shares of the length: joints at the fuselage and at the trailing edge's break, engines.
const KINKS: std::ops::RangeInclusive<f64> = 0.1..=0.6;

/// Bending up to which the shortening is followed, 1/m: 4 m at the tip of 33 m.
const STRONG_CURVATURE_PER_M: f64 = 0.01;
/// Each gains two digits.
const SHORTENING_PASSES: usize = 4;

impl Beam {
    fn load(&self, eta: f64) -> f64 {
        let elliptic = (1.0 - eta * eta).max(0.0).sqrt();
        let deflection = elliptic + self.triangular * (1.0 - eta - elliptic);
        deflection - if eta < self.reach { self.relief * self.chord(eta) } else { 0.0 }
    }

    fn chord(&self, eta: f64) -> f64 {
        1.0 - (1.0 - self.taper) * eta
    }

    /// Bending moment over stiffness at `count` points from the root to the tip under a load at them, any unit.
    fn curvature_under(&self, count: usize, load: impl Fn(usize) -> f64) -> Vec<f64> {
        let step = 1.0 / (count - 1) as f64;
        let (mut shear, mut moment) = (0.0, 0.0);
        let mut curvature = vec![0.0; count];
        for k in (0..count - 1).rev() {
            let added = 0.5 * step * (load(k) + load(k + 1));
            moment += step * (shear + 0.5 * added);
            shear += added;
            curvature[k] = moment / self.chord(k as f64 * step).powf(self.power);
        }
        curvature
    }

    /// Bending moment over stiffness at `count` points from the root to the tip, any unit.
    fn curvature(&self, count: usize) -> Vec<f64> {
        self.curvature_with(count, |_| 1.0)
    }

    /// The same where an interval of the axis counts in the lever arms by its horizontal share only.
    fn curvature_with(&self, count: usize, horizontal: impl Fn(usize) -> f64) -> Vec<f64> {
        let step = 1.0 / (count - 1) as f64;
        let (mut shear, mut moment) = (0.0, 0.0);
        let mut curvature = vec![0.0; count];
        for k in (0..count - 1).rev() {
            let eta = k as f64 * step;
            let added = step * self.load(eta + 0.5 * step);
            moment += step * horizontal(k) * (shear + 0.5 * added);
            shear += added;
            curvature[k] = moment / self.chord(eta).powf(self.power);
        }
        curvature
    }
}

/// Integrals of m P_k from 0 to eta, per unit of length.
static SHAPES: LazyLock<Vec<Integrals>> = LazyLock::new(shape_integrals);

/// Covariance of c_k / c_0, k = 1.., over the fleet and beyond.
static FLEET_COVARIANCE: LazyLock<SMatrix<f64, RATIOS, RATIOS>> = LazyLock::new(fleet_covariance);

/// Covariance of the ratios c_k / c_0 of `terms` coefficients, from the second on: what is known of a wing's shape
/// beforehand.
pub fn shape_covariance(terms: usize) -> DMatrix<f64> {
    leading(&FLEET_COVARIANCE, terms.saturating_sub(1))
}

fn leading(covariance: &SMatrix<f64, RATIOS, RATIOS>, n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| covariance[(i, j)])
}

/// Covariance of the change of c_k / c_0, k = 1.., while a flight burns its fuel.
static BURNT_COVARIANCE: LazyLock<SMatrix<f64, RATIOS, RATIOS>> = LazyLock::new(burnt_covariance);

/// Covariance of the change of the ratios c_k / c_0 of `terms` coefficients, from the second on, from the heaviest frame
/// of a flight to the lightest: anything between nothing and all the fuel may have been burnt.
pub fn burning_covariance(terms: usize) -> DMatrix<f64> {
    leading(&BURNT_COVARIANCE, terms.saturating_sub(1))
}

/// What of [`shape_covariance`] no load of a beam explains: any smooth shape, such as a swing in the second mode.
pub fn beyond_fleet_covariance(terms: usize) -> DMatrix<f64> {
    leading(&beyond_fleet(1.0), terms.saturating_sub(1))
}

/// Covariance of the coefficients c_k, k = 1.., of a bend that does not go with the load and raises the tip by one length of
/// a wing, times that length: skins of unlike temperature bend a box of even height or one that tapers as the chord does; a
/// loose joint is a kink anywhere inboard. Temperature and joints are taken to be as likely.
pub fn constant_bend_covariance(terms: usize) -> DMatrix<f64> {
    leading(&CONSTANT_COVARIANCE, terms.saturating_sub(1))
}

static CONSTANT_COVARIANCE: LazyLock<SMatrix<f64, RATIOS, RATIOS>> = LazyLock::new(constant_covariance);

fn constant_covariance() -> SMatrix<f64, RATIOS, RATIOS> {
    let fit = Ratios::new();
    let count = fit.basis.len();
    let step = 1.0 / (count - 1) as f64;
    let thermal = [0.0, 1.0].map(|power| -> Vec<f64> {
        (0..count).map(|k| REFERENCE.chord(k as f64 * step).powf(-power)).collect()
    });
    let kink = |at: usize| (0..count).map(|k| f64::from(u8::from(k == at))).collect();
    let kinks: Vec<Vec<f64>> = (0..count).filter(|k| KINKS.contains(&(*k as f64 * step))).map(kink).collect();
    let mut sum = SMatrix::zeros();
    for (shapes, weight) in [(&thermal[..], 0.25), (&kinks, 0.5 / kinks.len() as f64)] {
        for shape in shapes {
            let rise = twice_integrated(step, shape)[count - 1];
            let c = fit.coefficients(shape).fixed_rows::<RATIOS>(1) / rise;
            sum += c * c.transpose() * weight;
        }
    }
    sum
}

/// How far a curvature of each `m P_k` bends the reference beam in its first mode, over what `m` does. A swing in another mode has no
/// part in it: modes are orthogonal over the masses.
static FIRST_MODE: LazyLock<Integrals> = LazyLock::new(first_mode);

/// The same.
pub fn first_mode_shares() -> &'static Integrals {
    &FIRST_MODE
}

fn first_mode() -> Integrals {
    let step = 1.0 / (TABLE - 1) as f64;
    let at = |k: usize| k as f64 * step;
    let mass = |k: usize| REFERENCE.chord(at(k)).powi(MASS_POWER);
    // Stodola's iteration from a parabola: each leaves a fortieth of what is of the second mode, (1.875 / 4.694)^4.
    let mut deflection: Vec<f64> = (0..TABLE).map(|k| at(k).powi(2)).collect();
    for _ in 0..3 {
        let inertia = |k: usize| mass(k) * deflection[k];
        let curvature = REFERENCE.curvature_under(TABLE, inertia);
        deflection = twice_integrated(step, &curvature);
    }
    let values = basis(TABLE);
    let share = |j: usize| -> f64 {
        let of: Vec<f64> = values.iter().map(|all| all[j]).collect();
        twice_integrated(step, &of).iter().enumerate().map(|(k, w)| mass(k) * deflection[k] * w).sum()
    };
    let whole = share(0);
    std::array::from_fn(|j| share(j) / whole)
}

fn twice_integrated(step: f64, curvature: &[f64]) -> Vec<f64> {
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

/// m P_k at `count` points; m has mean 1.
fn basis(count: usize) -> Vec<Integrals> {
    let curvature = REFERENCE.curvature(count);
    let mean = curvature.iter().sum::<f64>() / (count - 1) as f64;
    let at = |k: usize| legendre(2.0 * k as f64 / (count - 1) as f64 - 1.0).map(|p| p * curvature[k] / mean);
    (0..count).map(at).collect()
}

fn shape_integrals() -> Vec<Integrals> {
    let step = 1.0 / (TABLE - 1) as f64;
    let values = basis(TABLE);
    let mut sums = vec![[0.0; MAX_CURVATURE_TERMS]; TABLE];
    for k in 1..TABLE {
        let before = sums[k - 1];
        sums[k] = std::array::from_fn(|j| before[j] + 0.5 * step * (values[k - 1][j] + values[k][j]));
    }
    sums
}

/// Beams all over the fleet, each fitted with the basis.
fn fleet_covariance() -> SMatrix<f64, RATIOS, RATIOS> {
    let ratios = Ratios::new();
    let beams = fleet();
    let squares = beams.iter().map(|beam| ratios.of(beam)).map(|r| r * r.transpose() / beams.len() as f64);
    squares.fold(beyond_fleet(1.0), |sum, square| sum + square)
}

/// The same beams with their fuel against without; a flight burns any share of it.
fn burnt_covariance() -> SMatrix<f64, RATIOS, RATIOS> {
    let ratios = Ratios::new();
    let beams = fleet();
    let change = |beam: &Beam| ratios.of(beam) - ratios.of(&Beam { relief: 0.0, ..*beam });
    let squares = beams.iter().map(change).map(|r| r * r.transpose() * (BURNT / beams.len() as f64));
    squares.fold(beyond_fleet(BEYOND_BURNING), |sum, square| sum + square)
}

fn beyond_fleet(share: f64) -> SMatrix<f64, RATIOS, RATIOS> {
    SMatrix::from_diagonal(&SVector::from(BEYOND_FLEET).map(|s| (s * share).powi(2)))
}

/// Fits curvatures with the basis.
struct Ratios {
    basis: Vec<SVector<f64, MAX_CURVATURE_TERMS>>,
    inverse: SMatrix<f64, MAX_CURVATURE_TERMS, MAX_CURVATURE_TERMS>,
}

impl Ratios {
    fn new() -> Self {
        let basis: Vec<_> = basis(TABLE / STRIDE + 1).into_iter().map(SVector::from).collect();
        let normal: SMatrix<f64, MAX_CURVATURE_TERMS, MAX_CURVATURE_TERMS> =
            basis.iter().fold(SMatrix::zeros(), |sum, b| sum + b * b.transpose());
        Self { basis, inverse: normal.try_inverse().unwrap_or_else(SMatrix::zeros) }
    }

    fn of(&self, beam: &Beam) -> SVector<f64, RATIOS> {
        let c = self.coefficients(&beam.curvature(self.basis.len()));
        c.fixed_rows::<RATIOS>(1) / c[0]
    }

    fn coefficients(&self, curvature: &[f64]) -> SVector<f64, MAX_CURVATURE_TERMS> {
        let right = self.basis.iter().zip(curvature).fold(SVector::zeros(), |sum, (b, k)| sum + b * *k);
        self.inverse * right
    }
}

/// Half the second derivatives of the ratios c_k / c_0 by the amplitude c_0, m^2, where the load stays
/// vertical while the beam turns: its lever arms shorten. Of the reference beam on an unbent axis of this
/// length with these slopes (over s/L).
pub fn shortening(length_m: f64, slope_rad: impl Fn(f64) -> f64) -> [f64; RATIOS] {
    let fit = Ratios::new();
    let at = |share: f64| shortened_ratios(&fit, length_m, &slope_rad, share * STRONG_CURVATURE_PER_M);
    let bend = at(0.0) - at(0.5) * 2.0 + at(1.0);
    (bend * (2.0 / STRONG_CURVATURE_PER_M.powi(2))).into()
}

/// Ratios of a vertically loaded reference beam that is bent to an amplitude.
fn shortened_ratios(
    fit: &Ratios,
    length_m: f64,
    slope_rad: impl Fn(f64) -> f64,
    amplitude: f64,
) -> SVector<f64, RATIOS> {
    let count = fit.basis.len();
    let step = 1.0 / (count - 1) as f64;
    let mut bent = vec![0.0; count];
    let mut ratios = SVector::zeros();
    for _ in 0..SHORTENING_PASSES {
        let curvature = REFERENCE.curvature_with(count, |k| (slope_rad(k as f64 * step) + bent[k]).cos());
        let c = fit.coefficients(&curvature);
        ratios = c.fixed_rows::<RATIOS>(1) / c[0];
        let scale = amplitude * length_m * step / c[0];
        for k in 1..count {
            bent[k] = bent[k - 1] + 0.5 * scale * (curvature[k - 1] + curvature[k]);
        }
    }
    ratios
}

fn fleet() -> Vec<Beam> {
    let [low, high] = FLEET;
    // Three points with nearly the spread of a uniform law.
    let between = |a: f64, b: f64, k: usize| a + (b - a) * [0.11, 0.5, 0.89][k % 3];
    let beam = |k: usize| Beam {
        taper: between(low.taper, high.taper, k),
        power: between(low.power, high.power, k / 3),
        triangular: between(low.triangular, high.triangular, k / 9),
        relief: between(low.relief, high.relief, k / 27),
        reach: between(low.reach, high.reach, k / 81),
    };
    (0..243).map(beam).collect()
}

/// Values of m P_k from 0 to 1.
static VALUES: LazyLock<Vec<Integrals>> = LazyLock::new(|| basis(TABLE));

/// m P_k at `eta`: the curvature is their sum with the coefficients.
pub fn curvature_basis(eta: f64) -> [f64; MAX_CURVATURE_TERMS] {
    interpolated(&VALUES, eta)
}

/// Integrals of m P_k from the root to `eta`, per unit of length.
pub fn shapes_at(eta: f64) -> Integrals {
    interpolated(&SHAPES, eta)
}

fn interpolated(table: &[Integrals], eta: f64) -> Integrals {
    let at = eta.clamp(0.0, 1.0) * (TABLE - 1) as f64;
    let k = (at as usize).min(TABLE - 2);
    let t = at - k as f64;
    std::array::from_fn(|j| table[k][j] + t * (table[k + 1][j] - table[k][j]))
}

/// Legendre's polynomials of degree 0 to N - 1.
pub fn legendre<const N: usize>(x: f64) -> [f64; N] {
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
