//! Deflections of a marker relative to the three references, with derivatives.

use nalgebra::Vector3;

use super::FrameOutcome;
use crate::adjust::DeflectionReference;
use crate::adjust::marker_state::MarkerState;
use crate::adjust::scene::marker_displacement;
use crate::estimation::Gradient;

impl FrameOutcome<'_> {
    /// Gradient of a marker's deflection relative to `reference`.
    pub fn deflection_gradient(&self, marker: usize, reference: DeflectionReference) -> Gradient {
        let (ground, state) = self.ground_position_and_flight_state(marker);
        let mut all = self.empty_gradient(3, &[marker]);
        let up = Vector3::y();
        self.add_position(&mut all, &state, &[up; 3], &[-up; 3]);
        self.add_reference_derivatives(
            &mut all,
            &state,
            &(state.carried.position_m - ground),
            [0, 1, 2],
        );
        all.single_function(reference as usize)
    }

    /// Deflections relative to survey, ground frame and root tangent, m; `None` for a fixed target.
    pub fn marker_deflections(
        &self,
        state: &MarkerState,
        ground: &Vector3<f64>,
    ) -> Option<[f64; 3]> {
        let root_m = self.values.root_displacement_m(&state.from_root_m?).y;
        let deflection = state.carried.position_m.y - ground.y;
        let against_ground =
            deflection - marker_displacement(&self.values.moved_on_ground_m, state.marker).y;
        Some([deflection, against_ground, against_ground - root_m])
    }

    /// Adds the derivatives that distinguish the three deflections, and those with respect to the direction of the
    /// vertical.
    pub fn add_reference_derivatives(
        &self,
        gradient: &mut Gradient,
        state: &MarkerState,
        displacement_m: &Vector3<f64>,
        [survey, ground, root]: [usize; 3],
    ) {
        for (placed, k) in self.layout.unknowns() {
            let mut put = |function, by| {
                self.layout
                    .add_derivative(gradient, placed.scope, k, function, by)
            };
            let leaning = placed.term.vertical_derivative(k, displacement_m);
            let on_ground = placed.term.ground_derivative(k, state.marker).y;
            put(survey, leaning);
            put(ground, leaning - on_ground);
            put(root, leaning - on_ground);
        }
        for (placed, k) in self.layout.root_unknowns() {
            let by = placed.term.position_derivative(k, state).y;
            self.layout
                .add_derivative(gradient, placed.scope, k, root, -by);
        }
    }
}
