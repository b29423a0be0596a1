//! A marker's deflections, counted from three places, and what they answer to.

use nalgebra::Vector3;

use super::Outcome;
use crate::adjust::Reference;
use crate::adjust::marker_state::MarkerState;
use crate::adjust::scene::moved;
use crate::estimation::Gradient;

impl Outcome<'_> {
    /// Of one deflection of a marker that was seen.
    pub fn deflection_gradient(&self, marker: usize, reference: Reference) -> Option<Gradient> {
        let block = self.block_of(marker)?;
        let (ground, state) = self.state(block);
        let mut all = self.gradient(3, &[marker]);
        let up = Vector3::y();
        self.add(&mut all, block, &state, &[up; 3], &[-up; 3]);
        self.add_references(&mut all, &state, &(state.carried.position_m - ground), [0, 1, 2]);
        Some(all.single_function(reference as usize))
    }

    /// Deflections against survey, ground frame and the root's tangent, m; `None` for a fixed mark.
    pub(super) fn deflections(&self, state: &MarkerState, ground: &Vector3<f64>) -> Option<[f64; 3]> {
        let root_m = self.values.by_root_m(&state.from_root_m?).y;
        let deflection = state.carried.position_m.y - ground.y;
        let against_ground = deflection - moved(&self.values.moved_on_ground_m, state.marker).y;
        Some([deflection, against_ground, against_ground - root_m])
    }

    /// What sets the three deflections apart, and along what they are counted: their functions' further derivatives.
    pub(super) fn add_references(
        &self,
        gradient: &mut Gradient,
        state: &MarkerState,
        displacement_m: &Vector3<f64>,
        [survey, ground, root]: [usize; 3],
    ) {
        for (placed, k) in self.layout.unknowns() {
            let mut put = |function, by| self.layout.put(gradient, placed.place, k, function, by);
            let leaning = placed.term.along_vertical(k, displacement_m);
            let on_ground = placed.term.ground(k, state.marker).y;
            put(survey, leaning);
            put(ground, leaning - on_ground);
            put(root, leaning - on_ground);
        }
        for placed in &self.layout.root {
            for k in 0..placed.term.size {
                self.layout.put(gradient, placed.place, k, root, -placed.term.position(k, state).y);
            }
        }
    }
}
