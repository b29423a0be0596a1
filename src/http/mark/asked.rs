//! What a person says of a marker becomes marks here, or is turned down with a sentence.

use nalgebra::{Matrix2, Vector2};
use serde::Deserialize;

use super::{Open, Refused, Workplace};
use crate::clock::{Clock, SystemClock};
use crate::installation::{ManualObservation, ManualPosition};
use crate::measure::adjust::Observation;
use crate::pipeline::manual_observations::{observation, place};
use crate::store::manual_marks::{ManualMark, MarkAction, MarkSource, MarkPosition};

/// A name and a reason are not longer, characters.
const MAX_NAME_AND_REASON: (usize, usize) = (100, 500);

/// What is posted.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkRequest {
    /// What is to be done.
    pub act: MarkRequestKind,
    /// The marker.
    pub id: String,
    /// Where its centre is, px; with `place`.
    pub u_px: Option<f64>,
    /// px.
    pub v_px: Option<f64>,
    /// Whether it is just there: the detector does not measure.
    #[serde(default)]
    pub exact: bool,
    /// The name that it is to have; with `rename`.
    pub to: Option<String>,
    /// Whether it may stand for what was detected, or what somebody else marked.
    #[serde(default)]
    pub over: bool,
    /// Who says so.
    pub who: String,
    /// Why.
    #[serde(default)]
    pub why: String,
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkRequestKind {
    /// The marker's centre is here.
    Place,
    /// What is known of it is not to be used.
    Reject,
    /// What was said of it holds no more.
    Withdraw,
    /// What is known of it is of another marker.
    Rename,
}

impl MarkRequest {
    /// The marks that say so.
    pub(super) fn marks(&self, at: &Workplace, open: &Open, clock: &SystemClock) -> Result<Vec<ManualMark>, Refused> {
        let (who, why) = (line(&self.who, MAX_NAME_AND_REASON.0), line(&self.why, MAX_NAME_AND_REASON.1));
        if who.is_empty() {
            return Err(Refused::Wrong("say who you are: marks are kept with a name".into()));
        }
        if why.is_empty() && [MarkRequestKind::Reject, MarkRequestKind::Rename].contains(&self.act) {
            return Err(Refused::Wrong("say why: what is taken away is kept with a reason".into()));
        }
        let image = at.pictures.get(open.number).ok_or(Refused::NotFound)?.name.clone();
        let mark = |id: &str, act: MarkAction| ManualMark {
            image: image.clone(),
            frame_sha256: open.digest.clone(),
            id: id.to_owned(),
            act,
            who: who.clone(),
            at: Some(clock.stamp().utc),
            why: why.clone(),
        };
        let work = Work { at, open, before: at.kept.of(&image), who: &who };
        work.index(&self.id)?;
        match self.act {
            MarkRequestKind::Place => Ok(vec![mark(&self.id, MarkAction::Place(work.place(self)?))]),
            MarkRequestKind::Reject => Ok(vec![mark(&self.id, MarkAction::Reject)]),
            MarkRequestKind::Withdraw if work.own(&self.id).is_none() => {
                Err(Refused::Wrong(format!("nothing was said of {}", self.id)))
            }
            MarkRequestKind::Withdraw => Ok(vec![mark(&self.id, MarkAction::Withdraw)]),
            MarkRequestKind::Rename => {
                let to = self.to.as_deref().filter(|to| *to != self.id);
                let to = to.ok_or_else(|| Refused::Wrong("say which marker it is".into()))?;
                let place = work.known(&self.id)?;
                work.may_stand_for(to, self.over)?;
                Ok(vec![mark(to, MarkAction::Place(place)), mark(&self.id, MarkAction::Reject)])
            }
        }
    }
}

/// One line of so many characters.
fn line(text: &str, longest: usize) -> String {
    let flat = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    flat.take(longest).collect::<String>().trim().to_owned()
}

struct Work<'a> {
    at: &'a Workplace,
    open: &'a Open,
    /// Marks of this picture that count.
    before: Vec<ManualMark>,
    who: &'a str,
}

impl Work<'_> {
    fn index(&self, id: &str) -> Result<usize, Refused> {
        let found = self.at.installation.setup.markers.iter().position(|m| m.id == id);
        found.ok_or_else(|| Refused::Wrong(format!("marker \"{id}\" is not in the survey")))
    }

    fn own(&self, id: &str) -> Option<&ManualMark> {
        self.before.iter().find(|mark| mark.id == id)
    }

    /// What was detected of a marker.
    fn detected(&self, index: usize) -> Option<&Observation> {
        self.open.bare.observations.iter().find(|o| o.marker == index)
    }

    /// Nothing that is there is replaced unasked.
    fn may_stand_for(&self, id: &str, over: bool) -> Result<(), Refused> {
        let detected = self.detected(self.index(id)?).is_some();
        match self.own(id) {
            _ if over => Ok(()),
            Some(mark) if mark.who != self.who => {
                let who = if mark.who.is_empty() { "somebody" } else { &mark.who };
                Err(Refused::Asks(format!("{who} has marked {id}. Shall your mark stand for it?")))
            }
            None if detected => Err(Refused::Asks(format!(
                "{id} is detected in this picture. Shall your mark stand for that?"
            ))),
            _ => Ok(()),
        }
    }

    /// The place that is pointed at, measured by the detector where that holds.
    fn place(&self, asked: &MarkRequest) -> Result<MarkPosition, Refused> {
        let setup = &self.at.installation.setup;
        let index = self.index(&asked.id)?;
        let at = asked.u_px.zip(asked.v_px).map(|(u, v)| Vector2::new(u, v));
        let at = at.filter(|at| at.iter().all(|v| v.is_finite()) && setup.lens.contains(at));
        let at = at.ok_or_else(|| Refused::Wrong("give a place within the picture: u_px and v_px".into()))?;
        self.may_stand_for(&asked.id, asked.over)?;
        let fit = if asked.exact { None } else { self.fit(index, at) };
        let sigma = self.at.hand_sigma_px;
        let hand = ManualPosition { pixel: at, covariance_px2: Matrix2::identity() * sigma * sigma };
        let by = if fit.is_some() { MarkSource::Fit } else { MarkSource::Manual };
        Ok(place(&fit.unwrap_or(hand), by))
    }

    fn fit(&self, index: usize, at: Vector2<f64>) -> Option<ManualPosition> {
        let installation = &self.at.installation;
        let others = self.before.iter().filter_map(|mark| observation(mark, &installation.setup));
        let others: Vec<ManualObservation> = others.filter(|o| o.marker != index).collect();
        let said = self.open.desk.solve(&others, installation);
        self.open.desk.refined(&said, installation, (index, at), self.at.hand_sigma_px)
    }

    /// Where a marker is known to be.
    fn known(&self, id: &str) -> Result<MarkPosition, Refused> {
        if let Some(ManualMark { act: MarkAction::Place(place), .. }) = self.own(id) {
            return Ok(*place);
        }
        let none = || Refused::Wrong(format!("{id} is not seen in this picture: there is nothing to rename"));
        let detected = self.detected(self.index(id)?).filter(|_| self.own(id).is_none()).ok_or_else(none)?;
        let at = ManualPosition { pixel: detected.pixel, covariance_px2: detected.covariance_px2 };
        Ok(place(&at, MarkSource::Renamed))
    }
}
