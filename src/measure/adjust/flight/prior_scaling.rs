//! Usual widths that nobody stated: how large the skin's motion, the wing's vibration and the camera's shake are, a flight's
//! frames tell.

use super::frames::Flight;
use super::solving::Solved;
use super::tuning::{VarianceEvidence, is_settled};
use crate::adjust::factors::Factors;
use crate::adjust::terms::{SHAKE, VIBRATION};
use crate::setup::FlightEffectPriors;

/// What is usual counts as so many observations beside what frames show: aircraft differ from it by half, which is what so
/// many leave of a variance open.
const USUAL_WEIGHT: f64 = 4.0;
/// A flight that shows more than so many times what is usual is something else than a flight with larger motions.
const MAX_SCALE: f64 = 10.0;
/// Motions so many times what is usual are remarked: aircraft differ by half.
const DOUBTED: f64 = 1.5;

/// The factor that residuals show, where they were taken with the factor before.
fn posterior_scale(before: f64, shown: VarianceEvidence) -> f64 {
    let square = shown.square + USUAL_WEIGHT / (before * before);
    (before * (square / (shown.redundancy + USUAL_WEIGHT)).sqrt()).min(MAX_SCALE)
}

fn sum(all: impl Iterator<Item = VarianceEvidence>) -> VarianceEvidence {
    all.fold(VarianceEvidence { square: 0.0, redundancy: 0.0 }, |a, b| VarianceEvidence {
        square: a.square + b.square,
        redundancy: a.redundancy + b.redundancy,
    })
}

/// Of an unknown that is 0 as well as a standard deviation says.
fn shown(value: f64, variance: f64, sigma: f64) -> VarianceEvidence {
    let weight = 1.0 / (sigma * sigma);
    VarianceEvidence { square: value * value * weight, redundancy: 1.0 - variance * weight }
}

impl Solved {
    /// Of the skin's motion, which was taken this wide, m.
    fn skin_shown(&self, flight: &Flight, sigma_m: f64) -> VarianceEvidence {
        let Some(layout) = self.setting.layouts.first() else { return sum(std::iter::empty()) };
        let on_the_wing = (0..flight.input.setup.markers.len()).filter(|k| !flight.input.scene.is_fixed(*k));
        let columns = on_the_wing.flat_map(|marker| layout.motions.columns(marker));
        sum(columns.map(|c| shown(self.fit.global[c], self.fit.covariance[(c, c)], sigma_m)))
    }

    /// Of all frames' own terms of this name.
    fn own_shown(&self, name: &str) -> VarianceEvidence {
        let frames = self.setting.layouts.iter().zip(&self.fit.groups);
        sum(frames.flat_map(|(layout, group)| {
            let own = layout.own_of(name);
            own.map(|(column, sigma)| shown(group.local[column], group.covariance[(column, column)], sigma))
        }))
    }
}

impl Flight<'_> {
    /// Sets what nobody stated to what the frames show (Koch's estimate of one variance component each, with the usual width
    /// as earlier observations). Whether it changed little.
    pub fn tune_widths(&mut self, solved: &Solved) -> bool {
        if !self.assumed.mountings.are_found() {
            return true;
        }
        let FlightEffectPriors { skin_motion_m, skin_by_frames, vibration, shake, .. } =
            self.input.setup.uncertainty.in_flight;
        let before = self.factors;
        if skin_by_frames && skin_motion_m > 0.0 {
            self.factors.skin =
                posterior_scale(before.skin, solved.skin_shown(self, before.skin * skin_motion_m));
        }
        if vibration.by_frames {
            self.factors.vibration = posterior_scale(before.vibration, solved.own_shown(VIBRATION));
        }
        if shake.by_frames {
            self.factors.shake = posterior_scale(before.shake, solved.own_shown(SHAKE));
        }
        let Factors { skin, vibration, shake, .. } = self.factors;
        is_settled(before.skin, skin)
            && is_settled(before.vibration, vibration)
            && is_settled(before.shake, shake)
    }

    /// What is said of motions that are much larger than usual.
    pub fn exceedance_remarks(&self) -> impl Iterator<Item = String> {
        let FlightEffectPriors { skin_motion_m, vibration, shake, .. } =
            self.input.setup.uncertainty.in_flight;
        let Factors { skin, vibration: wing, shake: camera, .. } = self.factors;
        let skin = (skin > DOUBTED).then(|| {
            format!(
                "each marker's skin moved by some {:.1} mm in flight, {:.1} are usual (wing.skin_motion_m): standard \
                 deviations follow",
                1e3 * skin * skin_motion_m,
                1e3 * skin_motion_m
            )
        });
        let wing = (wing > DOUBTED).then(|| {
            format!(
                "the wing vibrated by some {:.0} mm while pictures were read out, {:.0} are usual (wing.vibration)",
                1e3 * wing * vibration.amplitude,
                1e3 * vibration.amplitude
            )
        });
        let camera = (camera > DOUBTED).then(|| {
            format!(
                "the camera shook by some {:.2} mrad while pictures were read out, {:.2} are usual: look at its mount",
                1e3 * camera * shake.amplitude,
                1e3 * shake.amplitude
            )
        });
        skin.into_iter().chain(wing).chain(camera)
    }
}
