//! Before an installation: resolution on the wing, depth of field, predicted uncertainty of a layout
//! of markers (docs/model.md).

mod draft;
mod fixed_marks;
mod optics;
mod prediction;
mod resolution;
mod terms;
mod view;
mod want;

pub use draft::{Draft, best as best_layout, layout};
pub use optics::{Optics, OpticsPlan};
pub use prediction::{Alternative, Change, Expected, MarkerSigma, Prediction, TipSigma};
use resolution::facing;
pub use resolution::{Footprint, Skin, footprint};
pub use want::{Answer, Remedy, Requirement, Source, answer, attitude, predict_precision};

use nalgebra::Vector3;
use serde::Serialize;

use super::adjust::{AdjustError, Observation, Options};
use super::setup::{Orientation, Setup};
use prediction::SimulatedFlight;

/// What is assumed of the flight to come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Deflection of the outermost marker, m.
    pub tip_deflection_m: f64,
    /// Standard deviation of each image coordinate, px.
    pub pixel_sigma: f64,
    /// Lens and sensor, for depth of field and diffraction.
    pub optics: Option<Optics>,
    /// Terms of the curvature.
    pub curvature_terms: usize,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self { tip_deflection_m: 2.5, pixel_sigma: 0.1, optics: None, curvature_terms: 8 }
    }
}

/// Resolution and size of one marker's image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MarkerPlan {
    /// Survey id.
    pub id: String,
    /// `quadrant` or `circle`.
    pub shape: &'static str,
    /// Along the span from the projection centre, on ground, m.
    pub span_m: f64,
    /// From the projection centre, on ground, m.
    pub distance_m: f64,
    /// On the sensor, on ground and in flight.
    pub visible: bool,
    /// On ground.
    pub ground: Footprint,
    /// In flight, the skin sloping with the bending.
    pub flight: Footprint,
    /// Extent of the marker's image along and across the view on ground, px.
    pub image_px: [f64; 2],
    /// Diameter of the blur disc on ground where the wing's markers are focused best, px; `None` without the lens.
    pub blur_px: Option<f64>,
    /// Predicted standard deviations.
    pub sigma: Option<MarkerSigma>,
}

/// A point along the span.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SpanPlan {
    /// From the projection centre, m.
    pub span_m: f64,
    /// On ground.
    pub ground: Footprint,
    /// Standard deviation of the deflection of the bending axis, m.
    pub sigma_deflection_m: Option<f64>,
    /// Standard deviation of the twist, degrees.
    pub sigma_twist_deg: Option<f64>,
}

/// All that can be said beforehand.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// Horizontal, vertical and diagonal angle of view, degrees.
    pub field_of_view_deg: [f64; 3],
    /// Mean camera constant, px.
    pub focal_px: f64,
    /// Assumed deflection of the tip, m.
    pub tip_deflection_m: f64,
    /// Assumed standard deviation of an image coordinate, px.
    pub pixel_sigma: f64,
    /// Every marker of the survey.
    pub markers: Vec<MarkerPlan>,
    /// From the bending root to the outermost marker.
    pub span: Vec<SpanPlan>,
    /// Where the lens was described.
    pub optics: Option<OpticsPlan>,
    /// Predicted uncertainty, and what one marker more or less changes.
    pub prediction: Option<Prediction>,
    /// What a person should read.
    pub remarks: Vec<String>,
}

/// Points of [`Plan::span`].
const SPAN_POINTS: usize = 33;
/// Smallest image of a circle that is measured well, px across its small axis.
const MIN_IMAGE_PX: f64 = 5.0;
/// Largest blur disc, px across, with which a mark is still measured: a quarter of it, as a disc's standard deviation is, is two
/// thirds of the greatest blur that detection takes, which is for lens and motion beside it.
const MAX_BLUR_PX: f64 = 8.0;

/// Plans an installation. Without an orientation the camera is taken to look at the middle of the wing.
/// Fails where the survey gives no wing at all.
pub fn plan(
    setup: &Setup,
    orientation: Option<&Orientation>,
    options: &PlanOptions,
) -> Result<Plan, AdjustError> {
    let rehearsal = SimulatedFlight::new(setup, orientation, options)?;
    let (prediction, failure) = match rehearsal.predict() {
        Ok(prediction) => (Some(prediction), None),
        Err(error) => (None, Some(format!("no uncertainty can be predicted: {error}"))),
    };
    let mut markers = markers(setup, &rehearsal, prediction.as_ref());
    let optics = options.optics.map(|o| {
        // Marks that are rigid to the cabin stand so near that the wing would be out of focus for their sake.
        let seen = |wanted: &dyn Fn(bool) -> bool| -> Vec<f64> {
            let seen = markers.iter().zip(&setup.markers).filter(|(m, s)| m.visible && wanted(s.fixed));
            seen.map(|(m, _)| m.distance_m).collect()
        };
        let mut distances = seen(&|fixed| !fixed);
        if distances.is_empty() {
            distances = seen(&|_| true);
        }
        let (nearest, farthest) =
            distances.iter().fold((f64::INFINITY, 0.0), |(n, f): (f64, f64), d| (n.min(*d), f.max(*d)));
        OpticsPlan::new(&o, nearest, farthest)
    });
    for marker in &mut markers {
        marker.blur_px = optics.map(|optics| optics.blur_px(marker.distance_m));
    }
    let mut plan = Plan {
        field_of_view_deg: field_of_view_deg(setup),
        focal_px: setup.lens.focal_px(),
        tip_deflection_m: options.tip_deflection_m,
        pixel_sigma: options.pixel_sigma,
        span: span(setup, &rehearsal.skin, &markers, prediction.as_ref()),
        markers,
        optics,
        prediction,
        remarks: failure.into_iter().collect(),
    };
    let remarks = remarks(&plan);
    plan.remarks.extend(remarks);
    Ok(plan)
}

fn field_of_view_deg(setup: &Setup) -> [f64; 3] {
    let lens = &setup.lens;
    let (x, y) = (0.5 * f64::from(lens.width) / lens.fx, 0.5 * f64::from(lens.height) / lens.fy);
    [x, y, x.hypot(y)].map(|tangent| (2.0 * tangent.atan()).to_degrees())
}

fn markers(setup: &Setup, rehearsal: &SimulatedFlight, prediction: Option<&Prediction>) -> Vec<MarkerPlan> {
    let c = setup.lens.focal_px();
    let one = |(index, marker): (usize, &super::setup::SurveyMarker)| {
        let ground = rehearsal.ground[index];
        let flight = rehearsal.flight[index];
        let covers = |point: &Vector3<f64>, slope: f64| {
            if marker.fixed { facing(point, c) } else { footprint(point, slope, c) }
        };
        let on_ground = covers(&ground, rehearsal.skin.slope(ground.x));
        let seen = |o: &Observation| o.marker == index;
        MarkerPlan {
            id: marker.id.clone(),
            shape: marker.shape.name(),
            span_m: ground.x,
            distance_m: ground.norm(),
            visible: rehearsal.observations.iter().any(seen)
                && rehearsal.orientation.ground.iter().any(|g| g.marker == index),
            flight: covers(&flight, rehearsal.slope_at(&flight)),
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

fn span(
    setup: &Setup,
    skin: &Skin,
    markers: &[MarkerPlan],
    prediction: Option<&Prediction>,
) -> Vec<SpanPlan> {
    let tip = markers.iter().fold(0.0, |tip: f64, m| tip.max(m.span_m));
    let root = setup.root_offset_m.max(0.0);
    let point = |k: usize| {
        let span_m = root + (tip - root) * k as f64 / (SPAN_POINTS - 1) as f64;
        let curve = prediction.and_then(|p| p.at(span_m));
        SpanPlan {
            span_m,
            ground: footprint(
                &Vector3::new(span_m, skin.height_m(span_m), 0.0),
                skin.slope(span_m),
                setup.lens.focal_px(),
            ),
            sigma_deflection_m: curve.map(|c| c.0),
            sigma_twist_deg: curve.and_then(|c| c.1),
        }
    };
    (0..SPAN_POINTS).map(point).collect()
}

fn remarks(plan: &Plan) -> Vec<String> {
    let mut remarks = Vec::new();
    let ids = |wanted: &dyn Fn(&MarkerPlan) -> bool| {
        let found: Vec<&str> = plan.markers.iter().filter(|m| wanted(m)).map(|m| m.id.as_str()).collect();
        (!found.is_empty()).then(|| found.join(", "))
    };
    if let Some(hidden) = ids(&|m| !m.visible) {
        remarks.push(format!(
            "outside the picture on ground or in flight: {hidden}; turn the camera or move the markers"
        ));
    }
    if let Some(small) = ids(&|m| m.shape == "circle" && m.image_px[0] < MIN_IMAGE_PX) {
        remarks.push(format!(
            "image less than {MIN_IMAGE_PX} px along the view: {small}; use larger circles or a higher camera"
        ));
    }
    if let Some(soft) = ids(&|m| m.blur_px.is_some_and(|px| px > MAX_BLUR_PX)) {
        remarks.push(format!(
            "out of focus by more than {MAX_BLUR_PX} px, which is more than is measured: {soft}; stop down, or put \
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

/// Options of the rehearsed adjustment: exact observations, so that nothing is rejected or chosen.
fn adjustment_options(options: &PlanOptions) -> Options {
    Options {
        sigma: super::adjust::SigmaKind::Prior,
        curvature_terms: Some(options.curvature_terms),
        snooping_alpha: 0.0,
        ..Options::default()
    }
}
