//! Frames of one camera as they come (docs/live.md): detection guided by the frame before, adjustment with all that the
//! frames before determined.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::guided::{self, Search};
use super::stages::{self, ProcessedFrame, Stage, Work};
use super::{Job, corrected, flight_priors, recording};
use crate::camera::Format;
use crate::installation::Installation;
use crate::measure::adjust::{AdjustError, Live, Parameter, Solution};
use crate::measure::detect::{Detection, MarkerPrediction};
use crate::measure::identify::{self, Identities, MAX_DEFLECTION_CHANGE_M};
use crate::measure::setup::Orientation;
use crate::pipeline::guard::{BROKE_OFF, guarded};
use crate::record::{ImageRecord, Provenance, Reason};

/// The image of a marker, as an ellipse in the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// Of the survey; `null` for one without a name.
    pub id: Option<String>,
    /// Centre, px.
    pub u_px: f64,
    /// px.
    pub v_px: f64,
    /// px.
    pub semi_major_px: f64,
    /// px.
    pub semi_minor_px: f64,
    /// Of the longer axis, from u to v, degrees.
    pub angle_deg: f64,
}

/// What tracking gave of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// With or without numbers.
    pub record: ImageRecord,
    /// How the frame was searched.
    pub search: Search,
    /// Which mounting of the camera, from 1; after each mount_disturbed the next. 0 before the first solution.
    pub mounting: usize,
    /// Whether this frame showed that the camera mount was disturbed.
    pub mount_disturbed: bool,
    /// Of all that was detected.
    pub outlines: Vec<Outline>,
    /// The bending line, where there are numbers.
    pub curvature: Option<Curvature>,
}

impl Tracked {
    /// Of a frame without numbers; its record says why.
    pub fn failed(record: ImageRecord) -> Self {
        let (outlines, curvature) = (vec![], None);
        Self { record, search: Search::Full, mounting: 0, mount_disturbed: false, outlines, curvature }
    }
}

/// Coefficients of the curvature, in the shape of the record's `curvature_per_m`, with their covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct Curvature {
    /// 1/m.
    pub per_m: Vec<f64>,
    /// The upper triangle, row by row, 1/m2.
    pub covariance: Vec<f64>,
}

impl Curvature {
    /// `None` where a coefficient has no standard deviation.
    fn of(solution: &Solution) -> Option<Self> {
        let before = |p: &&Parameter| p.name != "curvature_per_m";
        let first: usize = solution.parameters.iter().take_while(before).map(|p| p.values.len()).sum();
        let own = &solution.parameters.iter().find(|p| !before(p))?.values;
        let sigmas: Vec<f64> = own.iter().map(|e| e.sigma).collect::<Option<_>>()?;
        let correlation = |i: usize, j: usize| solution.correlation.get((first + i, first + j)).copied();
        let mut covariance = vec![];
        for (i, row) in sigmas.iter().enumerate() {
            for (j, column) in sigmas.iter().enumerate().skip(i) {
                covariance.push(row * column * correlation(i, j)?);
            }
        }
        Some(Self { per_m: own.iter().map(|e| e.value).collect(), covariance })
    }
}

/// The last frame's markers.
struct Seen {
    detections: Vec<Detection>,
    identities: Identities,
    /// When it was exposed, since boot, s.
    at_s: f64,
}

/// A tip moves no faster, m/s: a deflection of 0.25 m at 2 Hz, about where large wings swing by themselves.
const FASTEST_M_S: f64 = 3.0;
/// However long ago the last frame is, a tip in gusts is no farther from where it was, m. Where it is, the whole frame is
/// searched, since markers are missing.
const MAX_DISTANCE_M: f64 = 0.6;
/// After so long nothing is predicted, s.
const MAX_GAP_S: f64 = 5.0;

/// All that the frames so far determined of one camera.
pub struct Tracker {
    installation: Arc<Installation>,
    orientation: Orientation,
    job: Job,
    live: Live,
    /// Foretells the next frame; none before the first and after a loss.
    seen: Option<Seen>,
    /// Exposure of the last frame that was solved, since boot, s.
    last_s: Option<f64>,
}

impl Tracker {
    /// Begins without a frame.
    ///
    /// # Errors
    /// Where the installation cannot be adjusted.
    pub fn begin(
        installation: Arc<Installation>,
        orientation: Orientation,
        job: Job,
    ) -> Result<Self, AdjustError> {
        let (options, _) = flight_priors::options(job.options.clone(), &installation, &[]);
        let live = Live::begin(installation.setup.clone(), orientation.clone(), options)?;
        Ok(Self { installation, orientation, job, live, seen: None, last_s: None })
    }

    /// The next frame, exposed `at_s` since boot. Whatever goes wrong with it is in the record; the state stays then.
    pub fn frame(&mut self, name: &str, bytes: &[u8], format: Option<&Format>, at_s: f64) -> Tracked {
        let tracked = guarded(|| {
            let seen = self.seen.take();
            let predictions = seen.as_ref().map_or(vec![], |seen| self.predicted(seen, at_s));
            let known = seen.map(|seen| seen.identities);
            self.solve(name, bytes, format, at_s, (&predictions, known.as_ref()))
        });
        tracked.unwrap_or_else(|| {
            self.failed(&ProcessedFrame { image: name.into(), ..ProcessedFrame::default() }, BROKE_OFF)
        })
    }

    /// Where this frame shows the markers: the longer ago the last one, the wider.
    fn predicted(&self, seen: &Seen, at_s: f64) -> Vec<MarkerPrediction> {
        let elapsed_s = at_s - seen.at_s;
        if !(0.0..=MAX_GAP_S).contains(&elapsed_s) {
            return vec![];
        }
        let (setup, orientation) = (&self.installation.setup, &self.orientation);
        let deflection_m = (FASTEST_M_S * elapsed_s).clamp(MAX_DEFLECTION_CHANGE_M, MAX_DISTANCE_M);
        identify::predict_next_frame_within(setup, orientation, &seen.detections, &seen.identities, deflection_m)
    }

    fn failed(&self, sighting: &ProcessedFrame, reason: &str) -> Tracked {
        let mut record = recording::record(sighting, &self.installation, &self.job, Err(reason.into()));
        record.provenance = Provenance::default();
        Tracked { mounting: self.live.mountings(), ..Tracked::failed(record) }
    }

    fn solve(
        &mut self,
        name: &str,
        bytes: &[u8],
        format: Option<&Format>,
        at_s: f64,
        (predictions, known): (&[MarkerPrediction], Option<&Identities>),
    ) -> Tracked {
        let mut sighting = ProcessedFrame { image: name.into(), ..ProcessedFrame::default() };
        let (setup, orientation) = (&self.installation.setup, &self.orientation);
        // A tip that moves fast is not where it was, nor of the shape; the wing's root tells where it is.
        let onwards = |found: &[Detection]| identify::predict_from_found(setup, orientation, found, known?);
        let (part, search) = guided::look_guided(&mut sighting, bytes, format, predictions, onwards);
        if let Some(part) = &part {
            sighting.failure = stages::size_fault(part.raster(), &self.installation);
        }
        if let (None, Some(mut part)) = (&sighting.failure, part) {
            let (installation, orientation) = (&self.installation, &self.orientation);
            let known = stages::recognise_for_next(&mut sighting, &mut part, installation, orientation);
            self.seen = known.map(|(detections, identities)| Seen { detections, identities, at_s });
        }
        let before = self.live.mountings();
        let started = std::time::Instant::now();
        let outcome = corrected(&sighting, &self.installation, &self.orientation);
        let outcome = outcome.and_then(|(observations, report)| {
            // A clock that was set back, or a frame without a time of its own: no time has gone.
            let elapsed_s = self.last_s.map_or(0.0, |last| (at_s - last).max(0.0));
            let solution = self.live.frame(&observations, elapsed_s).map_err(Reason::of)?;
            self.last_s = Some(at_s);
            Ok((solution, report))
        });
        sighting.stages.push(Stage::ended(Work::Solve, started));
        let curvature = outcome.as_ref().ok().and_then(|(solution, _)| Curvature::of(solution));
        let mut record = recording::record(&sighting, &self.installation, &self.job, outcome);
        // The same in every line, and written once with the table of results.
        record.provenance = Provenance::default();
        record.quality.correlation = None;
        let mounting = self.live.mountings();
        let mount_disturbed = before > 0 && mounting > before;
        Tracked {
            record,
            search,
            mounting,
            mount_disturbed,
            outlines: outlines(&sighting, &self.installation),
            curvature,
        }
    }
}

fn outlines(sighting: &ProcessedFrame, installation: &Installation) -> Vec<Outline> {
    let name = |i: usize| {
        let marker = (*sighting.identities.as_ref()?.marker_of.get(i)?)?;
        Some(installation.setup.markers.get(marker)?.id.clone())
    };
    let tenth = |value: f64| (value * 10.0).round() / 10.0;
    let outline = |(i, seen): (usize, &crate::measure::detect::Detection)| Outline {
        id: name(i),
        u_px: tenth(seen.centre_px.x),
        v_px: tenth(seen.centre_px.y),
        semi_major_px: tenth(seen.semi_major_px),
        semi_minor_px: tenth(seen.semi_minor_px),
        angle_deg: tenth(seen.angle_rad.to_degrees()),
    };
    sighting.detections.markers.iter().enumerate().map(outline).collect()
}
