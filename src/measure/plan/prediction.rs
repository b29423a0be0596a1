//! The adjustment rehearsed with exact observations: its covariance is the prediction.

use std::sync::Arc;

use nalgebra::{Matrix2, Vector3};
use serde::Serialize;

use super::view::{bent, looking_at, seen};
use super::{PlanOptions, Skin, adjustment_options, fixed_marks, terms};
use crate::adjust::flight_prior::FlightPrior;
use crate::adjust::ground::GroundShape;
use crate::adjust::{self, AdjustError, Mounting, Observation, Options, Solution};
use crate::setup::{GroundObservation, Orientation, Setup, SurveyMarker};

/// Predicted standard deviations of one marker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarkerSigma {
    /// Index in the survey.
    pub marker: usize,
    /// Of the deflection, m.
    pub deflection_m: f64,
    /// Of the position along the span, m.
    pub span_m: f64,
    /// Of the position along the flow, m.
    pub chord_m: f64,
    /// Of the height, m.
    pub height_m: f64,
}

/// What a layout is worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Expected {
    /// Standard deviation of the deflection of the bending axis at the tip, m.
    pub sigma_tip_deflection_m: f64,
    /// Mean square root of that along the span, m.
    pub sigma_mean_deflection_m: f64,
    /// Standard deviation of the twist at the tip, degrees.
    pub sigma_tip_twist_deg: Option<f64>,
    /// Largest standard deviation of a marker along the span, m.
    pub sigma_span_m: f64,
}

/// Predicted standard deviations of the outermost visible marker's deflection, counted from three places.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TipSigma {
    /// Its id.
    pub marker: String,
    /// Which deflection results would show: the one that is told best.
    pub reference: adjust::Reference,
    /// Against the survey, m.
    pub deflection_m: Option<f64>,
    /// Against the ground frame, m.
    pub deflection_ground_m: Option<f64>,
    /// From the root's tangent, m.
    pub deflection_root_m: Option<f64>,
}

/// A layout with one marker more or one less.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// The marker that is surveyed and not seen; `None` for one more that is.
    pub without: Option<String>,
    /// Where the marker stands or would stand, along the span from the projection centre, m.
    pub span_m: f64,
    /// What the layout is worth then; `None` where it could not be adjusted.
    pub expected: Option<Expected>,
}

/// The same layout under another assumption.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alternative {
    /// What is assumed.
    pub name: String,
    /// What the layout is worth then; `None` where it could not be adjusted.
    pub expected: Option<Expected>,
}

/// Predicted uncertainty of a layout.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Prediction {
    /// Conditions less parameters.
    pub redundancy: usize,
    /// The layout as it is.
    pub expected: Expected,
    /// The tip marker's deflection.
    pub tip: Option<TipSigma>,
    /// What the variance of the deflection that results would show comes from, the largest share first.
    pub budget: Vec<adjust::BudgetShare>,
    /// Every visible marker.
    pub markers: Vec<MarkerSigma>,
    /// Pairs of the installation: name, standard deviations of angle and twist, degrees.
    pub torsion: Vec<(String, Option<f64>, Option<f64>)>,
    /// Correlation of the mount's pitch with bending.
    pub pitch_bending_correlation: Option<f64>,
    /// Without each marker, then with one more in the largest gap.
    pub changes: Vec<Change>,
    /// With one, two, four marks more that are rigid to the cabin.
    pub fixed_marks: Vec<Alternative>,
    /// With each term known that the installation leaves open: what it costs.
    pub terms_known: Vec<Alternative>,
    /// (span from the projection centre, sigma of deflection m, sigma of twist degrees).
    curve: Vec<(f64, f64, Option<f64>)>,
}

impl Prediction {
    /// Standard deviations of deflection (m) and twist (degrees) at a span, by linear interpolation.
    pub fn at(&self, span_m: f64) -> Option<(f64, Option<f64>)> {
        let next = self.curve.iter().position(|p| p.0 >= span_m).or(self.curve.len().checked_sub(1))?;
        let (b, a) = (self.curve.get(next)?, self.curve.get(next.saturating_sub(1))?);
        let share = if b.0 > a.0 { ((span_m - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) } else { 1.0 };
        let mix = |x: f64, y: f64| x + share * (y - x);
        Some((mix(a.1, b.1), a.2.zip(b.2).map(|(x, y)| mix(x, y))))
    }
}

/// Variance of a sight that tells nothing, over that of one that is seen.
const UNSEEN: f64 = 1e8;
/// Lowest deflection of a flight's frames over the highest: from full tanks on ground speed to a gust.
const MIN_DEFLECTION_FRACTION: f64 = 0.4;

/// A flight that has not taken place.
pub struct SimulatedFlight<'a> {
    setup: &'a Setup,
    options: &'a PlanOptions,
    /// Markers on ground, wing frame, m.
    pub ground: Vec<Vector3<f64>>,
    /// Markers in flight, wing frame, m.
    pub flight: Vec<Vector3<f64>>,
    /// The camera, with the ground frame that will have been taken.
    pub orientation: Orientation,
    /// Exact images of the visible markers.
    pub observations: Vec<Observation>,
    /// Height and slope along the span on ground.
    pub skin: Skin,
    a_per_m: f64,
}

impl<'a> SimulatedFlight<'a> {
    /// Bends the wing as a tapered beam under an elliptic load until the outermost marker is deflected as
    /// asked. The load's shape matters little: the covariance depends on it weakly.
    pub fn new(
        setup: &'a Setup,
        orientation: Option<&Orientation>,
        options: &'a PlanOptions,
    ) -> Result<Self, AdjustError> {
        let shape = GroundShape::new(setup, &[])?;
        let ground: Vec<_> = shape.stations.iter().map(|s| s.surveyed_m).collect();
        let flight = bent(setup, &shape, options.tip_deflection_m);
        let reach = |p: &Vector3<f64>| (p.x - setup.root_offset_m).max(0.0);
        let wing = setup.on_the_wing();
        let tip = wing.iter().map(|(_, p)| reach(p)).fold(0.0, f64::max);
        let a_per_m = if tip > 0.0 { options.tip_deflection_m / (tip * tip) } else { 0.0 };
        let skin = Skin::through(&wing.into_iter().map(|(_, p)| p).collect::<Vec<_>>());
        let mut rehearsal = Self {
            setup,
            options,
            orientation: Orientation {
                camera_from_survey: looking_at(&ground, &flight) * shape.frame.wing_from_survey,
                covariance_rad2: None,
                ground: Vec::new(),
            },
            ground,
            flight,
            observations: Vec::new(),
            skin,
            a_per_m,
        };
        if let Some(known) = orientation {
            rehearsal.orientation = known.clone();
        }
        rehearsal.look();
        Ok(rehearsal)
    }

    /// Takes the ground frame, unless one was taken, and the frame in flight.
    fn look(&mut self) {
        let variance = self.options.pixel_sigma * self.options.pixel_sigma;
        let covariance_px2 = Matrix2::identity() * variance;
        let turn = &self.orientation.camera_from_survey;
        let see = |p: &Vector3<f64>, in_flight| {
            let survey = self.setup.wing_frame().wing_from_survey.inverse() * p;
            let pixel = self.setup.lens.project(&seen(self.setup, turn, &survey, in_flight))?;
            self.setup.lens.contains(&pixel).then_some(pixel)
        };
        let flight = self.flight.iter().enumerate();
        let observations: Vec<_> = flight
            .filter_map(|(marker, p)| Some(Observation { marker, pixel: see(p, true)?, covariance_px2 }))
            .collect();
        // The attitude may be known before a ground frame is taken. What one has shown tells which markers are sighted, and how
        // well; its own errors are none of the rehearsal's, whose observations are exact.
        let taken = &self.orientation.ground;
        let told = |marker: usize| match taken.iter().find(|sight| sight.marker == marker) {
            Some(sight) => Some(sight.covariance_px2),
            None => taken.is_empty().then_some(covariance_px2),
        };
        let sight = |(marker, p): (usize, &Vector3<f64>)| {
            Some(GroundObservation { marker, covariance_px2: told(marker)?, pixel: see(p, false)? })
        };
        let ground = self.ground.iter().enumerate().filter_map(sight).collect();
        (self.observations, self.orientation.ground) = (observations, ground);
    }

    /// Slope of the skin in flight.
    pub fn slope_at(&self, flight: &Vector3<f64>) -> f64 {
        self.skin.slope(flight.x) + 2.0 * self.a_per_m * (flight.x - self.setup.root_offset_m).max(0.0)
    }

    /// Adjusts the rehearsed frame, then each changed layout.
    pub fn predict(&self) -> Result<Prediction, AdjustError> {
        let solution = self.solve(&self.observations)?;
        let mut changes: Vec<_> = self.observations.iter().map(|o| self.without(o.marker)).collect();
        changes.extend(self.one_more());
        let degrees = |e: Option<adjust::Estimate>| e.and_then(|e| e.sigma).map(f64::to_degrees);
        Ok(Prediction {
            redundancy: solution.redundancy,
            expected: expected(&solution, self.setup)
                .ok_or_else(|| AdjustError::Input("the adjustment gives no standard deviations".into()))?,
            tip: tip_sigma(&solution, self.setup),
            budget: solution.budget.iter().flat_map(|budget| budget.shares.clone()).collect(),
            markers: marker_sigmas(&solution, self.setup),
            torsion: solution
                .torsion
                .iter()
                .map(|t| (t.name.clone(), degrees(t.angle_rad), degrees(t.twist_rad)))
                .collect(),
            pitch_bending_correlation: solution.pitch_bending_correlation,
            changes,
            fixed_marks: fixed_marks::COUNTS.iter().map(|count| self.with_fixed_marks(*count)).collect(),
            terms_known: self.terms_known(),
            curve: solution
                .curve
                .iter()
                .filter_map(|p| {
                    let twist = p.twist_rad.and_then(|t| t.sigma).map(f64::to_degrees);
                    Some((p.span_m, p.deflection_m.sigma?, twist))
                })
                .collect(),
        })
    }

    /// What the rehearsed frame is worth by itself.
    pub fn alone(&self) -> Result<Expected, AdjustError> {
        let worth = expected(&self.solve(&self.observations)?, self.setup);
        worth.ok_or_else(|| AdjustError::Input("the adjustment gives no standard deviations".into()))
    }

    /// What so many frames of one mounting are worth together, their tips deflected from [`LEAST_DEFLECTION`] of the deflection to all of it:
    /// that of the frame with the largest deflection; `taught`: beside what earlier flights told.
    pub fn together(&self, frames: usize, taught: Option<&FlightPrior>) -> Result<Expected, AdjustError> {
        let share = |k: usize| 1.0 - (1.0 - MIN_DEFLECTION_FRACTION) * k as f64 / (frames.max(2) - 1) as f64;
        let deflections = (0..frames.max(1)).map(|k| self.options.tip_deflection_m * share(k));
        let seen = deflections.map(|tip_deflection_m| {
            let options = PlanOptions { tip_deflection_m, ..*self.options };
            let frame = SimulatedFlight::new(self.setup, Some(&self.orientation), &options)?;
            Ok(frame.observations)
        });
        let seen: Vec<Vec<Observation>> = seen.collect::<Result<_, AdjustError>>()?;
        let mountings = Some(vec![Mounting::Numbered(0); seen.len()]);
        let taught = taught.map(|taught| Arc::new(taught.as_stated()));
        let options = Options { mountings, flight_prior: taught, ..adjustment_options(self.options) };
        // Observations without noise would tell that nothing moves.
        let mut setup = self.setup.clone();
        setup.uncertainty.in_flight = setup.uncertainty.in_flight.held();
        let solutions = match &seen[..] {
            [one] => vec![adjust::spatial(&setup, &self.orientation, one, &options)?],
            _ => adjust::flight(&setup, &self.orientation, &seen, &options)?,
        };
        let first = solutions.first().and_then(|solution| expected(solution, self.setup));
        first.ok_or_else(|| AdjustError::Input("the adjustment gives no standard deviations".into()))
    }

    fn solve(&self, observations: &[Observation]) -> Result<Solution, AdjustError> {
        adjust::spatial(self.setup, &self.orientation, observations, &adjustment_options(self.options))
    }

    /// The marker is surveyed and not seen, neither on ground nor in flight. Its survey goes on shaping the wing, so that all
    /// is linearised where it was: what is seen less can then lower no standard deviation.
    fn without(&self, marker: usize) -> Change {
        let mut orientation = self.orientation.clone();
        let own = orientation.ground.iter_mut().filter(|g| g.marker == marker);
        own.for_each(|g| g.covariance_px2 *= UNSEEN);
        let left: Vec<Observation> =
            self.observations.iter().filter(|o| o.marker != marker).cloned().collect();
        let options = adjustment_options(self.options);
        let solved = adjust::spatial(self.setup, &orientation, &left, &options).ok();
        Change {
            span_m: self.ground[marker].x,
            without: self.setup.markers.get(marker).map(|m| m.id.clone()),
            expected: solved.and_then(|solution| expected(&solution, self.setup)),
        }
    }

    /// One more marker in the middle of the largest gap along the span.
    fn one_more(&self) -> Option<Change> {
        let on_the_wing = |k: &usize| self.setup.markers.get(*k).is_some_and(|m| !m.fixed);
        let mut order: Vec<usize> = self.observations.iter().map(|o| o.marker).filter(on_the_wing).collect();
        order.sort_by(|&a, &b| self.ground[a].x.total_cmp(&self.ground[b].x));
        let gap = |pair: &&[usize]| self.ground[pair[1]].x - self.ground[pair[0]].x;
        let widest = order.windows(2).max_by(|a, b| gap(a).total_cmp(&gap(b)))?;
        let (a, b) = (self.setup.markers.get(widest[0])?, self.setup.markers.get(widest[1])?);
        let mut setup = self.setup.clone();
        let position_m = 0.5 * (a.position_m + b.position_m);
        setup.markers.push(SurveyMarker { id: "one more".into(), position_m, ..b.clone() });
        let mut orientation = self.orientation.clone();
        let frame = setup.wing_frame();
        let from_camera = position_m - frame.origin_m;
        let seen = seen(&setup, &orientation.camera_from_survey, &from_camera, false);
        let variance = self.options.pixel_sigma * self.options.pixel_sigma;
        let covariance_px2 = Matrix2::identity() * variance;
        let pixel = setup.lens.project(&seen)?;
        orientation.ground.push(GroundObservation { marker: setup.markers.len() - 1, pixel, covariance_px2 });
        Some(Change {
            without: None,
            span_m: frame.wing_point(&position_m).x,
            expected: self.replayed(&setup, &orientation),
        })
    }

    fn with_fixed_marks(&self, count: usize) -> Alternative {
        let wanted = (0, count, self.options.pixel_sigma);
        let other = fixed_marks::with_marks(self.setup, &self.orientation, wanted);
        let name = format!("{count} fixed mark{}", if count == 1 { "" } else { "s" });
        Alternative {
            name,
            expected: other.and_then(|(setup, orientation)| self.replayed(&setup, &orientation)),
        }
    }

    fn terms_known(&self) -> Vec<Alternative> {
        let one = |(name, setup): (&str, Setup)| {
            let expected = self.replayed(&setup, &self.orientation);
            Alternative { name: name.to_owned(), expected }
        };
        terms::each_known(self.setup).into_iter().map(one).collect()
    }

    fn replayed(&self, setup: &Setup, orientation: &Orientation) -> Option<Expected> {
        let other = SimulatedFlight::new(setup, Some(orientation), self.options).ok()?;
        expected(&other.solve(&other.observations).ok()?, setup)
    }
}

fn tip_sigma(solution: &Solution, setup: &Setup) -> Option<TipSigma> {
    let budget = solution.budget.as_ref()?;
    let marker = &solution.markers[budget.marker];
    let sigma = |reference| marker.deflection_against(reference)?.sigma;
    Some(TipSigma {
        marker: setup.markers.get(budget.marker)?.id.clone(),
        reference: budget.reference,
        deflection_m: sigma(adjust::Reference::Survey),
        deflection_ground_m: sigma(adjust::Reference::Ground),
        deflection_root_m: sigma(adjust::Reference::Root),
    })
}

fn marker_sigmas(solution: &Solution, setup: &Setup) -> Vec<MarkerSigma> {
    let turn = setup.wing_frame().wing_from_survey;
    let of_the_wing = |m: &&adjust::MarkerSolution| setup.markers.get(m.marker).is_some_and(|k| !k.fixed);
    let one = |m: &adjust::MarkerSolution| {
        let wing = turn * m.covariance_m2? * turn.inverse();
        let sigma = |k: usize| wing[(k, k)].max(0.0).sqrt();
        let (span_m, height_m, chord_m) = (sigma(0), sigma(1), sigma(2));
        Some(MarkerSigma {
            marker: m.marker,
            deflection_m: m.deflection_m?.sigma?,
            span_m,
            chord_m,
            height_m,
        })
    };
    solution.markers.iter().filter(of_the_wing).filter_map(one).collect()
}

fn expected(solution: &Solution, setup: &Setup) -> Option<Expected> {
    let tip = solution.curve.last()?;
    let sigmas: Vec<f64> = solution.curve.iter().filter_map(|p| p.deflection_m.sigma).collect();
    let square = sigmas.iter().map(|s| s * s).sum::<f64>() / sigmas.len().max(1) as f64;
    Some(Expected {
        sigma_tip_deflection_m: tip.deflection_m.sigma?,
        sigma_mean_deflection_m: square.sqrt(),
        sigma_tip_twist_deg: tip.twist_rad.and_then(|t| t.sigma).map(f64::to_degrees),
        sigma_span_m: marker_sigmas(solution, setup).iter().fold(0.0, |m, s| m.max(s.span_m)),
    })
}
