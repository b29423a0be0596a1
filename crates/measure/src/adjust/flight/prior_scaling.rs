//! Scales default priors: estimates the size of the skin motion, the wing vibration and the camera shake from a flight's
//! frames.

use super::frames::Flight;
use super::solving::SolvedFlight;
use super::tuning::{VarianceEvidence, is_settled};
use crate::adjust::prior_scales::PriorScales;
use crate::setup::SetupUncertainty;
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
    all.fold(
        VarianceEvidence {
            square: 0.0,
            redundancy: 0.0,
        },
        |a, b| VarianceEvidence {
            square: a.square + b.square,
            redundancy: a.redundancy + b.redundancy,
        },
    )
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
        let PriorScales {
            skin,
            vibration,
            shake,
            ..
        } = self.prior_scales;
        is_settled(before.skin, skin)
            && is_settled(before.vibration, vibration)
            && is_settled(before.shake, shake)
    }

    /// Remarks about motions that are much larger than the default.
    pub fn exceedance_remarks(&self) -> impl Iterator<Item = String> {
        let priors = &self.input.setup.uncertainty;
        let SetupUncertainty {
            vibration, shake, ..
        } = *priors;
        let skin_motion_m = priors[Width::SkinMotion];
        let PriorScales {
            skin,
            vibration: wing,
            shake: camera,
            ..
        } = self.prior_scales;
        let skin = (skin > REMARKED_SCALE).then(|| {
            format!(
                "the skin moved by about {:.1} mm at each marker in flight (default {:.1} mm, wing.skin_motion_m); standard \
                 deviations were increased accordingly",
                1e3 * skin * skin_motion_m,
                1e3 * skin_motion_m
            )
        });
        let wing = (wing > REMARKED_SCALE).then(|| {
            format!(
                "the wing vibrated by about {:.0} mm during readout (default {:.0} mm, wing.vibration); standard deviations were \
                 increased accordingly",
                1e3 * wing * vibration.amplitude,
                1e3 * vibration.amplitude
            )
        });
        let camera = (camera > REMARKED_SCALE).then(|| {
            format!(
                "the camera shook by about {:.2} mrad during readout (default {:.2} mrad); standard deviations were increased \
                 accordingly. Check the camera mount",
                1e3 * camera * shake.amplitude,
                1e3 * shake.amplitude
            )
        });
        skin.into_iter().chain(wing).chain(camera)
    }
}
