//! Blurred fraction of black between the two crossing edges of opposite quadrants, for a batch of pixels.

use super::parameters::{BEND, BLUR, BlackFraction, MarkerParameters, TANGENT, UNEVEN_BLUR};
use crate::detect::appearance::disc::END_SIGMAS;
use crate::detect::simd::functions::{GAUSS_8, PEAK, gauss_kernel, normal_distributions};
use crate::detect::simd::lanes::{LANES, Lanes, all_lanes, each};

/// Distance from the crossing, standard deviations of blur, beyond which its two edges do not interact.
pub const NEAR_SIGMAS: f64 = 3.6;

/// Parameters of the edges in single precision.
#[derive(Clone, Copy)]
struct EdgeParameters {
    f: f32,
    k1: f32,
    k2: f32,
    sigma: f32,
    by_sigma: f32,
    /// Reciprocals of each edge's blur relative to the mean blur.
    by_own: [f32; 2],
}

/// Fraction and derivatives at one position, in the order of [`BlackFraction`].
type FractionAtPoint = [f32; 8];

/// Computes the blurred fraction between two crossing edges `t = +-f s + k s^2`, `f <= 1`, around the s axis; motion blurs
/// one of them more than the other.
#[inline(always)]
pub fn wedge_fraction(s: &Lanes, t: &Lanes, m: &MarkerParameters) -> BlackFraction {
    let sigma = m[BLUR] as f32;
    let (uneven, by_sigma) = (m[UNEVEN_BLUR] as f32, 1.0 / sigma);
    let by_own = [1.0 / (1.0 + uneven), 1.0 / (1.0 - uneven)];
    let e = EdgeParameters {
        f: m[TANGENT] as f32,
        k1: m[BEND] as f32,
        k2: m[BEND + 1] as f32,
        sigma,
        by_sigma,
        by_own,
    };
    let far = each(|i| {
        if s[i].abs() > NEAR_SIGMAS as f32 * e.sigma {
            1.0
        } else {
            0.0
        }
    });
    let mut apart = BlackFraction::default();
    for i in 0..LANES {
        let one = edge_pair_fraction::<true>(s[i], t[i], e);
        for (lanes, value) in apart.lanes_mut().into_iter().zip(one) {
            lanes[i] = value;
        }
    }
    if all_lanes(|i| far[i] > 0.0) {
        return apart;
    }
    let mut fraction = BlackFraction::default();
    sum_near_crossing(s, t, e, &mut fraction);
    for (lanes, apart) in fraction.lanes_mut().into_iter().zip(apart.lanes_mut()) {
        *lanes = each(|i| if far[i] > 0.0 { apart[i] } else { lanes[i] });
    }
    fraction
}

impl BlackFraction {
    /// Returns the fields in the order of [`FractionAtPoint`].
    #[inline(always)]
    fn lanes_mut(&mut self) -> [&mut Lanes; 8] {
        let Self {
            c,
            s,
            t,
            first,
            second,
            third,
            blur,
            taper,
        } = self;
        [c, s, t, first, second, third, blur, taper]
    }
}

/// Computes the fraction near the crossing: summed along s on both sides of it, in closed form across.
#[inline(always)]
fn sum_near_crossing(s: &Lanes, t: &Lanes, e: EdgeParameters, fraction: &mut BlackFraction) {
    let reach = END_SIGMAS as f32 * e.sigma;
    for before in [true, false] {
        for (node, weight) in GAUSS_8 {
            for i in 0..LANES {
                let low = if s[i] - reach < 0.0 {
                    s[i] - reach
                } else {
                    0.0
                };
                let high = if s[i] + reach > 0.0 {
                    s[i] + reach
                } else {
                    0.0
                };
                let half = 0.5 * if before { -low } else { high };
                let at = if before {
                    half * (node - 1.0)
                } else {
                    half * (node + 1.0)
                };
                let along = (s[i] - at) * e.by_sigma;
                let w = half * weight * PEAK * gauss_kernel(along) * e.by_sigma;
                let [c, _, across, first, second, third, blur, uneven] =
                    edge_pair_fraction::<false>(at, t[i], e);
                fraction.c[i] += w * c;
                fraction.s[i] -= w * c * along * e.by_sigma;
                fraction.t[i] += w * across;
                fraction.first[i] += w * first;
                fraction.second[i] += w * second;
                fraction.third[i] += w * third;
                fraction.blur[i] += w * (c * (along * along - 1.0) * e.by_sigma + blur);
                fraction.taper[i] += w * uneven;
            }
        }
    }
}

/// Computes the fraction between the edges at `s`, blurred along both directions (`TILTED`) or across only.
#[inline(always)]
fn edge_pair_fraction<const TILTED: bool>(
    s: f32,
    t: f32,
    EdgeParameters {
        f,
        k1,
        k2,
        by_sigma,
        by_own,
        ..
    }: EdgeParameters,
) -> FractionAtPoint {
    let (slope1, slope2) = (f + 2.0 * k1 * s, -f + 2.0 * k2 * s);
    let (steep1, steep2) = (1.0 + slope1 * slope1, 1.0 + slope2 * slope2);
    // The blur across a tilted edge depends on its slope.
    let (tilt1, tilt2) = if TILTED {
        let (root1, root2) = (steep1.sqrt(), steep2.sqrt());
        let by_both = 1.0 / (root1 * root2);
        (root2 * by_both, root1 * by_both)
    } else {
        (1.0, 1.0)
    };
    let (by_width1, by_width2) = (by_sigma * tilt1 * by_own[0], by_sigma * tilt2 * by_own[1]);
    let z1 = (t - f * s - k1 * s * s) * by_width1;
    let z2 = (t + f * s - k2 * s * s) * by_width2;
    let [(d1, c1), (d2, c2)] = normal_distributions([z1, z2]);
    let side = if s >= 0.0 { 1.0 } else { -1.0 };
    let (e1, e2) = (side * d1 * by_width1, side * d2 * by_width2);
    let turn1 = if TILTED {
        side * d1 * z1 * slope1 * tilt1 * tilt1
    } else {
        0.0
    };
    let turn2 = if TILTED {
        side * d2 * z2 * slope2 * tilt2 * tilt2
    } else {
        0.0
    };
    [
        side * (c2 - c1),
        e1 * slope1 - e2 * slope2,
        e2 - e1,
        (e1 + e2) * s + turn1 + turn2,
        e1 * s * s + 2.0 * turn1 * s,
        -e2 * s * s - 2.0 * turn2 * s,
        side * (z1 * d1 - z2 * d2) * by_sigma,
        side * (z1 * d1 * by_own[0] + z2 * d2 * by_own[1]),
    ]
}
