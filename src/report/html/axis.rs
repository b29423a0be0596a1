//! Axes with round ticks, for lengths and angles and for the time of day.

use super::super::number::format_fixed;

/// Linear axis with round ticks.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    low: f64,
    high: f64,
    step: f64,
    label: String,
    /// The tick texts have the opposite sign.
    turned: bool,
    /// The values are hours since this time, the tick texts times of day.
    clock: Option<jiff::Timestamp>,
    /// Smallest of the values; `high_value` is the largest.
    low_value: f64,
    high_value: f64,
}

/// Label of a time axis if no time is known.
pub const UNDATED_LABEL: &str = "number of the series, with its frames in order";

impl Axis {
    /// Covers all finite values; 0 to 1 if there are none.
    pub fn from_values(values: impl Iterator<Item = f64>, label: &str) -> Self {
        let range = values.filter(|v| v.is_finite()).fold(None, |range, v| {
            let (low, high): (f64, f64) = range.unwrap_or((v, v));
            Some((low.min(v), high.max(v)))
        });
        let (low_value, high_value) = range.unwrap_or((0.0, 1.0));
        let (low, high) = (low_value, high_value);
        let width = if high - low > 1e-9 * (1.0 + high.abs()) { high - low } else { 1.0 };
        let step = round_step(width / 6.0);
        // A band that exceeds a tick by less than 4 % of the step adds no interval.
        let (low, high) = ((low / step + 0.04).floor() * step, (high / step - 0.04).ceil() * step);
        let high = if high > low { high } else { low + step };
        Self { low, high, step, label: label.to_owned(), turned: false, clock: None, low_value, high_value }
    }

    /// Covers `low` to `high`, extended to the next ticks.
    pub fn from_range(low: f64, high: f64, step: f64, label: &str) -> Self {
        let (low, high) = ((low / step).floor() * step, (high / step).ceil() * step);
        Self {
            low,
            high: if high > low { high } else { low + step },
            step,
            label: label.to_owned(),
            turned: false,
            clock: None,
            low_value: low,
            high_value: high,
        }
    }

    /// Covers exactly `low` to `high`, with ticks at the multiples of a step, for the sides of an image.
    #[cfg(any(test, feature = "boards"))]
    pub fn from_exact_range(low: f64, high: f64, step: f64, label: &str) -> Self {
        Self { low, high: if high > low { high } else { low + step }, ..Self::from_range(low, high, step, label) }
    }

    /// Covers hours since `zero`, with times of day (UTC) at the ticks.
    pub fn from_hours(hours: impl Iterator<Item = f64>, zero: Option<jiff::Timestamp>) -> Self {
        let Some(zero) = zero else { return Self::from_values(hours, UNDATED_LABEL) };
        let label = format!("UTC, from {}", zero.strftime("%Y-%m-%d %H:%M"));
        let axis = Self::from_values(hours, &label);
        let wide = axis.length();
        let step = clock_step(3600.0 * wide / 7.0) / 3600.0;
        // Both ends are at round times of day.
        let begin = zero.as_second() as f64 / 3600.0;
        let (low, high) = (axis.low_value, axis.high_value);
        let low = ((begin + low) / step + 0.04).floor() * step - begin;
        let high = ((begin + high) / step - 0.04).ceil() * step - begin;
        Self { clock: Some(zero), low, high: if high > low { high } else { low + step }, step, ..axis }
    }

    /// Returns the axis for values with the opposite sign: the displayed values increase downwards or to the left.
    pub fn reversed(self) -> Self {
        Self { low: -self.high, high: -self.low, turned: !self.turned, ..self }
    }

    /// Returns the length in the unit of the data.
    pub fn length(&self) -> f64 {
        self.high - self.low
    }

    /// Returns the lower end.
    pub fn low(&self) -> f64 {
        self.low
    }

    /// Returns the label, with the unit.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Returns the position of a value on the axis: 0 at its lower end, 1 at its upper end.
    pub fn fraction(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    #[cfg(test)]
    fn range(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Returns the positions of the ticks and their texts.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        // A time axis begins at a round time of day, which is not a multiple of the step since `clock`.
        let first = if self.clock.is_some() { self.low } else { (self.low / self.step - 1e-6).ceil() * self.step };
        let n = ((self.high - first) / self.step + 1e-6).floor() as usize;
        let decimals = (-self.step.log10().floor()).clamp(0.0, 9.0) as usize;
        let tick = |i: usize| first + i as f64 * self.step;
        let sign = if self.turned { -1.0 } else { 1.0 };
        let time = |hours: f64| {
            let moment = self.clock?.checked_add(jiff::SignedDuration::from_secs_f64(3600.0 * hours)).ok()?;
            Some(moment.strftime(clock_format(3600.0 * self.step)).to_string())
        };
        let text = |v: f64| time(v).unwrap_or_else(|| format_fixed(Some(sign * v), decimals));
        (0..=n.min(60)).map(|i| (tick(i), text(tick(i)))).collect()
    }
}

/// Steps of a time axis: seconds, minutes, hours and days, s.
const CLOCK_STEPS: [f64; 18] = [
    1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 10800.0, 21600.0,
    43200.0, 86400.0,
];

/// Returns a step of a time axis of at least `raw`, s.
fn clock_step(raw: f64) -> f64 {
    if raw < 1.0 {
        return round_step(raw.max(1e-3));
    }
    let known = CLOCK_STEPS.into_iter().find(|step| *step >= raw);
    known.unwrap_or_else(|| 86400.0 * round_step(raw / 86400.0))
}

/// Returns the time format for an axis with this step, s.
fn clock_format(step: f64) -> &'static str {
    match step {
        s if s >= 86_399.0 => "%m-%d",
        s if s >= 59.9 => "%H:%M",
        s if s >= 0.99 => "%H:%M:%S",
        _ => "%H:%M:%S%.3f",
    }
}

/// Returns 1, 2 or 5 times a power of ten, at least `raw`.
pub fn round_step(raw: f64) -> f64 {
    let decade = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|f| f * decade).find(|s| *s >= raw * 0.999).unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_cover_the_data() {
        let axis = Axis::from_values([0.02, 2.93].into_iter(), "deflection / m");
        assert_eq!(axis.range(), (0.0, 3.0));
        let texts: Vec<String> = axis.ticks().into_iter().map(|t| t.1).collect();
        assert_eq!(texts, ["0.0", "0.5", "1.0", "1.5", "2.0", "2.5", "3.0"]);
    }

    #[test]
    fn an_images_axis_ends_where_the_image_does() {
        let axis = Axis::from_exact_range(0.0, 960.0, 200.0, "v / px").reversed();
        assert_eq!(axis.range(), (-960.0, 0.0));
        let texts: Vec<String> = axis.ticks().into_iter().map(|t| t.1).collect();
        assert_eq!(texts, ["800", "600", "400", "200", "0"]);
    }

    #[test]
    fn odd_data_still_give_an_axis() {
        for values in [vec![], vec![f64::NAN], vec![7.0], vec![-3e5, f64::INFINITY, 1e-9]] {
            let axis = Axis::from_values(values.iter().copied(), "");
            let (low, high) = axis.range();
            assert!(low < high && axis.ticks().len() >= 2, "{values:?}: {axis:?}");
        }
    }

    #[test]
    fn times_of_day_are_whole_in_seconds_minutes_hours_and_days() {
        let zero = "2026-03-01T08:30:07Z".parse().ok();
        let ticks = |hours: f64| {
            let axis = Axis::from_hours([0.0, hours].into_iter(), zero);
            axis.ticks().into_iter().map(|t| t.1).take(2).collect::<Vec<_>>()
        };
        assert_eq!(ticks(6.0), ["08:00", "09:00"]);
        assert_eq!(ticks(0.5), ["08:30", "08:35"]);
        assert_eq!(ticks(0.01), ["08:30:00", "08:30:10"]);
        assert_eq!(ticks(100.0), ["03-01", "03-02"]);
    }
}
