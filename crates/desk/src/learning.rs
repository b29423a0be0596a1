//! Prior from several flights: each contributes its normal equations, linearised given the others.

use wingd_evaluation::installation::{
    FLIGHT_PRIOR_FILE, Installation, PriorFlight, StoredFlightPrior,
};
use wingd_evaluation::pipeline;
use wingd_evaluation::pipeline::{ProcessedFrame, SolveJob};
use wingd_evaluation::record::Reason;
use wingd_measure::adjust::Estimate;
use wingd_measure::adjust::flight_prior::FlightContribution;
use wingd_measure::widths::Unknown;

use wingd_base::failure::Failure;

/// Rounds of linearisation. Each flight is linearised first given the flights before it, then given all others: normal
/// equations that are added must refer to the same point.
const LEARNING_ROUNDS: usize = 2;

/// A flight that may contribute to the prior, with its measured frames.
pub struct PriorCandidate {
    pub store: String,
    pub flight: String,
    /// Digests of the frames.
    pub frames: Vec<String>,
    pub processed: Vec<ProcessedFrame>,
    pub contribution: Option<FlightContribution>,
}

impl PriorCandidate {
    /// Creates a candidate without measured frames.
    pub fn new(store: String, flight: String, frames: Vec<String>) -> Self {
        Self {
            store,
            flight,
            frames,
            processed: vec![],
            contribution: None,
        }
    }

    /// Returns whether a flight is the same one, or shares a frame with it.
    pub fn is_same_flight(&self, store: &str, flight: &str, frames: &[String]) -> bool {
        (store, flight) == (self.store.as_str(), self.flight.as_str())
            || frames.iter().any(|frame| self.frames.contains(frame))
    }

    /// Returns the contribution as stored in the prior; `None` before the first estimate.
    fn to_source(&self) -> Option<PriorFlight> {
        let contribution = self.contribution.as_ref()?;
        Some(PriorFlight {
            store: self.store.clone(),
            flight: self.flight.clone(),
            program: format!("wingd {}", env!("CARGO_PKG_VERSION")),
            frames: self.frames.clone(),
            normals: contribution.normals.clone(),
        })
    }

    fn estimate_contribution(&mut self, installation: &Installation) -> Result<(), Reason> {
        let orientation = installation
            .orientation
            .as_ref()
            .ok_or("there is no orientation")?;
        let contribution = pipeline::learn_flight(
            &self.processed,
            installation,
            orientation,
            &SolveJob::default(),
        );
        self.contribution = Some(contribution?);
        Ok(())
    }
}

/// Candidate that contradicts the model or the prior, with the reason.
pub type RefusedFlight = (PriorCandidate, Reason);

/// Estimates the contribution of each candidate given the others and the flights of the prior, and removes those that
/// contradict the model or the prior; `busy` runs the estimate from a flight. Returns all flights of the new prior, and the
/// removed candidates with the reasons.
pub fn estimate_contributions(
    candidates: &mut Vec<PriorCandidate>,
    installation: &mut Installation,
    busy: impl Fn(&str, &mut dyn FnMut()),
) -> Result<(Vec<PriorFlight>, Vec<RefusedFlight>), Failure> {
    let before = installation
        .flight_prior
        .as_ref()
        .map_or(vec![], |prior| prior.flights.clone());
    let mut refused = vec![];
    for _ in 0..LEARNING_ROUNDS {
        let mut k = 0;
        while k < candidates.len() {
            let others = candidates
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != k);
            let others = others.filter_map(|(_, candidate)| candidate.to_source());
            let sources = before.iter().cloned().chain(others).collect();
            installation.flight_prior = Some(combine_flights(sources, installation)?);
            let mut outcome = Ok(());
            let flight = candidates[k].flight.clone();
            busy(&flight, &mut || {
                outcome = candidates[k].estimate_contribution(installation)
            });
            match outcome {
                Ok(()) => k += 1,
                Err(reason) => refused.push((candidates.remove(k), reason)),
            }
        }
    }
    Ok((
        before
            .into_iter()
            .chain(candidates.iter().filter_map(PriorCandidate::to_source))
            .collect(),
        refused,
    ))
}

/// Combines the contributions of flights to a prior.
///
/// # Errors
/// Returns an error if they do not fit together.
pub fn combine_flights(
    flights: Vec<PriorFlight>,
    installation: &Installation,
) -> Result<StoredFlightPrior, Failure> {
    let file = installation.directory.join(FLIGHT_PRIOR_FILE);
    StoredFlightPrior::from_flights(flights, &installation.setup)
        .map_err(|error| Failure::from_path_error(&file, error))
}

/// Parameter by its name with the unit, and its estimate.
pub type NamedEstimate = (&'static str, Estimate);

/// Parameters whose change is printed: key, factor to its unit, unknown, index within it.
const REPORTED_PARAMETERS: [(&str, f64, Unknown, usize); 8] = [
    ("root_offset_m", 1.0, Unknown::RootOffset, 0),
    ("axis_chord_offset_m", 1.0, Unknown::ChordOffset, 0),
    (
        "span_direction_deg",
        180.0 / std::f64::consts::PI,
        Unknown::SpanDirection,
        0,
    ),
    ("axis_height_root_m", 1.0, Unknown::AxisHeight, 0),
    ("ground_bend_m", 1.0, Unknown::GroundBend, 0),
    ("projection_centre_x_m", 1.0, Unknown::ProjectionCentre, 0),
    ("projection_centre_y_m", 1.0, Unknown::ProjectionCentre, 1),
    ("projection_centre_z_m", 1.0, Unknown::ProjectionCentre, 2),
];

/// Returns the estimated minus the specified value of the reported parameters, and the prior standard deviation.
fn reported_parameters(contribution: &FlightContribution) -> Vec<(&'static str, Estimate, f64)> {
    let FlightContribution {
        normals, posterior, ..
    } = contribution;
    let of = |(name, factor, unknown, index): (&'static str, f64, Unknown, usize)| {
        let k = normals
            .unknowns
            .iter()
            .position(|l| l.unknown == unknown && l.index == index)?;
        let (found, prior) = (posterior.get(k)?, normals.sigmas.get(k)?);
        let value = Estimate {
            value: factor * found.value,
            sigma: found.sigma.map(|s| factor * s),
        };
        Some((name, value, factor * prior))
    };
    REPORTED_PARAMETERS.into_iter().filter_map(of).collect()
}

/// Returns the estimated minus the specified value of the reported parameters.
pub fn estimated_differences(contribution: &FlightContribution) -> Vec<NamedEstimate> {
    reported_parameters(contribution)
        .into_iter()
        .map(|(name, found, _)| (name, found))
        .collect()
}

/// Number of standard deviations beyond which an estimate contradicts the installation.
const CONTRADICTION_SIGMAS: f64 = 3.0;

/// Describes the parameters of the installation that the flights contradict.
pub fn list_contradictions(contribution: &FlightContribution) -> Vec<String> {
    let text = |(name, found, prior): (&'static str, Estimate, f64)| {
        // The difference of estimate and prior has the difference of their variances.
        let sigma = (prior * prior - found.sigma?.powi(2)).max(0.0).sqrt();
        let w = found.value.abs() / sigma;
        (w > CONTRADICTION_SIGMAS && w.is_finite()).then(|| {
            format!(
                "{name}: the flights contradict the installation by {:.4} ({w:.1} standard deviations); check this value, or \
                 increase its standard deviation in installation.toml",
                found.value
            )
        })
    };
    reported_parameters(contribution)
        .into_iter()
        .filter_map(text)
        .collect()
}
