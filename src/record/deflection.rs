//! The tip's deflection is counted from three places; one of them is shown, with what its variance comes from.

use serde::{Deserialize, Serialize};

use super::MarkerRecord;
use crate::measure::adjust;

/// Against what a deflection is counted.
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

/// Sigma of a deflection below this share of another's tells better: less shows in no figure of two digits.
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
            let of = |tip: &Tip| {
                tip.deflection(reference).and_then(|deflection| deflection.1).map(|sigma| sigma * sigma)
            };
            tips.clone().map(of).sum::<Option<f64>>()
        };
        let better = |best: Self, other: Self| {
            let both = variance(other).zip(variance(best));
            if both.is_some_and(|(other, best)| other < BETTER * BETTER * best) { other } else { best }
        };
        Self::ALL.into_iter().reduce(better).unwrap_or_default()
    }
}

/// Deflection of the outermost used marker.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tip {
    /// Its id.
    pub marker: String,
    /// Against the survey, m, positive up.
    pub deflection_m: f64,
    /// m.
    pub sigma_deflection_m: Option<f64>,
    /// Against the ground frame, m; `None` with the profile method and in results of older programs.
    pub deflection_ground_m: Option<f64>,
    /// m.
    pub sigma_deflection_ground_m: Option<f64>,
    /// From the root's tangent, m.
    pub deflection_root_m: Option<f64>,
    /// m.
    pub sigma_deflection_root_m: Option<f64>,
    /// Which of them the frame tells best: the one that is shown, and whose variance the budget splits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
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
    /// One of its deflections with its standard deviation, m.
    pub fn deflection(&self, reference: Reference) -> Option<(f64, Option<f64>)> {
        match reference {
            Reference::Survey => Some((self.deflection_m, self.sigma_deflection_m)),
            Reference::Ground => Some((self.deflection_ground_m?, self.sigma_deflection_ground_m)),
            Reference::Root => Some((self.deflection_root_m?, self.sigma_deflection_root_m)),
        }
    }
}

impl MarkerRecord {
    /// One of its deflections, and its standard deviation, m.
    pub fn deflection(&self, reference: Reference) -> (Option<f64>, Option<f64>) {
        match reference {
            Reference::Survey => (self.deflection_m, self.sigma_deflection_m),
            Reference::Ground => (self.deflection_ground_m, self.sigma_deflection_ground_m),
            Reference::Root => (self.deflection_root_m, self.sigma_deflection_root_m),
        }
    }
}

/// A source's part of the variance of the tip's deflection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetShare {
    /// In the field's words (docs/adjustment/standard-deviations.md).
    pub source: String,
    /// 0 to 1; those of a result add up to 1.
    pub share: f64,
    /// Standard deviation of the deflection if the source were known without error, m; left out for observations.
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
            sigma_deflection_m: Some(survey),
            deflection_ground_m: ground.map(|_| 1.0),
            sigma_deflection_ground_m: ground,
            deflection_root_m: root.map(|_| 1.0),
            sigma_deflection_root_m: root,
            ..Tip::default()
        }
    }

    #[test]
    fn the_deflection_that_all_frames_have_and_tell_best_is_shown() {
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
        let tip: Tip =
            serde_json::from_str(r#"{"marker":"M19","deflection_m":2.9,"sigma_deflection_m":0.006}"#)
                .unwrap();
        assert_eq!((tip.deflection_ground_m, tip.reference), (None, None));
        assert_eq!(tip.deflection(Reference::Survey), Some((2.9, Some(0.006))));
    }
}
