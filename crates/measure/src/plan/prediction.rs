//! Predicted precision: the covariance of an adjustment of exact, simulated observations.

use std::sync::Arc;

use nalgebra::{Matrix2, Vector3};
use serde::Serialize;

use super::precision::{
    LayoutPrecision, MarkerSigma, TipSigma, layout_precision, marker_sigmas, tip_sigma,
};
use super::view::{bend_markers, camera_attitude};
use super::{PlanOptions, SkinProfile, adjustment_options};
use crate::adjust::flight_prior::FlightPrior;
use crate::adjust::ground::GroundShape;
use crate::adjust::{self, AdjustError, AdjustResult, Mounting, Observation, Options, Solution};
use crate::environment::apparent_point;
use crate::points;
use crate::setup::{Orientation, Setup};

/// Predicted uncertainty of a layout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayoutPrediction {
    pub redundancy: usize,
    /// Precision of the layout as planned.
    pub expected: LayoutPrecision,
    /// Precision of the tip marker's deflection.
    pub tip: Option<TipSigma>,
    /// Uncertainty budget of the reported deflection, largest contribution first.
    pub budget: Vec<adjust::VarianceShare>,
    /// Precision of every visible marker.
    pub markers: Vec<MarkerSigma>,
    /// Torsion pairs of the installation: name, standard deviations of angle and twist, degrees.
    pub torsion: Vec<(String, Option<f64>, Option<f64>)>,
    pub pitch_bending_correlation: Option<f64>,
}

/// Lowest deflection of a flight's frames over the highest: from full tanks at taxi speed to a gust.
const MIN_DEFLECTION_FRACTION: f64 = 0.4;

/// A simulated flight with exact observations.
pub struct SimulatedFlight<'a> {
    pub setup: &'a Setup,
    options: &'a PlanOptions,
    /// Markers on the ground, wing frame, m.
    pub ground: Vec<Vector3<f64>>,
    /// Markers in flight, wing frame, m.
    pub flight: Vec<Vector3<f64>>,
    /// Attitude of the camera, with the observations of the ground frame.
    pub orientation: Orientation,
    /// Exact images of the visible markers.
    pub observations: Vec<Observation>,
    /// Height and slope of the skin along the span on the ground.
    pub skin: SkinProfile,
    a_per_m: f64,
}

impl<'a> SimulatedFlight<'a> {
    /// Bends the wing as a tapered beam under an elliptic load until the outermost marker has the deflection of the
    /// options. The covariance depends only weakly on the load's shape.
    ///
    /// # Errors
    /// Returns an error if the survey gives no wing.
    pub fn new(
        setup: &'a Setup,
        orientation: Option<&Orientation>,
        options: &'a PlanOptions,
    ) -> AdjustResult<Self> {
        let shape = GroundShape::new(setup, &[])?;
        let ground: Vec<_> = shape.stations.iter().map(|s| s.surveyed_m).collect();
        let flight = bend_markers(setup, &shape, options.tip_deflection_m);
        let reach = |p: &Vector3<f64>| (p.x - setup.root_offset_m).max(0.0);
        let wing = setup.wing_markers();
        let tip = wing.iter().map(|(_, p)| reach(p)).fold(0.0, f64::max);
        let a_per_m = if tip > 0.0 {
            options.tip_deflection_m / (tip * tip)
        } else {
            0.0
        };
        let skin = SkinProfile::from_points(&wing.into_iter().map(|(_, p)| p).collect::<Vec<_>>());
        let mut simulation = Self {
            setup,
            options,
            orientation: Orientation {
                camera_from_survey: camera_attitude(&ground, &flight)
                    * shape.frame.wing_from_survey,
                covariance_rad2: None,
                ground: Vec::new(),
                templates: vec![],
            },
            ground,
            flight,
            observations: Vec::new(),
            skin,
            a_per_m,
        };
        if let Some(known) = orientation {
            simulation.orientation = known.clone();
        }
        simulation.take_frames();
        Ok(simulation)
    }

    /// Simulates the ground frame, unless the orientation has one, and the frame in flight.
    fn take_frames(&mut self) {
        let covariance_px2 = |marker: usize| {
            let least = if self.setup.is_point(marker) {
                points::TYPICAL_SIGMA_PX
            } else {
                0.0
            };
            Matrix2::identity() * self.options.pixel_sigma.max(least).powi(2)
        };
        let turn = &self.orientation.camera_from_survey;
        let see = |p: &Vector3<f64>, in_flight| {
            let survey = self.setup.wing_frame().wing_from_survey.inverse() * p;
            let pixel = self.setup.lens.project(&apparent_point(
                self.setup.window.as_ref(),
                turn,
                &survey,
                in_flight,
            ))?;
            self.setup.lens.contains(&pixel).then_some(pixel)
        };
        // A ground frame, taken or simulated for another layout, shows by itself which markers are large enough.
        let shown = |marker: usize| self.orientation.ground.iter().any(|o| o.marker == marker);
        let large = |marker: &usize| shown(*marker) || self.is_large_enough(*marker);
        let flight = self
            .flight
            .iter()
            .enumerate()
            .filter(|(marker, _)| large(marker));
        let observations: Vec<_> = flight
            .filter_map(|(marker, p)| {
                Some(Observation {
                    marker,
                    pixel: see(p, true)?,
                    covariance_px2: covariance_px2(marker),
                })
            })
            .collect();
        // A ground frame that was taken determines which markers are observed, and with which covariance. Its own errors
        // do not matter: the simulated observations are exact.
        let taken = &self.orientation.ground;
        let covariance = |marker: usize| match taken.iter().find(|image| image.marker == marker) {
            Some(image) => Some(image.covariance_px2),
            None => taken.is_empty().then(|| covariance_px2(marker)),
        };
        let observe = |(marker, p): (usize, &Vector3<f64>)| {
            Some(Observation {
                marker,
                covariance_px2: covariance(marker)?,
                pixel: see(p, false)?,
            })
        };
        let ground = self
            .ground
            .iter()
            .enumerate()
            .filter(|(marker, _)| large(marker))
            .filter_map(observe)
            .collect();
        (self.observations, self.orientation.ground) = (observations, ground);
    }

    /// Returns the slope of the skin in flight.
    pub fn slope_at(&self, flight: &Vector3<f64>) -> f64 {
        self.skin.slope(flight.x)
            + 2.0 * self.a_per_m * (flight.x - self.setup.root_offset_m).max(0.0)
    }

    /// Predicts the uncertainty of the frame.
    ///
    /// # Errors
    /// Returns an error if the layout cannot be adjusted.
    pub fn predict_layout(&self) -> AdjustResult<LayoutPrediction> {
        let solution = self.adjust_frame()?;
        let degrees = |e: Option<adjust::Estimate>| e.and_then(|e| e.sigma).map(f64::to_degrees);
        Ok(LayoutPrediction {
            redundancy: solution.redundancy,
            expected: self.layout_precision(&solution)?,
            tip: tip_sigma(&solution, self.setup),
            budget: solution
                .budget
                .iter()
                .flat_map(|budget| budget.shares.clone())
                .collect(),
            markers: marker_sigmas(&solution, self.setup),
            torsion: solution
                .torsion
                .iter()
                .map(|t| (t.name.clone(), degrees(t.angle_rad), degrees(t.twist_rad)))
                .collect(),
            pitch_bending_correlation: solution.pitch_bending_correlation,
        })
    }

    /// Extracts the precision of a solution.
    ///
    /// # Errors
    /// Returns an error if the solution has no standard deviations.
    pub fn layout_precision(&self, solution: &Solution) -> AdjustResult<LayoutPrecision> {
        layout_precision(solution, self.setup)
            .ok_or_else(|| AdjustError::Input("the adjustment gives no standard deviations".into()))
    }

    /// Adjusts the frame alone, or as many frames of one mounting together.
    ///
    /// # Errors
    /// Returns an error if the layout cannot be adjusted.
    pub fn adjust(
        &self,
        frames: usize,
        flight_prior: Option<&FlightPrior>,
    ) -> AdjustResult<Solution> {
        match (frames, flight_prior) {
            (..=1, None) => self.adjust_frame(),
            _ => self.adjust_flight(frames, flight_prior),
        }
    }

    fn adjust_frame(&self) -> AdjustResult<Solution> {
        adjust::solve_spatial(
            self.setup,
            &self.orientation,
            &self.observations,
            &adjustment_options(),
        )
    }

    /// Adjusts `frames` frames of one mounting together, and returns the solution of the frame with the largest
    /// deflection. The tip deflections range from [`MIN_DEFLECTION_FRACTION`] of the deflection to all of it.
    /// `flight_prior`: prior from earlier flights.
    fn adjust_flight(
        &self,
        frames: usize,
        flight_prior: Option<&FlightPrior>,
    ) -> AdjustResult<Solution> {
        let share = |k: usize| {
            1.0 - (1.0 - MIN_DEFLECTION_FRACTION) * k as f64 / (frames.max(2) - 1) as f64
        };
        let deflections = (0..frames.max(1)).map(|k| self.options.tip_deflection_m * share(k));
        let seen = deflections.map(|tip_deflection_m| {
            let options = PlanOptions {
                tip_deflection_m,
                ..*self.options
            };
            let frame = SimulatedFlight::new(self.setup, Some(&self.orientation), &options)?;
            Ok(frame.observations)
        });
        let seen: Vec<Vec<Observation>> = seen.collect::<AdjustResult<_>>()?;
        let mountings = Some(vec![Mounting::Numbered(0); seen.len()]);
        let flight_prior = flight_prior.map(|flight_prior| Arc::new(flight_prior.at_nominal()));
        let options = Options {
            mountings,
            flight_prior,
            ..adjustment_options()
        };
        // Observations without noise would show that nothing moves.
        let mut setup = self.setup.clone();
        setup.uncertainty = setup.uncertainty.without_frame_scaling();
        match &seen[..] {
            [one] => adjust::solve_spatial(&setup, &self.orientation, one, &options),
            _ => {
                let solutions = adjust::solve_flight(&setup, &self.orientation, &seen, &options)?;
                let first = solutions.into_iter().next();
                first.ok_or_else(|| AdjustError::Input("the flight has no frame".into()))
            }
        }
    }
}
