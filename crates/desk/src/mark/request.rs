//! Requests of the marking page, checked and converted to manual marks.

use nalgebra::{Matrix2, Vector2};
use serde::Deserialize;

use super::{MarkRefusal, OpenImage, Workplace};
use wingd_base::clock::{Clock, SystemClock};
use wingd_evaluation::installation::{ManualObservation, ManualPosition, POINT_SIGMA_PX};
use wingd_evaluation::pipeline::manual_observations::{mark_position, observation_from_mark};
use wingd_measure::adjust::Observation;
use wingd_store::manual_marks::{ManualMark, MarkAction, MarkPosition, MarkSource};

/// Maximum lengths of a name and of a reason, characters.
const MAX_NAME_AND_REASON: (usize, usize) = (100, 500);

/// Request posted by the marking page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkRequest {
    pub act: MarkRequestKind,
    /// Id of the marker.
    pub id: String,
    /// Position of the marker's centre in the image, px; with `place`.
    pub u_px: Option<f64>,
    pub v_px: Option<f64>,
    /// Whether to use the position as given, without measurement by the detector.
    #[serde(default)]
    pub exact: bool,
    /// New id of the marker; with `rename`.
    pub to: Option<String>,
    /// Whether the mark may replace a detection or a mark of somebody else.
    #[serde(default)]
    pub over: bool,
    /// Name of the person who marks.
    pub who: String,
    /// Reason.
    #[serde(default)]
    pub why: String,
}

/// Action of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkRequestKind {
    /// Sets the position of the marker's centre.
    Place,
    /// Excludes the marker's observation.
    Reject,
    /// Withdraws the manual mark of the marker.
    Withdraw,
    /// Assigns the marker's observation to another marker.
    Rename,
}

impl MarkRequest {
    /// Returns the marks that the request adds.
    pub(super) fn to_marks(
        &self,
        at: &Workplace,
        open: &OpenImage,
        clock: &SystemClock,
    ) -> Result<Vec<ManualMark>, MarkRefusal> {
        let (who, why) = (
            single_line(&self.who, MAX_NAME_AND_REASON.0),
            single_line(&self.why, MAX_NAME_AND_REASON.1),
        );
        if who.is_empty() {
            return Err(MarkRefusal::Invalid(
                "give your name: it is stored with each mark".into(),
            ));
        }
        if why.is_empty() && [MarkRequestKind::Reject, MarkRequestKind::Rename].contains(&self.act)
        {
            return Err(MarkRefusal::Invalid(
                "give a reason: it is stored with each rejected or renamed marker".into(),
            ));
        }
        let image = at
            .images
            .get(open.number)
            .ok_or(MarkRefusal::NotFound)?
            .name
            .clone();
        let mark = |id: &str, act: MarkAction| ManualMark {
            image: image.clone(),
            frame_sha256: open.digest.clone(),
            id: id.to_owned(),
            act,
            who: who.clone(),
            at: Some(clock.stamp().utc),
            why: why.clone(),
        };
        let work = MarkRequestContext {
            workplace: at,
            open,
            before: at.storage.image_marks(&image),
            who: &who,
        };
        work.survey_marker_index(&self.id)?;
        match self.act {
            MarkRequestKind::Place => Ok(vec![mark(
                &self.id,
                MarkAction::Place(work.measure_position(self)?),
            )]),
            MarkRequestKind::Reject => Ok(vec![mark(&self.id, MarkAction::Reject)]),
            MarkRequestKind::Withdraw if work.existing_mark(&self.id).is_none() => Err(
                MarkRefusal::Invalid(format!("{} has no manual mark to withdraw", self.id)),
            ),
            MarkRequestKind::Withdraw => Ok(vec![mark(&self.id, MarkAction::Withdraw)]),
            MarkRequestKind::Rename => {
                let to = self.to.as_deref().filter(|to| *to != self.id);
                let to =
                    to.ok_or_else(|| MarkRefusal::Invalid("give the new id of the marker".into()))?;
                let place = work.known_position(&self.id)?;
                work.check_replaceable(to, self.over)?;
                Ok(vec![
                    mark(to, MarkAction::Place(place)),
                    mark(&self.id, MarkAction::Reject),
                ])
            }
        }
    }
}

/// Converts a text to a single line of at most `max_chars` characters.
fn single_line(text: &str, max_chars: usize) -> String {
    let flat = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    flat.take(max_chars).collect::<String>().trim().to_owned()
}

struct MarkRequestContext<'a> {
    workplace: &'a Workplace,
    open: &'a OpenImage,
    /// Effective marks of this image.
    before: Vec<ManualMark>,
    who: &'a str,
}

impl MarkRequestContext<'_> {
    fn survey_marker_index(&self, id: &str) -> Result<usize, MarkRefusal> {
        let found = self
            .workplace
            .installation
            .setup
            .markers
            .iter()
            .position(|m| m.id == id);
        found.ok_or_else(|| MarkRefusal::Invalid(format!("marker \"{id}\" is not in the survey")))
    }

    /// Returns the manual mark that the image already has under an id.
    fn existing_mark(&self, id: &str) -> Option<&ManualMark> {
        self.before.iter().find(|mark| mark.id == id)
    }

    /// Returns the detected observation of a marker.
    fn detected_observation(&self, index: usize) -> Option<&Observation> {
        self.open
            .unmarked
            .observations
            .iter()
            .find(|o| o.marker == index)
    }

    /// Checks that the request replaces nothing without confirmation.
    fn check_replaceable(&self, id: &str, over: bool) -> Result<(), MarkRefusal> {
        let detected = self
            .detected_observation(self.survey_marker_index(id)?)
            .is_some();
        match self.existing_mark(id) {
            _ if over => Ok(()),
            Some(mark) if mark.who != self.who => {
                let who = if mark.who.is_empty() {
                    "Somebody"
                } else {
                    &mark.who
                };
                Err(MarkRefusal::NeedsConfirmation(format!(
                    "{who} has already marked {id}. Replace that mark with yours?"
                )))
            }
            None if detected => Err(MarkRefusal::NeedsConfirmation(format!(
                "{id} is detected in this image. Replace the detection with your mark?"
            ))),
            _ => Ok(()),
        }
    }

    /// Returns the requested position, measured by the detector if that succeeds.
    fn measure_position(&self, request: &MarkRequest) -> Result<MarkPosition, MarkRefusal> {
        let setup = &self.workplace.installation.setup;
        let index = self.survey_marker_index(&request.id)?;
        let at = request
            .u_px
            .zip(request.v_px)
            .map(|(u, v)| Vector2::new(u, v));
        let at = at.filter(|at| at.iter().all(|v| v.is_finite()) && setup.lens.contains(at));
        let at = at.ok_or_else(|| {
            MarkRefusal::Invalid("give a position within the image: u_px and v_px".into())
        })?;
        self.check_replaceable(&request.id, request.over)?;
        let is_point = setup.is_point(index);
        let fit = if request.exact || is_point {
            None
        } else {
            self.refine_marker_position(index, at)
        };
        // A corner is seen more exactly than the middle of a disc.
        let most = if is_point {
            POINT_SIGMA_PX
        } else {
            f64::INFINITY
        };
        let sigma = self.workplace.manual_sigma_px.min(most);
        let manual = ManualPosition {
            pixel: at,
            covariance_px2: Matrix2::identity() * sigma * sigma,
        };
        let source = if fit.is_some() {
            MarkSource::Fit
        } else {
            MarkSource::Manual
        };
        Ok(mark_position(&fit.unwrap_or(manual), source))
    }

    fn refine_marker_position(&self, index: usize, at: Vector2<f64>) -> Option<ManualPosition> {
        let installation = &self.workplace.installation;
        let others = self
            .before
            .iter()
            .filter_map(|mark| observation_from_mark(mark, &installation.setup));
        let others: Vec<ManualObservation> = others.filter(|o| o.marker != index).collect();
        let result = self.open.session.solve(&others, installation);
        self.open.session.refine_position(
            &result,
            installation,
            (index, at),
            self.workplace.manual_sigma_px,
        )
    }

    /// Returns the marked or detected position of a marker.
    fn known_position(&self, id: &str) -> Result<MarkPosition, MarkRefusal> {
        if let Some(ManualMark {
            act: MarkAction::Place(place),
            ..
        }) = self.existing_mark(id)
        {
            return Ok(*place);
        }
        let none = || {
            MarkRefusal::Invalid(format!(
                "{id} has no observation in this image: there is nothing to rename"
            ))
        };
        let detected = self
            .detected_observation(self.survey_marker_index(id)?)
            .filter(|_| self.existing_mark(id).is_none())
            .ok_or_else(none)?;
        let at = ManualPosition {
            pixel: detected.pixel,
            covariance_px2: detected.covariance_px2,
        };
        Ok(mark_position(&at, MarkSource::Renamed))
    }
}
