//! Diagnosis of a frame in flight.

use super::super::scene::{WingView, is_usable};
use super::super::{IdentifyError, Identities};
use super::cause::{Cause, is_bent};
use super::search::{CLUTTER_RATIO, OTHER_AIRCRAFT, WINDOW_PX, turn_detections};
use super::subject::Subject;
use super::{Diagnosis, named_image, rank_causes};
use crate::detect::Detection;
use crate::observation::Estimate;
use crate::setup::{Orientation, Setup};

/// Step between such windows, px: less than a window, so that they overlap.
const STEP_PX: f64 = 450.0;
/// Trial scales of the image, logarithms: zoom creep, stabilisation, corrected distortion.
const SCALES: [f64; 10] = [
    -0.01, 0.01, -0.02, 0.02, -0.04, 0.04, -0.07, 0.07, -0.12, 0.12,
];

impl WingView<'_> {
    /// Diagnoses a frame in flight that [`WingView::identify_markers`] rejected; one sentence, or `None` if no cause is
    /// found.
    pub fn diagnose_frame(&self, detections: &[Detection]) -> Option<String> {
        if detections.len() > CLUTTER_RATIO * self.setup.markers.len() {
            return None;
        }
        let wide = Setup {
            mount_repeatability_px: WINDOW_PX / 3.0,
            ..self.setup.clone()
        };
        let half_turned = turn_detections(
            &Subject::new(self.setup, vec![]),
            detections,
            Some(Cause::UpsideDown),
        );
        let steps = [0.0, -STEP_PX, STEP_PX].map(|px| px / self.setup.lens.focal_px());
        let turns = steps
            .iter()
            .flat_map(|u| steps.iter().map(move |v| (Cause::Turn, vec![-v, *u, 0.0])));
        let scales = SCALES.iter().map(|s| (Cause::ImageScale, vec![*s]));
        let images = [Cause::UpsideDown, Cause::Mirrored].map(|cause| (cause, vec![]));
        let starts = turns
            .chain(images)
            .chain(scales)
            .map(|start| (start, detections));
        // Mirrored up to down is mirrored left to right and upside down.
        let mut starts = starts.chain([((Cause::Mirrored, vec![]), half_turned.as_slice())]);
        let found = starts.find_map(|((cause, values), detections)| {
            let setup = if cause == Cause::Turn {
                &wide
            } else {
                self.setup
            };
            let right = cause.apply(&Subject::new(setup, vec![]), &values);
            let seen = turn_detections(&right, detections, Some(cause));
            let camera_from_survey = right.turn * self.orientation.camera_from_survey;
            let near = Orientation {
                camera_from_survey,
                ..self.orientation.clone()
            };
            let identities = WingView::in_flight(&right.setup, &near).identify_most(&seen)?;
            let centred = self.remove_perspective_bias(detections, &identities);
            let images = identities
                .pairs()
                .iter()
                .map(|(i, j)| named_image(&centred[*i], *j))
                .collect();
            let subject = Subject::new(self.setup, images);
            let ranked = rank_causes(&subject, Some(self.orientation), Some((cause, &values)));
            let text = ranked.as_ref().and_then(Diagnosis::text);
            let size: Vec<Estimate> = values
                .iter()
                .map(|v| Estimate {
                    value: *v,
                    sigma: None,
                })
                .collect();
            Some(text.unwrap_or_else(|| cause.describe(&size, self.setup, true)))
        });
        let usable = detections.iter().filter(|d| is_usable(d)).count();
        // Markers that fit the wing in several ways are ambiguous, not those of another one.
        let fits_nowhere = || {
            matches!(
                self.identify_markers(detections),
                Err(IdentifyError::NoConsensus { .. })
            )
        };
        found.or_else(|| {
            (3 * usable >= 2 * self.count_shown() && fits_nowhere())
                .then(|| format!("the detected markers do not fit this wing; {OTHER_AIRCRAFT}"))
        })
    }

    /// Diagnoses a ground frame that does not fit the orientation of the other frames; one sentence.
    pub(crate) fn diagnose_misfit(&self, detections: &[Detection]) -> Option<String> {
        let size = |i: &Identities| {
            [Estimate {
                value: i.tip_deflection_m,
                sigma: None,
            }]
        };
        let bent = self
            .identify_most(detections)
            .filter(|i| is_bent(i.tip_deflection_m, self.setup));
        bent.map(|i| Cause::Bend.describe(&size(&i), self.setup, false))
            .or_else(|| self.diagnose_frame(detections))
    }

    /// Identifies the frame; `None` if fewer than two thirds of the markers or of the detections are identified.
    pub(super) fn identify_most(&self, detections: &[Detection]) -> Option<Identities> {
        let found = self.identify_markers(detections).ok()?;
        let possible = detections
            .iter()
            .filter(|d| is_usable(d))
            .count()
            .min(self.setup.markers.len());
        (3 * found.pairs().len() >= 2 * possible).then_some(found)
    }
}
