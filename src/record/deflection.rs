//! Deflection of the wing tip relative to three references, the reference that is reported, and its variance budget.

use serde::{Deserialize, Serialize};

use super::MarkerRecord;
use crate::measure::adjust;

/// Reference that a deflection is measured from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reference {
    #[default]
    Survey,
    /// The wing in the ground frame, which may have been bent since the survey.
    Ground,
    /// The root's tangent, which may have rotated and moved since the ground frame.
    Root,
}

/// Largest ratio of standard deviations at which another reference replaces the preferred one: a smaller gain is not
/// visible in two digits.
const MIN_SIGMA_RATIO: f64 = 0.99;

impl Reference {
    /// References in order of preference if their standard deviations are equal.
    pub const ALL: [Self; 3] = [Self::Survey, Self::Ground, Self::Root];

    /// Returns the reference in words, for a caption.
    pub fn description(self) -> &'static str {
        match self {
            Self::Survey => "against the survey",
            Self::Ground => "against the ground frame",
            Self::Root => "from the root's tangent",
        }
    }

    /// Selects the reference with the smallest mean variance among those that all tips have.
    ///
    /// The survey is preferred, then the ground frame: another reference replaces it only if its standard deviation is
    /// smaller by more than 1 %.
    pub fn most_precise<'a>(tips: impl Iterator<Item = &'a Tip> + Clone) -> Self {
        let variance = |reference: Self| {
            let of =
                |tip: &Tip| tip.deflection(reference).and_then(|deflection| deflection.1).map(|sigma| sigma * sigma);
            tips.clone().map(of).sum::<Option<f64>>()
        };
        let better = |best: Self, other: Self| {
            let both = variance(other).zip(variance(best));
            if both.is_some_and(|(other, best)| other < MIN_SIGMA_RATIO * MIN_SIGMA_RATIO * best) {
                other
            } else {
                best
            }
        };
        Self::ALL.into_iter().reduce(better).unwrap_or_default()
    }
}

/// Deflection of the outermost used marker.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tip {
    /// Survey id of the marker.
    pub marker: String,
    /// Deflection relative to the survey, m, positive up.
    pub deflection_m: f64,
    pub sigma_deflection_m: Option<f64>,
    /// Deflection relative to the ground frame, m; `None` with the profile method and in results of older programs.
    pub deflection_ground_m: Option<f64>,
    pub sigma_deflection_ground_m: Option<f64>,
    /// Deflection relative to the root's tangent, m.
    pub deflection_root_m: Option<f64>,
    pub sigma_deflection_root_m: Option<f64>,
    /// Reference with the smallest standard deviation in this frame: it is the reported one, and the budget splits its
    /// variance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
}

impl From<adjust::DeflectionReference> for Reference {
    fn from(of: adjust::DeflectionReference) -> Self {
        match of {
            adjust::DeflectionReference::Survey => Self::Survey,
            adjust::DeflectionReference::Ground => Self::Ground,
            adjust::DeflectionReference::Root => Self::Root,
        }
    }
}

impl Tip {
    /// Returns the deflection relative to `reference` and its standard deviation, m.
    pub fn deflection(&self, reference: Reference) -> Option<(f64, Option<f64>)> {
        match reference {
            Reference::Survey => Some((self.deflection_m, self.sigma_deflection_m)),
            Reference::Ground => Some((self.deflection_ground_m?, self.sigma_deflection_ground_m)),
            Reference::Root => Some((self.deflection_root_m?, self.sigma_deflection_root_m)),
        }
    }
}

impl MarkerRecord {
    /// Returns the deflection relative to `reference` and its standard deviation, m.
    pub fn deflection(&self, reference: Reference) -> (Option<f64>, Option<f64>) {
        match reference {
            Reference::Survey => (self.deflection_m, self.sigma_deflection_m),
            Reference::Ground => (self.deflection_ground_m, self.sigma_deflection_ground_m),
            Reference::Root => (self.deflection_root_m, self.sigma_deflection_root_m),
        }
    }
}

/// Contribution of one error source to the variance of the tip's deflection.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BudgetShare {
    /// Name of the source (docs/adjustment/standard-deviations.md).
    pub source: String,
    /// Fraction of the variance, 0 to 1; the fractions of a result add up to 1.
    pub share: f64,
    /// Standard deviation of the deflection if the source had no error, m; omitted for observations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_if_known_m: Option<f64>,
}

impl From<&adjust::VarianceShare> for BudgetShare {
    fn from(one: &adjust::VarianceShare) -> Self {
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
    fn the_most_precise_deflection_common_to_all_frames_is_reported() {
        let of = |tips: &[Tip]| Reference::most_precise(tips.iter());
        assert_eq!(of(&[]), Reference::Survey);
        assert_eq!(of(&[tip(0.01, Some(0.003), Some(0.002))]), Reference::Root);
        assert_eq!(of(&[tip(0.01, Some(0.003), Some(0.00299))]), Reference::Ground, "no better in two digits");
        assert_eq!(of(&[tip(0.01, Some(0.01), Some(0.01))]), Reference::Survey);
        let older = tip(0.01, None, None);
        assert_eq!(of(&[tip(0.01, Some(0.003), Some(0.002)), older]), Reference::Survey, "not all have it");
    }

    #[test]
    fn a_tip_of_an_older_program_is_read() {
        let tip: Tip =
            serde_json::from_str(r#"{"marker":"M19","deflection_m":2.9,"sigma_deflection_m":0.006}"#).unwrap();
        assert_eq!((tip.deflection_ground_m, tip.reference), (None, None));
        assert_eq!(tip.deflection(Reference::Survey), Some((2.9, Some(0.006))));
    }
}
