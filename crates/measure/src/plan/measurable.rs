//! Markers of a simulated flight that can be measured: on the sensor, large and round enough.

use super::fixed_targets::TakenPlace;
use super::prediction::SimulatedFlight;
use super::resolution::facing_footprint;
use super::{Footprint, skin_footprint};
use crate::observation::Observation;
use crate::setup::{Shape, SurveyMarker};

/// Smallest image of a marker along the view that a plan counts on, px: half as large again as the limit of detection
/// (docs/detection.md), because light and blur vary.
const MIN_MEASURED_PX: f64 = 2.5;
/// Largest ratio of the axes of a marker's image (docs/detection.md).
const MAX_DISC_RATIO: f64 = 40.0;
const MAX_QUADRANT_RATIO: f64 = 26.0;

impl SimulatedFlight<'_> {
    /// Returns the footprint of a pixel on a marker on the ground and in flight.
    pub fn footprints(&self, marker: usize) -> [Footprint; 2] {
        let fixed = self.setup.markers.get(marker).is_some_and(|m| m.fixed);
        let (ground, flight) = (&self.ground[marker], &self.flight[marker]);
        [
            (ground, self.skin.slope(ground.x)),
            (flight, self.slope_at(flight)),
        ]
        .map(|(point, slope)| {
            let focal_px = self.setup.lens.focal_px();
            if fixed {
                facing_footprint(point, focal_px)
            } else {
                skin_footprint(point, slope, focal_px)
            }
        })
    }

    /// Returns whether a marker's image is large and round enough to be measured, on the ground and in flight. The structure
    /// of a point is as large as its patch.
    pub fn is_large_enough(&self, marker: usize) -> bool {
        let Some(SurveyMarker {
            shape, diameter_m, ..
        }) = self.setup.markers.get(marker)
        else {
            return false;
        };
        let flattest = if *shape == Shape::Quadrant {
            MAX_QUADRANT_RATIO
        } else {
            MAX_DISC_RATIO
        };
        self.footprints(marker).iter().all(|footprint| {
            (*shape == Shape::Point || 1e3 * diameter_m / footprint.spanwise_mm >= MIN_MEASURED_PX)
                && footprint.spanwise_mm <= flattest * footprint.streamwise_mm
        })
    }

    /// Returns whether a marker is observed on the ground and in flight.
    pub fn is_measured(&self, marker: usize) -> bool {
        let sees = |frame: &[Observation]| frame.iter().any(|o| o.marker == marker);
        sees(&self.observations) && sees(&self.orientation.ground)
    }

    /// Returns why the layout cannot be used whatever its standard deviations: the tip or too many markers are not
    /// measured.
    pub fn find_obstacle(&self) -> Option<String> {
        let wing = self.setup.wing_markers();
        let (tip, _) = wing.iter().max_by(|a, b| a.1.x.total_cmp(&b.1.x))?;
        let measured = wing
            .iter()
            .filter(|(marker, _)| self.is_measured(*marker))
            .count();
        let remedy = "use larger prints, another lens or a higher camera";
        if !self.is_measured(*tip) {
            let id = self
                .setup
                .markers
                .get(*tip)
                .map(|m| m.id.as_str())
                .unwrap_or_default();
            let cause = if self.is_large_enough(*tip) {
                "outside the image"
            } else {
                "too small or too flat in the image"
            };
            return Some(format!(
                "{id}, the outermost marker, is {cause} on the ground or in flight; {remedy}"
            ));
        }
        let count = wing.len();
        (3 * measured < 2 * count).then(|| {
            format!("only {measured} of {count} markers can be measured on the ground and in flight, two thirds are needed; {remedy}")
        })
    }

    /// Returns the places that the markers take in the image on the ground and in flight.
    pub fn taken_places(&self) -> Vec<TakenPlace> {
        let radius_px = |o: &Observation| {
            let diameter_m = self
                .setup
                .markers
                .get(o.marker)
                .map_or(0.0, |m| m.diameter_m);
            500.0 * diameter_m / self.footprints(o.marker)[0].streamwise_mm
        };
        self.observations
            .iter()
            .chain(&self.orientation.ground)
            .map(|o| (o.pixel, radius_px(o)))
            .collect()
    }
}
