//! Parabola y = a x^2 and its arc length (paper, equations 3 to 5), regular at a = 0.

/// Slope t = 2 a x below which the series is used; the first omitted term is below 1e-15 there.
const SERIES_LIMIT: f64 = 0.1;

/// Arc length from the vertex to x, with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArcLength {
    pub length_m: f64,
    /// d length / d x.
    pub by_x: f64,
    /// d length / d a, m^2.
    pub by_a: f64,
}

/// Arc length of y = a x^2 from 0 to x, `l = x g(t)`, `t = 2 a x`.
///
/// The paper multiplies its condition by 4 a (equation 6), which makes it 0 = 0 at a = 0. The length itself is analytic
/// there: `g = (sqrt(1 + t^2) + asinh(t) / t) / 2 = 1 + t^2/6 - ...`.
pub fn arc_length(x_m: f64, a_per_m: f64) -> ArcLength {
    let t = 2.0 * a_per_m * x_m;
    let (g, slope) = if t.abs() < SERIES_LIMIT {
        series_expansion(t)
    } else {
        closed_form(t)
    };
    ArcLength {
        length_m: x_m * g,
        by_x: t.hypot(1.0),
        by_a: 2.0 * x_m * x_m * slope,
    }
}

/// Computes x at an arc length, m: the inverse of [`arc_length`], by Newton's iteration from above (the arc length is
/// convex in x).
pub fn span_from_length(length_m: f64, a_per_m: f64) -> f64 {
    let mut x = length_m;
    for _ in 0..20 {
        let arc = arc_length(x, a_per_m);
        let step = (arc.length_m - length_m) / arc.by_x;
        x -= step;
        if step.abs() < 1e-13 * (1.0 + length_m.abs()) {
            break;
        }
    }
    x
}

/// Values of g and dg/dt near 0: the binomial series of sqrt(1 + t^2), integrated term by term.
fn series_expansion(t: f64) -> (f64, f64) {
    const COEFFICIENTS: [f64; 6] = [
        1.0 / 6.0,
        -1.0 / 40.0,
        1.0 / 112.0,
        -5.0 / 1152.0,
        7.0 / 2816.0,
        -21.0 / 13312.0,
    ];
    let w = t * t;
    let value = COEFFICIENTS.iter().rev().fold(0.0, |sum, c| (sum + c) * w);
    let slope = COEFFICIENTS
        .iter()
        .enumerate()
        .rev()
        .fold(0.0, |sum, (k, c)| sum * w + 2.0 * (k as f64 + 1.0) * c);
    (1.0 + value, slope * t)
}

/// Returns the ratio g of arc length to x, and dg/dt, in closed form.
fn closed_form(t: f64) -> (f64, f64) {
    let root = t.hypot(1.0);
    let mean = t.asinh() / t;
    (0.5 * (root + mean), 0.5 * (root - mean) / t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_dual::{DualNum, HyperDual64};
    use proptest::prelude::*;

    #[test]
    fn series_and_closed_form_meet() {
        for t in [0.03, 0.06, SERIES_LIMIT, -SERIES_LIMIT] {
            let ((g, slope), (g2, slope2)) = (series_expansion(t), closed_form(t));
            assert!((g - g2).abs() < 4e-15, "{t}: {g} {g2}");
            assert!((slope - slope2).abs() < 2e-14, "{t}: {slope} {slope2}");
        }
    }

    #[test]
    fn unbent_wing_is_regular() {
        let flat = arc_length(30.0, 0.0);
        assert_eq!(
            flat,
            ArcLength {
                length_m: 30.0,
                by_x: 1.0,
                by_a: 0.0
            }
        );
        // The second derivative by a carries the information about a there: 4 x^3 / 3.
        let near = arc_length(30.0, 1e-6);
        assert!((near.by_a / 1e-6 / (4.0 * 30f64.powi(3) / 3.0) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_length_is_the_integral() {
        for a in [0.00218957, -0.0006, 0.01] {
            let n = 20_000;
            let h = 35.0 / f64::from(n);
            let sum: f64 = (0..n)
                .map(|k| (2.0 * a * (f64::from(k) + 0.5) * h).hypot(1.0) * h)
                .sum();
            assert!((sum - arc_length(35.0, a).length_m).abs() < 1e-7);
        }
    }

    proptest! {
        #[test]
        fn derivatives_match_dual_numbers(x in 0.5..40.0f64, a in prop_oneof![-0.02..-1e-4f64, 1e-4..0.02f64]) {
            let xd = HyperDual64::new(x, 1.0, 0.0, 0.0);
            let ad = HyperDual64::new(a, 0.0, 1.0, 0.0);
            let t = xd * ad * 2.0;
            let length = xd * (t * t + 1.0).sqrt() * 0.5 + t.asinh() / (ad * 4.0);
            let ours = arc_length(x, a);
            prop_assert!((ours.length_m - length.re).abs() < 1e-10);
            prop_assert!((ours.by_x - length.eps1).abs() < 1e-8);
            prop_assert!((ours.by_a - length.eps2).abs() < 1e-4 * (1.0 + length.eps2.abs()));
        }

        #[test]
        fn the_span_returns_the_length(length in 0.0..60.0f64, a in -0.05..0.05f64) {
            prop_assert!((arc_length(span_from_length(length, a), a).length_m - length).abs() < 1e-12 * (1.0 + length));
        }

        #[test]
        fn length_is_even_in_a(x in 0.5..40.0f64, a in 0.0..0.02f64) {
            prop_assert_eq!(arc_length(x, a).length_m, arc_length(x, -a).length_m);
        }
    }
}
