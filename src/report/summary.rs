//! A series is summed up in one line: means over its shots.

use super::{SeriesData, distinct};
use crate::clock::Stamp;
use crate::record::{CurveRecord, GlobalTest, ImageRecord, Reference, Tip};

/// A mean over the shots of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Mean of the shots.
    pub value: f64,
    /// Root mean square of the shots' own standard deviations. Survey and mount are common to all
    /// shots, so this does not shrink with their number.
    pub sigma: Option<f64>,
    /// Standard deviation of one shot against the mean; `None` with one shot.
    pub scatter: Option<f64>,
    /// How many shots.
    pub count: usize,
}

impl Mean {
    /// Of (value, standard deviation); `None` without values. What is not finite is left out.
    pub fn of(values: &[(f64, Option<f64>)]) -> Option<Self> {
        let finite: Vec<_> = values.iter().filter(|(v, _)| v.is_finite()).collect();
        let n = finite.len() as f64;
        if finite.is_empty() {
            return None;
        }
        let value = finite.iter().map(|(v, _)| v).sum::<f64>() / n;
        let squares = finite.iter().map(|(v, _)| (v - value).powi(2)).sum::<f64>();
        let variances: Option<Vec<f64>> = finite.iter().map(|(_, s)| s.map(|s| s * s)).collect();
        let sigma = variances.map(|v| (v.iter().sum::<f64>() / n).sqrt()).filter(|s| s.is_finite());
        let scatter = (finite.len() > 1).then(|| (squares / (n - 1.0)).sqrt());
        Some(Self { value, sigma, scatter, count: finite.len() })
    }

    /// Standard deviation of the mean by repetition alone.
    pub fn scatter_of_mean(&self) -> Option<f64> {
        self.scatter.map(|s| s / (self.count as f64).sqrt())
    }
}

/// One frame's deflection.
#[derive(Clone, Debug, PartialEq)]
pub struct Single {
    /// The frame.
    pub image: String,
    /// Of the tip marker, m.
    pub deflection_m: f64,
    /// Its standard deviation, m.
    pub sigma_m: Option<f64>,
}

impl Single {
    /// The greatest of some tips' deflections against a reference.
    pub fn greatest<'a>(
        tips: impl Iterator<Item = (&'a str, &'a Tip)>,
        reference: Reference,
    ) -> Option<Self> {
        let of = |(image, tip): (&str, &Tip)| {
            let (deflection_m, sigma_m) =
                tip.deflection(reference).filter(|(deflection, _)| deflection.is_finite())?;
            Some(Self { image: image.to_owned(), deflection_m, sigma_m })
        };
        tips.filter_map(of).max_by(|a, b| a.deflection_m.total_cmp(&b.deflection_m))
    }
}

/// Torsion of a pair over a series.
#[derive(Clone, Debug, PartialEq)]
pub struct TorsionMean {
    /// The pair's name.
    pub name: String,
    /// As the paper computes it.
    pub angle_deg: Option<Mean>,
    /// Free of bending.
    pub twist_deg: Option<Mean>,
}

/// A series in one line.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesSummary {
    /// Flight and series.
    pub name: String,
    /// Its beginning, where that is known.
    pub begun: Option<Stamp>,
    /// Hours since the first series.
    pub hour: f64,
    /// Shots asked for, failed ones included.
    pub shots: usize,
    /// Frames with a result.
    pub solved: usize,
    /// Against what the deflections are counted.
    pub reference: Reference,
    /// Deflection of the tip marker.
    pub tip_deflection_m: Option<Mean>,
    /// The greatest of single frames.
    pub greatest: Option<Single>,
    /// Every pair.
    pub torsion: Vec<TorsionMean>,
    /// Smallest and largest variance factor.
    pub variance_factor: Option<(f64, f64)>,
    /// Global tests that accept the model.
    pub tests_passed: usize,
    /// Global tests made.
    pub tests_made: usize,
    /// Mean curve along the span.
    pub curve: Vec<CurveRecord>,
}

impl SeriesSummary {
    /// Of one series; `hour` as [`hours`] gives it.
    pub fn of(series: &SeriesData, hour: f64, reference: Reference) -> Self {
        let solved = solved(series);
        let tips = || solved.iter().filter_map(|r| Some((r.image.as_str(), r.tip.as_ref()?)));
        let deflections: Vec<_> = tips().filter_map(|(_, tip)| tip.deflection(reference)).collect();
        let factors: Vec<f64> =
            solved.iter().filter_map(|r| r.variance_factor).filter(|f| f.is_finite()).collect();
        let tests: Vec<GlobalTest> = solved.iter().filter_map(|r| r.global_test).collect();
        Self {
            name: series.name.clone(),
            begun: series.begun.clone(),
            hour,
            shots: series.records.len().max(series.shots.len()).max(series.planned),
            solved: solved.len(),
            reference,
            tip_deflection_m: Mean::of(&deflections),
            greatest: Single::greatest(tips(), reference),
            torsion: torsion(&solved),
            variance_factor: factors.iter().copied().fold(None, extremes),
            tests_passed: tests.iter().filter(|t| **t == GlobalTest::Passed).count(),
            tests_made: tests.len(),
            curve: if series.curve.is_empty() { mean_curve(&solved) } else { series.curve.clone() },
        }
    }

    /// To the minute; says so where there is none.
    pub fn begun_text(&self) -> String {
        self.begun.as_ref().map_or("unknown".to_owned(), |t| t.utc.strftime("%Y-%m-%d %H:%M").to_string())
    }

    /// One figure, or the range.
    pub fn variance_text(&self) -> String {
        match self.variance_factor {
            Some((low, high)) if format!("{low:.2}") == format!("{high:.2}") => format!("{low:.2}"),
            Some((low, high)) => format!("{low:.2} to {high:.2}"),
            None => super::number::NONE.to_owned(),
        }
    }
}

/// All series, in order of time.
pub fn summaries(series: &[SeriesData]) -> Vec<SeriesSummary> {
    let reference = reference(series);
    series.iter().zip(hours(series)).map(|(s, h)| SeriesSummary::of(s, h, reference)).collect()
}

/// Against what the deflections of some series are counted: one for all of them, which all frames have.
pub fn reference(series: &[SeriesData]) -> Reference {
    Reference::of(series.iter().flat_map(solved).filter_map(|r| r.tip.as_ref()))
}

/// Hours since the first series; by number (one per hour) where a time is unknown.
pub fn hours(series: &[SeriesData]) -> Vec<f64> {
    let begun: Option<Vec<&Stamp>> = series.iter().map(|s| s.begun.as_ref()).collect();
    match begun.as_deref() {
        Some(stamps @ [first, ..]) => stamps.iter().map(|s| hours_between(first, s)).collect(),
        _ => (0..series.len()).map(|i| i as f64).collect(),
    }
}

/// By the time since boot within one boot, which no setting of the clock disturbs; by UTC otherwise.
pub fn hours_between(from: &Stamp, to: &Stamp) -> f64 {
    let seconds = if from.boot_id == to.boot_id {
        to.since_boot_s - from.since_boot_s
    } else {
        to.utc.duration_since(from.utc).as_secs_f64()
    };
    seconds / 3600.0
}

/// The mean curve of the records with numbers.
pub fn curve_of(records: &[ImageRecord]) -> Vec<CurveRecord> {
    mean_curve(&records.iter().filter(|r| r.is_solved()).collect::<Vec<_>>())
}

/// The records with numbers.
pub fn solved(series: &SeriesData) -> Vec<&ImageRecord> {
    series.records.iter().filter(|r| r.is_solved()).collect()
}

fn extremes(range: Option<(f64, f64)>, value: f64) -> Option<(f64, f64)> {
    let (low, high) = range.unwrap_or((value, value));
    Some((low.min(value), high.max(value)))
}

fn torsion(solved: &[&ImageRecord]) -> Vec<TorsionMean> {
    let names = distinct(solved.iter().flat_map(|r| &r.torsion).map(|pair| pair.name.as_str()));
    names.iter().map(|name| torsion_of(solved, name)).collect()
}

fn torsion_of(solved: &[&ImageRecord], name: &str) -> TorsionMean {
    let pairs: Vec<_> = solved.iter().flat_map(|r| &r.torsion).filter(|p| p.name == name).collect();
    let angles: Vec<_> = pairs.iter().filter_map(|p| Some((p.angle_deg?, p.sigma_deg))).collect();
    let twists: Vec<_> = pairs.iter().filter_map(|p| Some((p.twist_deg?, p.sigma_twist_deg))).collect();
    TorsionMean { name: name.to_owned(), angle_deg: Mean::of(&angles), twist_deg: Mean::of(&twists) }
}

/// Point by point; frames whose curve has another length than the first one's are left out.
fn mean_curve(solved: &[&ImageRecord]) -> Vec<CurveRecord> {
    let Some(first) = solved.iter().map(|r| &r.curve).find(|c| !c.is_empty()) else {
        return Vec::new();
    };
    let alike: Vec<&Vec<CurveRecord>> =
        solved.iter().map(|r| &r.curve).filter(|c| c.len() == first.len()).collect();
    (0..first.len()).filter_map(|i| mean_point(&alike, i)).collect()
}

/// A value with its standard deviation.
type Column<'a> = &'a dyn Fn(&CurveRecord) -> Option<(f64, Option<f64>)>;

fn mean_point(curves: &[&Vec<CurveRecord>], index: usize) -> Option<CurveRecord> {
    let points: Vec<&CurveRecord> = curves.iter().filter_map(|c| c.get(index)).collect();
    let of = |f: Column| Mean::of(&points.iter().filter_map(|p| f(p)).collect::<Vec<_>>());
    let deflection = of(&|p| Some((p.deflection_m, p.sigma_deflection_m)))?;
    let twist = of(&|p| Some((p.twist_deg?, p.sigma_twist_deg)));
    Some(CurveRecord {
        arc_length_m: of(&|p| Some((p.arc_length_m, None)))?.value,
        span_m: of(&|p| Some((p.span_m, None)))?.value,
        deflection_m: deflection.value,
        sigma_deflection_m: deflection.sigma,
        twist_deg: twist.map(|t| t.value),
        sigma_twist_deg: twist.and_then(|t| t.sigma),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::sample;
    use super::*;

    #[test]
    fn the_mean_keeps_common_errors_and_shows_the_scatter() {
        let mean = Mean::of(&[(1.0, Some(0.3)), (3.0, Some(0.4)), (f64::NAN, None)]).unwrap();
        assert_eq!((mean.value, mean.count), (2.0, 2));
        assert!((mean.sigma.unwrap() - 0.125_f64.sqrt()).abs() < 1e-12);
        assert!((mean.scatter.unwrap() - 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((mean.scatter_of_mean().unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(Mean::of(&[]), None);
        assert_eq!(Mean::of(&[(1.0, Some(0.1))]).unwrap().scatter, None);
    }

    #[test]
    fn failed_frames_do_not_enter_the_means() {
        let mut series = sample::series("s1", 0, &[2.9, 3.1]);
        series.records.push(sample::failed("x.jpg", "dark"));
        let summary = SeriesSummary::of(&series, 0.0, Reference::Survey);
        let greatest = summary.greatest.unwrap();
        assert_eq!((greatest.image.as_str(), greatest.deflection_m), ("s1-01.jpg", 3.1));
        assert_eq!((summary.shots, summary.solved, summary.tests_passed), (3, 2, 2));
        assert!((summary.tip_deflection_m.unwrap().value - 3.0).abs() < 1e-12);
        assert!((summary.curve.last().unwrap().deflection_m - 3.0).abs() < 1e-12);
        assert!(summary.torsion[0].twist_deg.is_some());
    }

    #[test]
    fn hours_count_from_the_first_series_or_by_number() {
        let mut series = vec![sample::series("a", 0, &[1.0]), sample::series("b", 5400, &[1.0])];
        assert_eq!(hours(&series), [0.0, 1.5]);
        series[1].begun.as_mut().unwrap().utc = jiff::Timestamp::UNIX_EPOCH;
        assert_eq!(hours(&series), [0.0, 1.5], "a set clock within one boot changes nothing");
        series[1].begun = None;
        assert_eq!(hours(&series), [0.0, 1.0]);
        assert!(hours(&[]).is_empty());
    }
}
