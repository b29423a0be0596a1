//! Torsion of the marker pairs with the paper's method.

use super::response::MarkerFunction;
use super::{ProfileAdjustment, ProfileMarker};
use crate::adjust::{Estimate, PairTorsion};
use crate::setup::TorsionPair;

impl ProfileAdjustment<'_> {
    /// Change of the angle of attack from the deflections of two markers (paper, section 4.3).
    pub(super) fn torsions(&self, placed: &[ProfileMarker], scale: f64) -> Vec<PairTorsion> {
        let find =
            |marker| Some(&placed[self.observations.iter().position(|o| o.marker == marker)?]);
        let pair = |pair: &TorsionPair| {
            let (leading, trailing) = (find(pair.leading)?, find(pair.trailing)?);
            let markers = &self.geometry.setup.markers;
            let ground = markers[pair.leading].position_m - markers[pair.trailing].position_m;
            let base = ground.xy().norm();
            let difference = leading.deflection_m - trailing.deflection_m;
            let c = |f: &MarkerFunction, g: &MarkerFunction| self.response.covariance(f, g);
            let variance = c(&leading.deflection, &leading.deflection)
                + c(&trailing.deflection, &trailing.deflection)
                - 2.0 * c(&leading.deflection, &trailing.deflection);
            let by_difference = base / (base * base + difference * difference);
            let sigma = Some(scale * variance.max(0.0).sqrt() * by_difference);
            Some(Estimate {
                value: difference.atan2(base),
                sigma,
            })
        };
        let pairs = self.geometry.setup.torsion.iter();
        pairs
            .map(|p| PairTorsion {
                name: p.name.clone(),
                angle_rad: pair(p),
                ..PairTorsion::default()
            })
            .collect()
    }
}
