//! Scales default priors: estimates the size of the skin motion, the wing vibration and the camera shake from a flight's
//! frames.

use super::frames::Flight;
use super::solving::SolvedFlight;
use super::tuning::{VarianceEvidence, is_settled};
use crate::widths::{Unknown, Width};

/// Weight of the default as a number of observations. Aircraft differ from the default by about 50 %, which corresponds to
/// a variance known from four observations.
const DEFAULT_WEIGHT: f64 = 4.0;
/// Largest factor of a default. A flight that shows more than this has another cause than larger motion.
const MAX_SCALE: f64 = 10.0;
/// Factor of the default from which a remark is added; aircraft differ by about 50 %.
const REMARKED_SCALE: f64 = 1.5;

/// Computes the factor of a default prior standard deviation from the evidence of its unknowns, computed with the factor
/// `before`; the default counts as [`DEFAULT_WEIGHT`] observations.
fn tuned_prior_scale(before: f64, evidence: VarianceEvidence) -> f64 {
    let square = evidence.square + DEFAULT_WEIGHT / (before * before);
    (before * (square / (evidence.redundancy + DEFAULT_WEIGHT)).sqrt()).min(MAX_SCALE)
}

fn sum_evidence(all: impl Iterator<Item = VarianceEvidence>) -> VarianceEvidence {
    let (mut square, mut redundancy) = (0.0, 0.0);
    for one in all {
        square += one.square;
        redundancy += one.redundancy;
    }
    VarianceEvidence { square, redundancy }
}

/// Evidence from an unknown with mean 0 and the prior standard deviation `sigma`.
fn parameter_evidence(value: f64, variance: f64, sigma: f64) -> VarianceEvidence {
    let weight = 1.0 / (sigma * sigma);
    VarianceEvidence {
        square: value * value * weight,
        redundancy: 1.0 - variance * weight,
    }
}

impl SolvedFlight {
    /// Evidence for the size of the skin motion, for the prior standard deviation `sigma_m`.
    fn skin_evidence(&self, flight: &Flight, sigma_m: f64) -> VarianceEvidence {
        let Some(layout) = self.flight_problem.layouts.first() else {
            return sum_evidence(std::iter::empty());
        };
        let on_the_wing =
            (0..flight.input.setup.markers.len()).filter(|k| !flight.input.scene.is_fixed(*k));
        let columns = on_the_wing.flat_map(|marker| layout.motions.columns(marker));
        sum_evidence(
            columns.map(|c| {
                parameter_evidence(self.fit.global[c], self.fit.covariance[(c, c)], sigma_m)
            }),
        )
    }

    /// Evidence from an unknown of each frame.
    fn unknown_evidence(&self, unknown: Unknown) -> VarianceEvidence {
        let frames = self.flight_problem.layouts.iter().zip(&self.fit.groups);
        sum_evidence(frames.flat_map(|(layout, group)| {
            let own = layout.frame_columns(unknown);
            own.map(|(column, sigma)| {
                parameter_evidence(
                    group.local[column],
                    group.covariance[(column, column)],
                    sigma,
                )
            })
        }))
    }
}

impl Flight<'_> {
    /// Sets default priors to the size that the frames show (Koch's estimate of one variance component each, with the
    /// default as earlier observations). Returns whether they changed only little.
    pub fn tune_prior_scales(&mut self, solved: &SolvedFlight) -> bool {
        if !self.hyperparameters.mountings.are_assigned() {
            return true;
        }
        let priors = &self.input.setup.uncertainty;
        let skin_motion_m = priors[Width::SkinMotion];
        let before = self.prior_scales;
        if priors.skin_scaled_by_frames && skin_motion_m > 0.0 {
            self.prior_scales.skin = tuned_prior_scale(
                before.skin,
                solved.skin_evidence(self, before.skin * skin_motion_m),
            );
        }
        if priors.vibration.scaled_by_frames {
            self.prior_scales.vibration = tuned_prior_scale(
                before.vibration,
                solved.unknown_evidence(Unknown::WingVibration),
            );
        }
        if priors.shake.scaled_by_frames {
            self.prior_scales.shake =
                tuned_prior_scale(before.shake, solved.unknown_evidence(Unknown::CameraShake));
        }
        let after = self.prior_scales;
        is_settled(before.skin, after.skin)
            && is_settled(before.vibration, after.vibration)
            && is_settled(before.shake, after.shake)
    }

    /// Remarks about motions that are much larger than the default.
    pub fn exceedance_remarks(&self) -> impl Iterator<Item = String> {
        let (priors, scales) = (&self.input.setup.uncertainty, self.prior_scales);
        let motions = [
            (
                "skin moved at each marker",
                scales.skin,
                priors[Width::SkinMotion],
                "mm",
            ),
            (
                "wing vibrated during readout",
                scales.vibration,
                priors.vibration.amplitude,
                "mm",
            ),
            (
                "camera shook during readout",
                scales.shake,
                priors.shake.amplitude,
                "mrad",
            ),
        ];
        let exceeding = motions
            .into_iter()
            .filter(|(_, scale, ..)| *scale > REMARKED_SCALE);
        exceeding.map(|(motion, scale, default, unit)| {
            format!(
                "the {motion} by about {:.2} {unit} (default {:.2} {unit}); standard deviations were increased accordingly",
                1e3 * scale * default,
                1e3 * default
            )
        })
    }
}
