//! The blurred share of black of two opposite quadrants, for a batch of pixels.

use super::parameters::{BEND, BLUR, MarkerParameters, BlackFraction, TANGENT, UNEVEN_BLUR};
use crate::detect::simd::functions::{GAUSS_8, PEAK, gauss, normals};
use crate::detect::simd::lanes::{LANES, Lanes, all, each};

/// Standard deviations of blur from the crossing beyond which its two edges are apart.
pub const NEAR_SIGMAS: f64 = 3.6;
/// Standard deviations of blur that a sum along s reaches to both sides: beyond, 0.003 % is left.
const REACH_SIGMAS: f32 = 4.2;

/// The edges' parameters in single precision.
#[derive(Clone, Copy)]
struct EdgeParameters {
    f: f32,
    k1: f32,
    k2: f32,
    sigma: f32,
    by_sigma: f32,
    /// One over the blur of each edge over that of both.
    by_own: [f32; 2],
}

/// Share and derivatives at one place: as [`Share`] has them.
type FractionAtPoint = [f32; 8];

/// The blurred share between two crossing edges `t = +-f s + k s^2`, `f <= 1`, around the s axis; motion blurs one of them
/// more than the other.
#[inline(always)]
pub fn wedge_fraction(s: &Lanes, t: &Lanes, m: &MarkerParameters) -> BlackFraction {
    let sigma = m[BLUR] as f32;
    let (uneven, by_sigma) = (m[UNEVEN_BLUR] as f32, 1.0 / sigma);
    let by_own = [1.0 / (1.0 + uneven), 1.0 / (1.0 - uneven)];
    let e =
        EdgeParameters { f: m[TANGENT] as f32, k1: m[BEND] as f32, k2: m[BEND + 1] as f32, sigma, by_sigma, by_own };
    let far = each(|i| if s[i].abs() > NEAR_SIGMAS as f32 * e.sigma { 1.0 } else { 0.0 });
    let mut apart = BlackFraction::default();
    for i in 0..LANES {
        let one = edge_pair_fraction::<true>(s[i], t[i], e);
        for (lanes, value) in apart.lanes_mut().into_iter().zip(one) {
            lanes[i] = value;
        }
    }
    if all(|i| far[i] > 0.0) {
        return apart;
    }
    let mut share = BlackFraction::default();
    sum_near_crossing(s, t, e, &mut share);
    for (lanes, apart) in share.lanes_mut().into_iter().zip(apart.lanes_mut()) {
        *lanes = each(|i| if far[i] > 0.0 { apart[i] } else { lanes[i] });
    }
    share
}

impl BlackFraction {
    /// In the order of [`One`].
    #[inline(always)]
    fn lanes_mut(&mut self) -> [&mut Lanes; 8] {
        let Self { c, s, t, first, second, third, blur, taper } = self;
        [c, s, t, first, second, third, blur, taper]
    }
}

/// Near the crossing: summed along s on both sides of it, in closed form across.
#[inline(always)]
fn sum_near_crossing(s: &Lanes, t: &Lanes, e: EdgeParameters, share: &mut BlackFraction) {
    let reach = REACH_SIGMAS * e.sigma;
    for before in [true, false] {
        for (node, weight) in GAUSS_8 {
            for i in 0..LANES {
                let low = if s[i] - reach < 0.0 { s[i] - reach } else { 0.0 };
                let high = if s[i] + reach > 0.0 { s[i] + reach } else { 0.0 };
                let half = 0.5 * if before { -low } else { high };
                let at = if before { half * (node - 1.0) } else { half * (node + 1.0) };
                let along = (s[i] - at) * e.by_sigma;
                let w = half * weight * PEAK * gauss(along) * e.by_sigma;
                let [c, _, across, first, second, third, blur, uneven] = edge_pair_fraction::<false>(at, t[i], e);
                share.c[i] += w * c;
                share.s[i] -= w * c * along * e.by_sigma;
                share.t[i] += w * across;
                share.first[i] += w * first;
                share.second[i] += w * second;
                share.third[i] += w * third;
                share.blur[i] += w * (c * (along * along - 1.0) * e.by_sigma + blur);
                share.taper[i] += w * uneven;
            }
        }
    }
}

/// Between the edges at `s`, blurred along both directions (`TILTED`) or across only.
#[inline(always)]
fn edge_pair_fraction<const TILTED: bool>(s: f32, t: f32, EdgeParameters { f, k1, k2, by_sigma, by_own, .. }: EdgeParameters) -> FractionAtPoint {
    let (slope1, slope2) = (f + 2.0 * k1 * s, -f + 2.0 * k2 * s);
    let (steep1, steep2) = (1.0 + slope1 * slope1, 1.0 + slope2 * slope2);
    // The blur across a tilted edge changes with its slope.
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
    let [(d1, c1), (d2, c2)] = normals([z1, z2]);
    let side = if s >= 0.0 { 1.0 } else { -1.0 };
    let (e1, e2) = (side * d1 * by_width1, side * d2 * by_width2);
    let turn1 = if TILTED { side * d1 * z1 * slope1 * tilt1 * tilt1 } else { 0.0 };
    let turn2 = if TILTED { side * d2 * z2 * slope2 * tilt2 * tilt2 } else { 0.0 };
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
