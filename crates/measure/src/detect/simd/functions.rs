//! Elementary functions in single precision, without branches, so that loops over lanes run in vector registers; and
//! Gauss-Legendre nodes.

/// Evaluates a polynomial in `x`, its highest coefficient first. Multiplication and addition are fused on every processor.
#[inline(always)]
fn evaluate_polynomial<const K: usize>(x: f32, coefficients: [f32; K]) -> f32 {
    coefficients
        .into_iter()
        .skip(1)
        .fold(coefficients[0], |sum, c| sum.mul_add(x, c))
}

/// Computes e to the power `x`, relative error below 6e-6 up to 30; `x` is limited to -80 to 80.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let x = if x < 80.0 { x } else { 80.0 };
    power_of_two(x * std::f32::consts::LOG2_E)
}

/// Computes 2 to the power `x`, relative error below 3e-6, which is 0.001 grey levels; `x` is limited to at least -115.
#[inline(always)]
fn power_of_two(x: f32) -> f32 {
    /// Number whose addition, 1.5 times 2^23, leaves the nearest whole number in the last bits.
    const ROUNDING_SHIFT: f32 = 12_582_912.0;
    let x = if x > -115.0 { x } else { -115.0 };
    let shifted = x + ROUNDING_SHIFT;
    let rest = x - (shifted - ROUNDING_SHIFT);
    let p = evaluate_polynomial(
        rest,
        [
            9.570_101e-3,
            5.591_786e-2,
            2.402_474_5e-1,
            6.931_218e-1,
            9.999_993e-1,
        ],
    );
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// Computes the natural logarithm of a positive, normal `x`; absolute error below 2e-6, 0 at 1.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    /// Bits of sqrt(1/2): the mantissa is brought between that and sqrt(2).
    const ROOT_HALF: i32 = 0x3f35_04f3;
    let bits = x.to_bits() as i32;
    let power = bits.wrapping_sub(ROOT_HALF) >> 23;
    let r = f32::from_bits(bits.wrapping_sub(power << 23) as u32) - 1.0;
    let p = evaluate_polynomial(
        r,
        [
            -1.432_078e-1,
            2.232_924_7e-1,
            -2.547_203e-1,
            3.322_599e-1,
            -4.998_508e-1,
            1.000_012_7,
        ],
    );
    (power as f32).mul_add(std::f32::consts::LN_2, p * r)
}

/// Computes the sine of an angle between -pi/2 and pi/2, rad.
#[inline(always)]
pub fn sin_quarter(x: f32) -> f32 {
    let y = x * x;
    let p = evaluate_polynomial(
        y,
        [
            -2.505_210_8e-8,
            2.755_731_9e-6,
            -1.984_127e-4,
            8.333_333e-3,
            -1.666_666_7e-1,
        ],
    );
    (x * y).mul_add(p, x)
}

/// Computes the inverse sine, rad; `x` is limited to -1 to 1.
#[inline(always)]
pub fn asin(x: f32) -> f32 {
    let size = if x.abs() < 1.0 { x.abs() } else { 1.0 };
    let large = size > 0.5;
    let square = if large {
        0.5 * (1.0 - size)
    } else {
        size * size
    };
    let base = if large { square.sqrt() } else { size };
    let p = evaluate_polynomial(
        square,
        [
            4.216_32e-2,
            2.418_131e-2,
            4.547_002_6e-2,
            7.495_303e-2,
            1.666_675_2e-1,
        ],
    );
    let angle = (base * square).mul_add(p, base);
    let angle = if large {
        std::f32::consts::FRAC_PI_2 - 2.0 * angle
    } else {
        angle
    };
    angle.copysign(x)
}

/// Density of the standard normal distribution at 0.
pub const PEAK: f32 = 0.398_942_3;

/// Computes density and cumulative probability of the standard normal distribution; the latter by Abramowitz and Stegun
/// 26.2.16, error below 1.2e-5.
#[inline(always)]
pub fn normal_distribution(z: f32) -> (f32, f32) {
    normal_density_and_distribution(z, 1.0 / NORMAL_TAIL_P.mul_add(z.abs(), 1.0))
}

/// Computes density and cumulative probability of the standard normal distribution at two values, with one division.
#[inline(always)]
pub fn normal_distributions(z: [f32; 2]) -> [(f32, f32); 2] {
    let [one, other] = z.map(|z| NORMAL_TAIL_P.mul_add(z.abs(), 1.0));
    let by_both = 1.0 / (one * other);
    [
        normal_density_and_distribution(z[0], by_both * other),
        normal_density_and_distribution(z[1], by_both * one),
    ]
}

/// Constant p of Abramowitz and Stegun 26.2.16.
const NORMAL_TAIL_P: f32 = 0.332_67;

/// Computes exp(-z^2 / 2).
#[inline(always)]
pub fn gauss_kernel(z: f32) -> f32 {
    power_of_two(z * z * (-0.5 * std::f32::consts::LOG2_E))
}

#[inline(always)]
fn normal_density_and_distribution(z: f32, k: f32) -> (f32, f32) {
    let density = PEAK * gauss_kernel(z);
    let p = evaluate_polynomial(k, [0.937_298, -0.120_167_6, 0.436_183_6]);
    let tail = density * p * k;
    (density, if z > 0.0 { 1.0 - tail } else { tail })
}

/// Nodes and weights of the 12-point Gauss-Legendre rule on [-1, 1].
pub const GAUSS_12: [(f32, f32); 12] = [
    (-0.981_560_63, 0.047_175_336),
    (-0.904_117_3, 0.106_939_33),
    (-0.769_902_7, 0.160_078_33),
    (-0.587_317_94, 0.203_167_43),
    (-0.367_831_5, 0.233_492_54),
    (-0.125_233_41, 0.249_147_05),
    (0.125_233_41, 0.249_147_05),
    (0.367_831_5, 0.233_492_54),
    (0.587_317_94, 0.203_167_43),
    (0.769_902_7, 0.160_078_33),
    (0.904_117_3, 0.106_939_33),
    (0.981_560_63, 0.047_175_336),
];
/// Nodes and weights of the 8-point Gauss-Legendre rule on [-1, 1].
pub const GAUSS_8: [(f32, f32); 8] = [
    (-0.960_289_86, 0.101_228_54),
    (-0.796_666_5, 0.222_381_03),
    (-0.525_532_4, 0.313_706_65),
    (-0.183_434_64, 0.362_683_8),
    (0.183_434_64, 0.362_683_8),
    (0.525_532_4, 0.313_706_65),
    (0.796_666_5, 0.222_381_03),
    (0.960_289_86, 0.101_228_54),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_match_the_library() {
        for k in -3000..=3000 {
            let x = k as f32 * 0.01;
            let wide = f64::from(x);
            assert!(
                (f64::from(exp(x)) / wide.exp() - 1.0).abs() < 6e-6,
                "exp {x}"
            );
            let y = (wide * 0.2).exp() as f32;
            assert!(
                (f64::from(ln(y)) - f64::from(y).ln()).abs() < 2e-6,
                "ln {y}"
            );
            let z = (wide / 30.0).clamp(-1.0, 1.0);
            assert!(
                (f64::from(asin(z as f32)) - z.asin()).abs() < 1e-6,
                "asin {z}"
            );
            let quarter = z * std::f64::consts::FRAC_PI_2;
            assert!(
                (f64::from(sin_quarter(quarter as f32)) - quarter.sin()).abs() < 1e-6,
                "sin {quarter}"
            );
        }
        assert_eq!(exp(-1e9), exp(-80.0));
        assert!(
            (normal_distribution(1.0).1 - 0.841_344_7).abs() < 1.2e-5
                && (normal_distribution(-1.0).1 - 0.158_655_3).abs() < 1.2e-5
        );
        assert!(
            (normal_distribution(9.0).1 - 1.0).abs() < 1e-7 && normal_distribution(-9.0).1 < 1e-7
        );
    }

    #[test]
    fn the_nodes_integrate_polynomials() {
        let integral = |rule: &[(f32, f32)], power: i32| {
            rule.iter().map(|(x, w)| w * x.powi(power)).sum::<f32>()
        };
        for power in [0, 2, 8, 14] {
            let exact = 2.0 / (power + 1) as f32;
            assert!((integral(&GAUSS_8, power) - exact).abs() < 1e-5);
            assert!((integral(&GAUSS_12, power) - exact).abs() < 1e-5);
        }
    }
}
