//! Axes with round ticks, for lengths and angles and for the time of day.

use serde::Serialize;

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
}

/// Axis as read by the script of a page, which draws the ticks of another range.
#[derive(Serialize)]
struct ScriptAxis<'a> {
    label: &'a str,
    turned: bool,
    /// Hours from 1970 to the zero of a time axis; 0 if the values are not times.
    zero: f64,
    /// Steps from the smallest to the largest, each with its text format.
    steps: Vec<(f64, usize, Option<usize>)>,
}

impl Axis {
    /// Covers all finite values; 0 to 1 if there are none.
    pub fn from_values(values: impl Iterator<Item = f64>, label: &str) -> Self {
        let (low, high) = value_range(values);
        Self::from_ticks(
            (low, high),
            round_step(range_width(low, high) / 6.0),
            label,
            None,
        )
    }

    /// Covers hours since `zero`, with times of day (UTC) at the ticks; numbers of series if `zero` is unknown.
    pub fn from_hours(hours: impl Iterator<Item = f64>, zero: Option<jiff::Timestamp>) -> Self {
        let Some(clock) = zero else {
            return Self::from_values(hours, "number of the series, with its frames in order");
        };
        let (low, high) = value_range(hours);
        let step = clock_step(3600.0 * range_width(low, high) / 7.0) / 3600.0;
        let label = format!("UTC, from {}", clock.strftime("%Y-%m-%d %H:%M"));
        Self::from_ticks((low, high), step, &label, zero)
    }

    /// Covers a range, extended to the next ticks: multiples of the step, on a time axis round times of day.
    fn from_ticks(
        (low, high): (f64, f64),
        step: f64,
        label: &str,
        clock: Option<jiff::Timestamp>,
    ) -> Self {
        let axis = Self {
            low,
            high,
            step,
            label: label.to_owned(),
            turned: false,
            clock,
        };
        let begin = axis.begin_h();
        // A band that exceeds a tick by less than 4 % of the step adds no interval.
        let low = ((begin + low) / step + 0.04).floor() * step - begin;
        let high = ((begin + high) / step - 0.04).ceil() * step - begin;
        Self {
            low,
            high: if high > low { high } else { low + step },
            ..axis
        }
    }

    /// Returns the axis for values with the opposite sign: the displayed values increase downwards or to the left.
    pub fn reversed(self) -> Self {
        Self {
            low: -self.high,
            high: -self.low,
            turned: !self.turned,
            ..self
        }
    }

    /// Returns the lower and the upper end.
    pub fn range(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Returns the label, with the unit.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Returns the position of a value on the axis: 0 at its lower end, 1 at its upper end.
    pub fn fraction(&self, value: f64) -> f64 {
        (value - self.low) / (self.high - self.low)
    }

    /// Returns the positions of the ticks and their texts.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        let begin = self.begin_h();
        let first = ((begin + self.low) / self.step - 1e-6).ceil() * self.step - begin;
        let n = ((self.high - first) / self.step + 1e-6).floor() as usize;
        let tick = |i: usize| first + i as f64 * self.step;
        (0..=n.min(60))
            .map(|i| (tick(i), self.tick_text(tick(i))))
            .collect()
    }

    fn tick_text(&self, value: f64) -> String {
        match (self.clock, text_format(self.step, self.clock.is_some())) {
            (Some(clock), (from, Some(to))) => {
                let after = jiff::SignedDuration::from_millis((3.6e6 * value).round() as i64);
                let moment = clock
                    .checked_add(after)
                    .unwrap_or(clock)
                    .strftime("%Y-%m-%dT%H:%M:%S%.3f")
                    .to_string();
                moment.get(from..to).unwrap_or_default().to_owned()
            }
            (_, (decimals, _)) => {
                format_fixed(Some(if self.turned { -value } else { value }), decimals)
            }
        }
    }

    /// Formats the axis as JSON for the script of the page.
    pub fn to_json(&self) -> String {
        let larger = |step: &f64| match self.clock {
            Some(_) => Some(clock_step(3600.0 * 1.2 * step) / 3600.0),
            None => Some(round_step(1.2 * step)),
        };
        let steps = std::iter::successors(larger(&(self.step / 2000.0)), larger)
            .take_while(|s| *s < 50.0 * self.step);
        let formatted = steps.map(|step| {
            let (from, to) = text_format(step, self.clock.is_some());
            (step, from, to)
        });
        let zero = self.begin_h();
        let axis = ScriptAxis {
            label: &self.label,
            turned: self.turned,
            zero,
            steps: formatted.collect(),
        };
        serde_json::to_string(&axis).unwrap_or_default()
    }

    /// Returns the hours from 1970 to the zero of the axis; 0 if its values are not times.
    fn begin_h(&self) -> f64 {
        self.clock
            .map_or(0.0, |clock| clock.as_millisecond() as f64 / 3.6e6)
    }
}

/// Returns the smallest and the largest finite value; 0 and 1 if there are none.
fn value_range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let extend = |range: Option<(f64, f64)>, v: f64| {
        let (low, high) = range.unwrap_or((v, v));
        Some((low.min(v), high.max(v)))
    };
    values
        .filter(|v| v.is_finite())
        .fold(None, extend)
        .unwrap_or((0.0, 1.0))
}

/// Returns the width of a range; 1 if it is almost a point, and more for a point so large that 1 would not change it.
fn range_width(low: f64, high: f64) -> f64 {
    if high - low > 1e-9 * (1.0 + high.abs()) {
        high - low
    } else {
        1.0_f64.max(1e-6 * high.abs())
    }
}

/// Steps of a time axis: seconds, minutes, hours and days, s.
const CLOCK_STEPS: [f64; 18] = [
    1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0,
    10800.0, 21600.0, 43200.0, 86400.0,
];

/// Returns a step of a time axis of at least `raw`, s.
fn clock_step(raw: f64) -> f64 {
    if raw < 1.0 {
        return round_step(raw.max(1e-3));
    }
    let known = CLOCK_STEPS.into_iter().find(|step| *step >= raw);
    known.unwrap_or_else(|| 86400.0 * round_step(raw / 86400.0))
}

/// Returns how the ticks of a step are written: the number of decimals, or on a time axis (step in hours) the beginning and
/// the end of the part of an ISO 8601 time.
fn text_format(step: f64, clock: bool) -> (usize, Option<usize>) {
    match 3600.0 * step {
        _ if !clock => (
            (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize,
            None,
        ),
        s if s >= 86_399.0 => (5, Some(10)),
        s if s >= 59.9 => (11, Some(16)),
        s if s >= 0.99 => (11, Some(19)),
        _ => (11, Some(23)),
    }
}

/// Returns 1, 2 or 5 times a power of ten, at least `raw`.
pub fn round_step(raw: f64) -> f64 {
    let decade = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|f| f * decade)
        .find(|s| *s >= raw * 0.999)
        .unwrap_or(10.0 * decade)
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
    fn odd_data_still_give_an_axis() {
        for values in [
            vec![],
            vec![f64::NAN],
            vec![7.0],
            vec![-3e5, f64::INFINITY, 1e-9],
            vec![1e300],
        ] {
            let axis = Axis::from_values(values.iter().copied(), "");
            let (low, high) = axis.range();
            assert!(
                low < high && axis.ticks().len() >= 2,
                "{values:?}: {axis:?}"
            );
        }
    }

    #[test]
    fn times_of_day_are_whole_in_seconds_minutes_hours_and_days() {
        let zero = "2026-03-01T08:30:07Z".parse().ok();
        let ticks = |hours: f64| {
            let axis = Axis::from_hours([0.0, hours].into_iter(), zero);
            axis.ticks()
                .into_iter()
                .map(|t| t.1)
                .take(2)
                .collect::<Vec<_>>()
        };
        assert_eq!(ticks(6.0), ["08:00", "09:00"]);
        assert_eq!(ticks(0.5), ["08:30", "08:35"]);
        assert_eq!(ticks(0.01), ["08:30:00", "08:30:10"]);
        assert_eq!(ticks(100.0), ["03-01", "03-02"]);
    }

    #[test]
    fn the_script_gets_every_step_once_with_its_format() {
        let steps = |axis: Axis| {
            let json: serde_json::Value = serde_json::from_str(&axis.to_json()).unwrap_or_default();
            json["steps"].as_array().cloned().unwrap_or_default()
        };
        let plain = steps(Axis::from_values([0.0, 3.0].into_iter(), ""));
        assert_eq!(
            plain
                .iter()
                .filter(|s| s[0].as_f64().is_some_and(|s| (0.09..0.6).contains(&s)))
                .count(),
            3
        );
        assert!(plain.contains(&serde_json::json!([0.5, 1, null])));
        let clock = steps(Axis::from_hours(
            [0.0, 6.0].into_iter(),
            "2026-03-01T08:30:07Z".parse().ok(),
        ));
        assert!(
            clock.contains(&serde_json::json!([0.25, 11, 16]))
                && clock.contains(&serde_json::json!([24.0, 5, 10]))
        );
    }
}
