//! The tip's lift is counted from three places; one of them is shown, with what its variance comes from.

use serde::{Deserialize, Serialize};

use super::MarkerRecord;
use crate::measure::adjust;

/// Against what a lift is counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reference {
    /// The survey.
    #[default]
    Survey,
    /// The wing in the ground frame, which may have been bent since the survey.
    Ground,
    /// The root's tangent, which may have turned and moved since the ground frame.
    Root,
}

/// Sigma of a lift below this share of another's tells better: less shows in no figure of two digits.
const BETTER: f64 = 0.99;

impl Reference {
    /// All of them, in the order in which they are preferred where sigma is alike.
    pub const ALL: [Self; 3] = [Self::Survey, Self::Ground, Self::Root];

    /// In words, for a caption.
    pub fn words(self) -> &'static str {
        match self {
            Self::Survey => "against the survey",
            Self::Ground => "against the ground frame",
            Self::Root => "from the root's tangent",
        }
    }

    /// The one that frames have in common and that their set-up tells best: the survey, or the ground frame or the root's
    /// tangent where the mean of their variances is smaller, their standard deviation by more than a hundredth.
    pub fn of<'a>(tips: impl Iterator<Item = &'a Tip> + Clone) -> Self {
        let variance = |reference: Self| {
            let of = |tip: &Tip| tip.lift(reference).and_then(|lift| lift.1).map(|sigma| sigma * sigma);
            tips.clone().map(of).sum::<Option<f64>>()
        };
        let better = |best: Self, other: Self| {
            let both = variance(other).zip(variance(best));
            if both.is_some_and(|(other, best)| other < BETTER * BETTER * best) { other } else { best }
        };
        Self::ALL.into_iter().reduce(better).unwrap_or_default()
    }
}

/// Lift of the outermost used marker.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tip {
    /// Its id.
    pub marker: String,
    /// Against the survey, m, positive up.
    pub lift_m: f64,
    /// m.
    pub sigma_lift_m: Option<f64>,
    /// Against the ground frame, m; `None` with the profile method and in results of older programs.
    pub lift_ground_m: Option<f64>,
    /// m.
    pub sigma_lift_ground_m: Option<f64>,
    /// From the root's tangent, m.
    pub lift_root_m: Option<f64>,
    /// m.
    pub sigma_lift_root_m: Option<f64>,
    /// Which of them the frame tells best: the one that is shown, and whose variance the budget splits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown: Option<Reference>,
}

impl From<adjust::Reference> for Reference {
    fn from(of: adjust::Reference) -> Self {
        match of {
            adjust::Reference::Survey => Self::Survey,
            adjust::Reference::Ground => Self::Ground,
            adjust::Reference::Root => Self::Root,
        }
    }
}

impl Tip {
    /// One of its lifts with its standard deviation, m.
    pub fn lift(&self, reference: Reference) -> Option<(f64, Option<f64>)> {
        match reference {
            Reference::Survey => Some((self.lift_m, self.sigma_lift_m)),
            Reference::Ground => Some((self.lift_ground_m?, self.sigma_lift_ground_m)),
            Reference::Root => Some((self.lift_root_m?, self.sigma_lift_root_m)),
        }
    }
}

impl MarkerRecord {
    /// One of its lifts, and its standard deviation, m.
    pub fn lift(&self, reference: Reference) -> (Option<f64>, Option<f64>) {
        match reference {
            Reference::Survey => (self.lift_m, self.sigma_lift_m),
            Reference::Ground => (self.lift_ground_m, self.sigma_lift_ground_m),
            Reference::Root => (self.lift_root_m, self.sigma_lift_root_m),
        }
    }
}

/// A source's part of the variance of the tip's lift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetShare {
    /// In the field's words (docs/adjustment/standard-deviations.md).
    pub source: String,
    /// 0 to 1; those of a result add up to 1.
    pub share: f64,
    /// Standard deviation of the lift if the source were known without error, m; left out for observations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_if_known_m: Option<f64>,
}

impl From<&adjust::BudgetShare> for BudgetShare {
    fn from(one: &adjust::BudgetShare) -> Self {
        Self { source: one.source.into(), share: one.share, sigma_if_known_m: one.sigma_if_known_m }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn tip(survey: f64, ground: Option<f64>, root: Option<f64>) -> Tip {
        Tip {
            sigma_lift_m: Some(survey),
            lift_ground_m: ground.map(|_| 1.0),
            sigma_lift_ground_m: ground,
            lift_root_m: root.map(|_| 1.0),
            sigma_lift_root_m: root,
            ..Tip::default()
        }
    }

    #[test]
    fn the_lift_that_all_frames_have_and_tell_best_is_shown() {
        let of = |tips: &[Tip]| Reference::of(tips.iter());
        assert_eq!(of(&[]), Reference::Survey);
        assert_eq!(of(&[tip(0.01, Some(0.003), Some(0.002))]), Reference::Root);
        assert_eq!(
            of(&[tip(0.01, Some(0.003), Some(0.00299))]),
            Reference::Ground,
            "no better in two digits"
        );
        assert_eq!(of(&[tip(0.01, Some(0.01), Some(0.01))]), Reference::Survey);
        let older = tip(0.01, None, None);
        assert_eq!(of(&[tip(0.01, Some(0.003), Some(0.002)), older]), Reference::Survey, "not all have it");
    }

    #[test]
    fn a_tip_of_an_older_program_is_read() {
        let tip: Tip = serde_json::from_str(r#"{"marker":"M19","lift_m":2.9,"sigma_lift_m":0.006}"#).unwrap();
        assert_eq!((tip.lift_ground_m, tip.shown), (None, None));
        assert_eq!(tip.lift(Reference::Survey), Some((2.9, Some(0.006))));
    }
}
