//! Torsion of the marker pairs.

use nalgebra::Vector3;

use super::FrameOutcome;
use crate::adjust::{Estimate, PairTorsion};
use crate::setup::TorsionPair;

impl FrameOutcome<'_> {
    /// Torsion of all pairs.
    pub(super) fn torsions(&self) -> Vec<PairTorsion> {
        let one = |pair: &TorsionPair| {
            let mut of_section = self.pair_section(pair).into_iter().flatten();
            let (slope_rad, twist_rad) = (of_section.next(), of_section.next());
            let (name, angle_rad) = (pair.name.clone(), self.torsion_angle(pair));
            PairTorsion {
                name,
                angle_rad,
                slope_rad,
                twist_rad,
                streamwise_twist_rad: of_section.next(),
            }
        };
        self.solved.input.setup.torsion.iter().map(one).collect()
    }

    /// Torsion angle from the deflections of the two markers (paper, section 4.3).
    fn torsion_angle(&self, pair: &TorsionPair) -> Option<Estimate> {
        let pair_markers = [pair.leading, pair.trailing];
        pair_markers
            .iter()
            .try_for_each(|&marker| self.block_with_image(marker).map(drop))?;
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
        let sigma = self
            .function_sigmas(&gradient)
            .first()
            .map(|s| s * by_difference);
        Some(Estimate {
            value: difference.atan2(base),
            sigma,
        })
    }

    /// Slope, twist and, if the flow's direction is known, streamwise twist of the section midway between the two stations.
    fn pair_section(&self, pair: &TorsionPair) -> Option<Vec<Estimate>> {
        let station = |m: usize| {
            self.solved
                .input
                .scene
                .ground
                .stations
                .get(m)
                .map(|s| s.arc_m)
        };
        let moved = self.moved_sections(vec![
            0.5 * (station(pair.leading)? + station(pair.trailing)?),
        ]);
        let functions = self.reported_functions(&moved.sections).split_off(1);
        let mut gradient = self.empty_gradient(functions.len(), &[]);
        self.add_section_functions(&mut gradient, &moved, &functions);
        Some(self.section_estimates(&gradient, &functions).concat())
    }
}
