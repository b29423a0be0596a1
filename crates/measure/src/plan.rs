//! Planning of an installation: resolution on the wing, depth of field, predicted uncertainty of a layout of markers
//! (docs/model.md).

mod draft;
mod fixed_targets;
mod measurable;
mod narrow_widths;
mod optics;
mod precision;
mod prediction;
mod requirement;
mod resolution;
mod view;

pub use draft::{LayoutDraft, best_layout, even_layout};
pub use narrow_widths::{NarrowWidth, find_narrow_widths};
pub use optics::{Optics, OpticsPlan};
pub use precision::{LayoutPrecision, MarkerSigma, TipSigma};
pub use prediction::LayoutPrediction;
pub use requirement::{
    Remedy, Requirement, RequirementResult, assumed_attitude, check_requirement, predict_precision,
};
pub use resolution::{Footprint, SkinProfile, skin_footprint};

use serde::Serialize;

use super::adjust::{AdjustResult, Options};
use super::setup::{Orientation, Setup};
use prediction::SimulatedFlight;

/// Assumptions about the planned flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Deflection of the outermost marker, m.
    pub tip_deflection_m: f64,
    /// Standard deviation of each image coordinate, px.
    pub pixel_sigma: f64,
    /// Lens and sensor, for depth of field and diffraction.
    pub optics: Option<Optics>,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            tip_deflection_m: 2.5,
            pixel_sigma: 0.1,
            optics: None,
        }
    }
}

/// Resolution and image size of a marker.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MarkerPlan {
    /// Id in the survey.
    pub id: String,
    /// Kind of marker: `quadrant` or `circle`.
    pub shape: &'static str,
    /// Span from the projection centre, on the ground, m.
    pub span_m: f64,
    /// Distance from the projection centre, on the ground, m.
    pub distance_m: f64,
    /// Whether the marker can be measured on the ground and in flight: it is on the sensor, and large enough.
    pub visible: bool,
    /// Whether its image is too small or too flat on the ground or in flight.
    #[serde(skip)]
    pub too_small: bool,
    /// Footprint of a pixel on the ground.
    pub ground: Footprint,
    /// Footprint of a pixel in flight, on the sloped skin.
    pub flight: Footprint,
    /// Extent of the marker's image along and across the view, on the ground, px.
    pub image_px: [f64; 2],
    /// Diameter of the blur disc on the ground with the best focus for the wing's markers, px; `None` without data of the
    /// lens.
    pub blur_px: Option<f64>,
    /// Predicted standard deviations.
    pub sigma: Option<MarkerSigma>,
}

/// Plan of an installation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InstallationPlan {
    /// Horizontal, vertical and diagonal angle of view, degrees.
    pub field_of_view_deg: [f64; 3],
    /// Mean focal length, px.
    pub focal_px: f64,
    /// Assumed deflection of the tip, m.
    pub tip_deflection_m: f64,
    /// Assumed standard deviation of an image coordinate, px.
    pub pixel_sigma: f64,
    /// Markers of the survey.
    pub markers: Vec<MarkerPlan>,
    /// Depth of field and diffraction, if data of the lens are given.
    pub optics: Option<OpticsPlan>,
    /// Predicted uncertainty.
    pub prediction: Option<LayoutPrediction>,
    /// Remarks for the user.
    pub remarks: Vec<String>,
}

/// Smallest image of a circle that is measured well, px across its small axis.
const MIN_IMAGE_PX: f64 = 5.0;
/// Largest blur disc with which a marker is measured, px across: the standard deviation of a disc is a quarter of its
/// diameter, and this is two thirds of the largest blur of detection, which includes lens and motion.
const MAX_BLUR_PX: f64 = 8.0;

/// Plans an installation. Without an orientation the camera looks at the middle of the wing.
///
/// # Errors
/// Returns an error if the survey gives no wing.
pub fn plan_installation(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
) -> AdjustResult<InstallationPlan> {
    let simulation = SimulatedFlight::new(setup, orientation, options)?;
    let (prediction, failure) = match simulation.predict_layout() {
        Ok(prediction) => (Some(prediction), None),
        Err(error) => (
            None,
            Some(format!("the uncertainty cannot be predicted: {error}")),
        ),
    };
    let mut markers = plan_markers(setup, &simulation, prediction.as_ref());
    let optics = options.optics.map(|o| {
        // Fixed targets are so near that focusing on them would blur the wing.
        let seen = |select: &dyn Fn(bool) -> bool| -> Vec<f64> {
            let seen = markers
                .iter()
                .zip(&setup.markers)
                .filter(|(m, s)| m.visible && select(s.fixed));
            seen.map(|(m, _)| m.distance_m).collect()
        };
        let mut distances = seen(&|fixed| !fixed);
        if distances.is_empty() {
            distances = seen(&|_| true);
        }
        let (nearest, farthest) = distances
            .iter()
            .fold((f64::INFINITY, 0.0), |(n, f): (f64, f64), d| {
                (n.min(*d), f.max(*d))
            });
        OpticsPlan::new(&o, nearest, farthest)
    });
    for marker in &mut markers {
        marker.blur_px = optics.map(|optics| optics.blur_px(marker.distance_m));
    }
    let mut plan = InstallationPlan {
        field_of_view_deg: field_of_view_deg(setup),
        focal_px: setup.lens.focal_px(),
        tip_deflection_m: options.tip_deflection_m,
        pixel_sigma: options.pixel_sigma,
        markers,
        optics,
        prediction,
        remarks: failure.into_iter().collect(),
    };
    let remarks = layout_fault_remarks(&plan);
    plan.remarks.extend(remarks);
    Ok(plan)
}

fn field_of_view_deg(setup: &Setup) -> [f64; 3] {
    let lens = &setup.lens;
    let (x, y) = (
        0.5 * f64::from(lens.width) / lens.fx,
        0.5 * f64::from(lens.height) / lens.fy,
    );
    [x, y, x.hypot(y)].map(|tangent| (2.0 * tangent.atan()).to_degrees())
}

/// Predicts footprint and size in the image, visibility and standard deviation of each marker.
fn plan_markers(
    setup: &Setup,
    simulation: &SimulatedFlight,
    prediction: Option<&LayoutPrediction>,
) -> Vec<MarkerPlan> {
    let one = |(index, marker): (usize, &super::setup::SurveyMarker)| {
        let ground = simulation.ground[index];
        let [on_ground, in_flight] = simulation.footprints(index);
        MarkerPlan {
            id: marker.id.clone(),
            shape: marker.shape.name(),
            span_m: ground.x,
            distance_m: ground.norm(),
            visible: simulation.is_measured(index),
            too_small: !simulation.is_large_enough(index),
            flight: in_flight,
            image_px: [
                1e3 * marker.diameter_m / on_ground.spanwise_mm,
                1e3 * marker.diameter_m / on_ground.streamwise_mm,
            ],
            ground: on_ground,
            blur_px: None,
            sigma: prediction.and_then(|p| p.markers.iter().find(|m| m.marker == index).copied()),
        }
    };
    setup.markers.iter().enumerate().map(one).collect()
}

fn layout_fault_remarks(plan: &InstallationPlan) -> Vec<String> {
    let mut remarks = Vec::new();
    let ids = |select: &dyn Fn(&MarkerPlan) -> bool| {
        let found: Vec<&str> = plan
            .markers
            .iter()
            .filter(|m| select(m))
            .map(|m| m.id.as_str())
            .collect();
        (!found.is_empty()).then(|| found.join(", "))
    };
    if let Some(hidden) = ids(&|m| !m.visible && !m.too_small) {
        remarks.push(format!(
            "outside the image on the ground or in flight: {hidden}; turn the camera or move the markers"
        ));
    }
    if let Some(lost) = ids(&|m| !m.visible && m.too_small) {
        remarks.push(format!(
            "too small or too flat to be measured, {}: {lost}; use larger prints, a longer lens or a higher camera",
            "on the ground or in flight"
        ));
    }
    if let Some(small) = ids(&|m| m.shape == "circle" && m.image_px[0] < MIN_IMAGE_PX) {
        remarks.push(format!(
            "image smaller than {MIN_IMAGE_PX} px along the view: {small}; use larger circles or a higher camera"
        ));
    }
    if let Some(soft) = ids(&|m| m.blur_px.is_some_and(|px| px > MAX_BLUR_PX)) {
        remarks.push(format!(
            "out of focus by more than {MAX_BLUR_PX} px, too much for a measurement: {soft}; stop down, or put \
             them farther from the camera"
        ));
    }
    if let Some(optics) = plan.optics.as_ref().filter(|o| !o.sharp) {
        remarks.push(format!(
            "the depth of field does not cover the markers: the blur disc is {:.1} um at both ends when focused at \
             {:.1} m; stop down or allow a larger circle of confusion",
            optics.blur_um, optics.best_focus_m
        ));
    }
    remarks
}

/// Returns the options of the simulated adjustment: with exact observations, nothing is rejected or selected.
fn adjustment_options() -> Options {
    Options {
        sigma: super::adjust::SigmaKind::Prior,
        snooping_alpha: 0.0,
        ..Options::default()
    }
}
