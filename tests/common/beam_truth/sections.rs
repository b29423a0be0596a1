//! Motions of the true wing's sections.

use nalgebra::Vector3;

use super::{BentAxis, Truth, value_at};

impl Truth {
    /// Motion of the sections at fractions of the length: displacement of the axis (survey frame, m), change of slope, twist,
    /// rad.
    pub fn section_motions(
        &self,
        etas: &[f64],
        tip_deflection_m: f64,
        fuel: f64,
    ) -> Vec<(Vector3<f64>, f64, f64)> {
        let w = self.wing;
        let scale = self.setup.thermal.map_or(1.0, |t| t.scale());
        let (curvature, factor) = self.load_curvature(tip_deflection_m, fuel);
        let (bent, straight) = (
            w.bend(&curvature, factor, scale),
            w.bend(&curvature, 0.0, 1.0),
        );
        let survey_from_wing = self.setup.wing_frame().wing_from_survey.inverse();
        let moved = |values: fn(&BentAxis) -> &Vec<f64>, e: f64| {
            value_at(values(&bent), e) - value_at(values(&straight), e)
        };
        let motion = |&e: &f64| {
            let displacement = Vector3::new(moved(|b| &b.x, e), moved(|b| &b.y, e), 0.0);
            let twist = tip_deflection_m / 2.5 * w.twist_tip_rad * e.powf(w.twist_power);
            (
                survey_from_wing * displacement,
                moved(|b| &b.theta, e),
                twist,
            )
        };
        etas.iter().map(motion).collect()
    }
}
