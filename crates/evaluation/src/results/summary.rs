//! Summary of a series: means over its shots.

use super::{SeriesData, distinct_values};
use crate::record::{CurveRecord, ImageRecord, IncidenceRecord, Tip};
use wingd_base::clock::Stamp;
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::estimation::quality::GlobalTest;

/// Mean over the shots of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    pub value: f64,
    /// Root mean square of the standard deviations of the shots. Survey and mounting are common to all shots, so it does
    /// not decrease with their number.
    pub sigma: Option<f64>,
    /// Standard deviation of a single shot about the mean; `None` with one shot.
    pub scatter: Option<f64>,
}

impl Mean {
    /// Computes the mean of values with standard deviations, ignoring values that are not finite; `None` without values.
    pub fn from_values(values: &[(f64, Option<f64>)]) -> Option<Self> {
        let finite: Vec<_> = values.iter().filter(|(v, _)| v.is_finite()).collect();
        let n = finite.len() as f64;
        if finite.is_empty() {
            return None;
        }
        let value = finite.iter().map(|(v, _)| v).sum::<f64>() / n;
        let squares = finite.iter().map(|(v, _)| (v - value).powi(2)).sum::<f64>();
        let variances: Option<Vec<f64>> = finite.iter().map(|(_, s)| s.map(|s| s * s)).collect();
        let sigma = variances
            .map(|v| (v.iter().sum::<f64>() / n).sqrt())
            .filter(|s| s.is_finite());
        let scatter = (finite.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
        Some(Self {
            value,
            sigma,
            scatter,
        })
    }
}

/// Deflection of a single frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameDeflection {
    /// File name of the frame.
    pub image: String,
    /// Label of the tip marker.
    pub marker: String,
    /// Deflection of the tip marker, m.
    pub deflection_m: f64,
    /// Standard deviation of the deflection, m.
    pub sigma_m: Option<f64>,
}

impl FrameDeflection {
    /// Returns the largest tip deflection relative to a reference.
    pub fn greatest<'a>(
        tips: impl Iterator<Item = (&'a str, &'a Tip)>,
        reference: DeflectionReference,
    ) -> Option<Self> {
        let frame_deflection = |(image, tip): (&str, &Tip)| {
            let (deflection_m, sigma_m) = tip
                .deflection(reference)
                .filter(|(deflection, _)| deflection.is_finite())?;
            Some(Self {
                image: image.to_owned(),
                marker: tip.label(),
                deflection_m,
                sigma_m,
            })
        };
        tips.filter_map(frame_deflection)
            .max_by(|a, b| a.deflection_m.total_cmp(&b.deflection_m))
    }
}

/// Mean torsion of a pair over a series.
#[derive(Clone, Debug, PartialEq)]
pub struct TorsionMean {
    /// Name of the pair.
    pub name: String,
    /// Torsion angle as defined in the publication.
    pub angle_deg: Option<Mean>,
    /// Twist, free of bending.
    pub twist_deg: Option<Mean>,
}

/// Summary of a series.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesSummary {
    pub name: String,
    /// Start time, if known.
    pub begun: Option<Stamp>,
    /// Hours since the first series.
    pub hour: f64,
    /// Number of requested shots, failed ones included.
    pub shots: usize,
    /// Number of solved frames.
    pub solved: usize,
    /// Reference of the deflections.
    pub reference: DeflectionReference,
    /// Mean deflection of the tip marker.
    pub tip_deflection_m: Option<Mean>,
    /// Largest tip deflection of a single frame.
    pub greatest: Option<FrameDeflection>,
    /// Mean torsion of every pair.
    pub torsion: Vec<TorsionMean>,
    /// Smallest and largest variance factor.
    pub variance_factor: Option<(f64, f64)>,
    /// Number of global tests that accept the model.
    pub tests_passed: usize,
    /// Number of global tests.
    pub tests_made: usize,
    /// Mean curve along the span.
    pub curve: Vec<CurveRecord>,
}

impl SeriesSummary {
    /// Summarises one series; `hour` is its entry of [`series_hours`].
    pub fn from_series(series: &SeriesData, hour: f64, reference: DeflectionReference) -> Self {
        let solved = solved_records(series);
        let tips = || {
            solved
                .iter()
                .filter_map(|r| Some((r.image.as_str(), r.tip.as_ref()?)))
        };
        let deflections: Vec<_> = tips()
            .filter_map(|(_, tip)| tip.deflection(reference))
            .collect();
        let factors: Vec<f64> = solved
            .iter()
            .filter_map(|r| r.variance_factor)
            .filter(|f| f.is_finite())
            .collect();
        let tests: Vec<GlobalTest> = solved.iter().filter_map(|r| r.global_test).collect();
        Self {
            name: series.name.clone(),
            begun: series.begun.clone(),
            hour,
            shots: series
                .records
                .len()
                .max(series.shots.len())
                .max(series.planned),
            solved: solved.len(),
            reference,
            tip_deflection_m: Mean::from_values(&deflections),
            greatest: FrameDeflection::greatest(tips(), reference),
            torsion: torsion_means(&solved),
            variance_factor: factors.iter().copied().fold(None, extend_range),
            tests_passed: tests.iter().filter(|t| **t == GlobalTest::Passed).count(),
            tests_made: tests.len(),
            curve: if series.curve.is_empty() {
                mean_curve(&solved)
            } else {
                series.curve.clone()
            },
        }
    }

    /// Formats the start time to the minute; "unknown" if there is none.
    pub fn begun_text(&self) -> String {
        let begun = self.begun.as_ref().and_then(Stamp::known_utc);
        begun.map_or("unknown".to_owned(), |utc| {
            utc.strftime("%Y-%m-%d %H:%M").to_string()
        })
    }

    /// Formats the variance factor, or its range.
    pub fn variance_text(&self) -> String {
        match self.variance_factor {
            Some((low, high)) if format!("{low:.2}") == format!("{high:.2}") => format!("{low:.2}"),
            Some((low, high)) => format!("{low:.2} to {high:.2}"),
            None => crate::number::NONE.to_owned(),
        }
    }
}

/// Summarises all series, in order of time.
pub fn summarise_series(series: &[SeriesData]) -> Vec<SeriesSummary> {
    let reference = common_reference(series);
    series
        .iter()
        .zip(series_hours(series))
        .map(|(s, h)| SeriesSummary::from_series(s, h, reference))
        .collect()
}

/// Returns the reference of all deflections of a page: the most precise one that tips and curves have in common.
pub fn common_reference(series: &[SeriesData]) -> DeflectionReference {
    let records = || series.iter().flat_map(solved_records);
    let reference = Tip::most_precise_reference(records().filter_map(|r| r.tip.as_ref()));
    let points = records().flat_map(|r| &r.curve);
    let mut points = points.chain(series.iter().flat_map(|s| &s.curve));
    // Results of older programs have curves relative to the survey alone.
    if points.all(|point| point.deflection(reference).is_some()) {
        reference
    } else {
        DeflectionReference::Survey
    }
}

/// Returns the hours of each series since the first one; if a start time is unknown, the number of the series.
pub fn series_hours(series: &[SeriesData]) -> Vec<f64> {
    let begun: Option<Vec<&Stamp>> = series.iter().map(|s| s.begun.as_ref()).collect();
    match begun.as_deref() {
        Some(stamps @ [first, ..]) => stamps.iter().map(|s| hours_between(first, s)).collect(),
        _ => (0..series.len()).map(|i| i as f64).collect(),
    }
}

/// Returns the hours between two times: by time since boot within one boot, which is independent of clock adjustments,
/// otherwise by UTC.
pub fn hours_between(from: &Stamp, to: &Stamp) -> f64 {
    let seconds = if from.boot_id == to.boot_id {
        to.since_boot_s - from.since_boot_s
    } else {
        to.utc.duration_since(from.utc).as_secs_f64()
    };
    seconds / 3600.0
}

/// Returns the mean curve of the solved records.
pub fn mean_solved_curve(records: &[ImageRecord]) -> Vec<CurveRecord> {
    mean_curve(&records.iter().filter(|r| r.is_solved()).collect::<Vec<_>>())
}

/// Returns the solved records.
pub fn solved_records(series: &SeriesData) -> Vec<&ImageRecord> {
    series.records.iter().filter(|r| r.is_solved()).collect()
}

fn extend_range(range: Option<(f64, f64)>, value: f64) -> Option<(f64, f64)> {
    let (low, high) = range.unwrap_or((value, value));
    Some((low.min(value), high.max(value)))
}

fn torsion_means(solved: &[&ImageRecord]) -> Vec<TorsionMean> {
    let names = distinct_values(
        solved
            .iter()
            .flat_map(|r| &r.torsion)
            .map(|pair| pair.name.as_str()),
    );
    names
        .iter()
        .map(|name| torsion_mean(solved, name))
        .collect()
}

fn torsion_mean(solved: &[&ImageRecord], name: &str) -> TorsionMean {
    let pairs: Vec<_> = solved
        .iter()
        .flat_map(|r| &r.torsion)
        .filter(|p| p.name == name)
        .collect();
    let angles: Vec<_> = pairs
        .iter()
        .filter_map(|p| Some((p.angle_deg?, p.sigma_deg)))
        .collect();
    let twists: Vec<_> = pairs
        .iter()
        .filter_map(|p| Some((p.twist_deg?, p.sigma_twist_deg)))
        .collect();
    TorsionMean {
        name: name.to_owned(),
        angle_deg: Mean::from_values(&angles),
        twist_deg: Mean::from_values(&twists),
    }
}

/// Averages curves point by point; a frame whose curve differs in length from the first one is ignored.
fn mean_curve(solved: &[&ImageRecord]) -> Vec<CurveRecord> {
    let Some(first) = solved.iter().map(|r| &r.curve).find(|c| !c.is_empty()) else {
        return Vec::new();
    };
    let curves: Vec<&Vec<CurveRecord>> = solved
        .iter()
        .map(|r| &r.curve)
        .filter(|c| c.len() == first.len())
        .collect();
    (0..first.len())
        .filter_map(|i| mean_curve_point(&curves, i))
        .collect()
}

/// Function that reads a value and its standard deviation from a point of the curve.
type CurveQuantity<'a> = &'a dyn Fn(&CurveRecord) -> Option<(f64, Option<f64>)>;

fn mean_curve_point(curves: &[&Vec<CurveRecord>], index: usize) -> Option<CurveRecord> {
    let points: Vec<&CurveRecord> = curves.iter().filter_map(|c| c.get(index)).collect();
    let mean_value = |f: CurveQuantity| {
        Mean::from_values(&points.iter().filter_map(|p| f(p)).collect::<Vec<_>>())
    };
    let [survey, ground, root] =
        DeflectionReference::ALL.map(|reference| mean_value(&|p| p.deflection(reference)));
    let deflection = survey?;
    let twist = mean_value(&|p| Some((p.twist_deg?, p.sigma_twist_deg)));
    let slope = mean_value(&|p| Some((p.incidence.slope_deg?, p.incidence.sigma_slope_deg)));
    let streamwise = mean_value(&|p| {
        Some((
            p.incidence.streamwise_twist_deg?,
            p.incidence.sigma_streamwise_twist_deg,
        ))
    });
    Some(CurveRecord {
        arc_length_m: mean_value(&|p| Some((p.arc_length_m, None)))?.value,
        span_m: mean_value(&|p| Some((p.span_m, None)))?.value,
        deflection_m: deflection.value,
        sigma_deflection_m: deflection.sigma,
        deflection_ground_m: ground.map(|mean| mean.value),
        sigma_deflection_ground_m: ground.and_then(|mean| mean.sigma),
        deflection_root_m: root.map(|mean| mean.value),
        sigma_deflection_root_m: root.and_then(|mean| mean.sigma),
        twist_deg: twist.map(|t| t.value),
        sigma_twist_deg: twist.and_then(|t| t.sigma),
        incidence: IncidenceRecord {
            slope_deg: slope.map(|t| t.value),
            sigma_slope_deg: slope.and_then(|t| t.sigma),
            streamwise_twist_deg: streamwise.map(|t| t.value),
            sigma_streamwise_twist_deg: streamwise.and_then(|t| t.sigma),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::super::sample;
    use super::*;

    #[test]
    fn the_mean_keeps_common_errors_and_shows_the_scatter() {
        let mean =
            Mean::from_values(&[(1.0, Some(0.3)), (3.0, Some(0.4)), (f64::NAN, None)]).unwrap();
        assert_eq!(mean.value, 2.0);
        assert!((mean.sigma.unwrap() - 0.125_f64.sqrt()).abs() < 1e-12);
        assert!((mean.scatter.unwrap() - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(Mean::from_values(&[]), None);
        assert_eq!(
            Mean::from_values(&[(1.0, Some(0.1))]).unwrap().scatter,
            None
        );
    }

    #[test]
    fn failed_frames_do_not_enter_the_means() {
        let mut series = sample::series("s1", 0, &[2.9, 3.1]);
        series.records.push(sample::failed("x.jpg", "dark"));
        let summary = SeriesSummary::from_series(&series, 0.0, DeflectionReference::Survey);
        let greatest = summary.greatest.unwrap();
        assert_eq!(
            (greatest.image.as_str(), greatest.deflection_m),
            ("s1-01.jpg", 3.1)
        );
        assert_eq!(
            (summary.shots, summary.solved, summary.tests_passed),
            (3, 2, 2)
        );
        assert!((summary.tip_deflection_m.unwrap().value - 3.0).abs() < 1e-12);
        assert!((summary.curve.last().unwrap().deflection_m - 3.0).abs() < 1e-12);
        assert!(summary.torsion[0].twist_deg.is_some());
    }

    #[test]
    fn hours_count_from_the_first_series_or_by_number() {
        let mut series = vec![
            sample::series("a", 0, &[1.0]),
            sample::series("b", 5400, &[1.0]),
        ];
        assert_eq!(series_hours(&series), [0.0, 1.5]);
        series[1].begun.as_mut().unwrap().utc = jiff::Timestamp::UNIX_EPOCH;
        assert_eq!(
            series_hours(&series),
            [0.0, 1.5],
            "a set clock within one boot changes nothing"
        );
        series[1].begun = None;
        assert_eq!(series_hours(&series), [0.0, 1.0]);
        assert!(series_hours(&[]).is_empty());
    }
}
