//! Torsion of the marker pairs.

use nalgebra::Vector3;

use super::FrameOutcome;
use crate::adjust::beam::BeamGrid;
use crate::adjust::{Estimate, PairTorsion};
use crate::setup::TorsionPair;

impl FrameOutcome<'_> {
    /// Torsion of all pairs.
    pub(super) fn torsions(&self) -> Vec<PairTorsion> {
        let one = |pair: &TorsionPair| PairTorsion {
            name: pair.name.clone(),
            angle_rad: self.torsion_angle(pair),
            twist_rad: self.section_twist(pair),
        };
        self.solved.input.setup.torsion.iter().map(one).collect()
    }

    /// Torsion angle from the deflections of the two markers (paper, section 4.3).
    fn torsion_angle(&self, pair: &TorsionPair) -> Option<Estimate> {
        let pair_markers = [pair.leading, pair.trailing];
        pair_markers.iter().try_for_each(|&marker| self.block_with_image(marker).map(drop))?;
        let markers = &self.solved.input.setup.markers;
        let baseline = markers[pair.leading].position_m - markers[pair.trailing].position_m;
        let base = baseline.xy().norm();
        let mut gradient = self.empty_gradient(1, &pair_markers);
        let mut difference = 0.0;
        for (marker, sign) in pair_markers.into_iter().zip([1.0, -1.0]) {
            let (ground, state) = self.ground_position_and_flight_state(marker);
            difference += sign * (state.carried.position_m.y - ground.y);
            let up = Vector3::y() * sign;
            self.add_position(&mut gradient, &state, &[up], &[-up]);
        }
        let by_difference = base / (base * base + difference * difference);
        let sigma = self.function_sigmas(&gradient).first().map(|s| s * by_difference);
        Some(Estimate { value: difference.atan2(base), sigma })
    }

    /// Twist of the section midway between the two stations.
    fn section_twist(&self, pair: &TorsionPair) -> Option<Estimate> {
        let station = |m: usize| self.solved.input.scene.ground.stations.get(m).map(|s| s.arc_m);
        let arc = 0.5 * (station(pair.leading)? + station(pair.trailing)?);
        let grid = BeamGrid::new(&self.solved.input.scene.ground, &[arc]);
        let section = grid.bend(&self.values.bending()).pop()?;
        let mut gradient = self.empty_gradient(1, &[]);
        for (placed, k) in self.layout.unknowns() {
            self.layout.add_derivative(&mut gradient, placed.scope, k, 0, placed.term.twist_derivative(k, &section));
        }
        Some(Estimate { value: section.twist_rad, sigma: self.function_sigmas(&gradient).first().copied() })
    }
}
