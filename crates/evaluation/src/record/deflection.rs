//! Deflection of the wing tip relative to three references, the reference that is reported, and its uncertainty budget.

use serde::{Deserialize, Serialize};

use super::{CurveRecord, MarkerRecord};
use wingd_measure::adjust::DeflectionReference;

/// Deflection of the outermost marker: the same in every frame, predicted by the adjusted shape where it is not measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tip {
    /// Survey id of the marker.
    pub marker: String,
    /// True if the marker was not used in this frame, so that the adjusted shape predicts it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub predicted: bool,
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
    pub reference: Option<DeflectionReference>,
}

impl Tip {
    /// Selects the reference with the smallest root mean square of the standard deviations, among those that all tips have.
    pub fn most_precise_reference<'a>(
        tips: impl Iterator<Item = &'a Self> + Clone,
    ) -> DeflectionReference {
        DeflectionReference::most_precise(|reference| {
            let variance = |tip: &Self| tip.deflection(reference)?.1.map(|sigma| sigma * sigma);
            tips.clone()
                .map(variance)
                .sum::<Option<f64>>()
                .map(f64::sqrt)
        })
    }

    /// Returns the marker's id, and whether it is predicted.
    pub fn label(&self) -> String {
        format!(
            "{}{}",
            self.marker,
            if self.predicted { ", predicted" } else { "" }
        )
    }

    /// Returns the deflection relative to `reference` and its standard deviation, m.
    pub fn deflection(&self, reference: DeflectionReference) -> Option<(f64, Option<f64>)> {
        let survey = Some(self.deflection_m);
        let (value, sigma) = [
            (survey, self.sigma_deflection_m),
            (self.deflection_ground_m, self.sigma_deflection_ground_m),
            (self.deflection_root_m, self.sigma_deflection_root_m),
        ][reference as usize];
        Some((value?, sigma))
    }
}

impl CurveRecord {
    /// Returns the deflection relative to `reference` and its standard deviation, m.
    pub fn deflection(&self, reference: DeflectionReference) -> Option<(f64, Option<f64>)> {
        let survey = Some(self.deflection_m);
        let (value, sigma) = [
            (survey, self.sigma_deflection_m),
            (self.deflection_ground_m, self.sigma_deflection_ground_m),
            (self.deflection_root_m, self.sigma_deflection_root_m),
        ][reference as usize];
        Some((value?, sigma))
    }
}

impl MarkerRecord {
    /// Returns the deflection relative to `reference` and its standard deviation, m.
    pub fn deflection(&self, reference: DeflectionReference) -> (Option<f64>, Option<f64>) {
        [
            (self.deflection_m, self.sigma_deflection_m),
            (self.deflection_ground_m, self.sigma_deflection_ground_m),
            (self.deflection_root_m, self.sigma_deflection_root_m),
        ][reference as usize]
    }
}

#[cfg(test)]
mod tests {
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
        let of = |tips: &[Tip]| Tip::most_precise_reference(tips.iter());
        assert_eq!(of(&[]), DeflectionReference::Survey);
        assert_eq!(
            of(&[tip(0.01, Some(0.003), Some(0.002))]),
            DeflectionReference::Root
        );
        assert_eq!(
            of(&[tip(0.01, Some(0.003), Some(0.00299))]),
            DeflectionReference::Ground,
            "no better in two digits"
        );
        assert_eq!(
            of(&[tip(0.01, Some(0.01), Some(0.01))]),
            DeflectionReference::Survey
        );
        let older = tip(0.01, None, None);
        assert_eq!(
            of(&[tip(0.01, Some(0.003), Some(0.002)), older]),
            DeflectionReference::Survey,
            "not all have it"
        );
    }

    #[test]
    fn a_tip_of_an_older_program_is_read() {
        let tip: Tip = serde_json::from_str(
            r#"{"marker":"M19","deflection_m":2.9,"sigma_deflection_m":0.006}"#,
        )
        .unwrap();
        assert_eq!((tip.deflection_ground_m, tip.reference), (None, None));
        assert_eq!(
            tip.deflection(DeflectionReference::Survey),
            Some((2.9, Some(0.006)))
        );
    }
}
