//! Formatting of numbers for people, rounded according to their standard deviation; missing numbers are shown as such.

/// Text of a missing number.
pub const NONE: &str = "-";

/// Returns the number of decimals that shows two significant digits of `sigma`, 0 to 12.
pub fn decimals_for(sigma: f64) -> usize {
    if !sigma.is_finite() || sigma <= 0.0 {
        return 3;
    }
    // 0.00996 rounds to 0.010, so the exponent is that of the rounded value.
    let exponent = (sigma * 0.995_f64.recip()).log10().floor();
    (1.0 - exponent).clamp(0.0, 12.0) as usize
}

/// Formats a value with `decimals`; [`NONE`] if it is missing or not finite.
pub fn format_fixed(value: Option<f64>, decimals: usize) -> String {
    match value.filter(|v| v.is_finite()) {
        Some(v) => without_negative_zero(format!("{v:.decimals$}")),
        None => NONE.to_owned(),
    }
}

/// Formats a value and its standard deviation, both rounded to two significant digits of the latter. A value without
/// standard deviation gets `fallback` decimals.
pub fn format_rounded(value: Option<f64>, sigma: Option<f64>, fallback: usize) -> (String, String) {
    match sigma.filter(|s| s.is_finite() && *s > 0.0) {
        Some(s) => {
            let n = decimals_for(s);
            (format_fixed(value, n), format_fixed(Some(s), n))
        }
        None => (format_fixed(value, fallback), NONE.to_owned()),
    }
}

/// Formats a value with its standard deviation, if it has one, as [`format_rounded`] does: `2.9346 ± 0.0061`.
pub fn format_measured(value: Option<f64>, sigma: Option<f64>, fallback: usize) -> String {
    match format_rounded(value, sigma, fallback) {
        (value, sigma) if sigma == NONE => value,
        (value, sigma) => format!("{value} ± {sigma}"),
    }
}

/// Formats a count with its noun: 1 marker, 2 markers, 1 series, 2 series.
pub fn count_text(number: usize, noun: &str) -> String {
    let plural = if number == 1 || noun.ends_with("series") {
        ""
    } else {
        "s"
    };
    format!("{number} {noun}{plural}")
}

fn without_negative_zero(text: String) -> String {
    let zero = text.starts_with('-') && text.chars().all(|c| matches!(c, '-' | '0' | '.'));
    if zero {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_digits_of_sigma_decide() {
        let pair = |v, s| format_rounded(Some(v), Some(s), 3);
        assert_eq!(pair(2.93456, 0.0061), ("2.9346".into(), "0.0061".into()));
        assert_eq!(pair(2.93456, 0.014), ("2.935".into(), "0.014".into()));
        assert_eq!(pair(2.93456, 0.0999), ("2.93".into(), "0.10".into()));
        assert_eq!(pair(123.4, 31.0), ("123".into(), "31".into()));
        assert_eq!(pair(-0.0001, 0.02), ("0.000".into(), "0.020".into()));
    }

    #[test]
    fn missing_numbers_are_dashes() {
        assert_eq!(format_rounded(None, None, 2), ("-".into(), "-".into()));
        assert_eq!(format_rounded(Some(f64::NAN), Some(0.1), 2).0, "-");
        assert_eq!(
            format_rounded(Some(1.0), Some(f64::INFINITY), 2),
            ("1.00".into(), "-".into())
        );
    }
}
