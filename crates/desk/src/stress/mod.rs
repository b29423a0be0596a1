//! Bending lines of a flight's results, of series or of live mode, for the evaluation of loads.

mod live;
pub mod tables;

use std::path::{Path, PathBuf};

use nalgebra::{DMatrix, DVector};
use serde_json::{Map, Value};

use crate::stress::tables as stress;
use crate::stress::tables::{StressFrame, StressQuery};
use wingd_base::clock::Stamp;
use wingd_base::failure::{Failure, TaskResult};
use wingd_evaluation::installation;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::results::{ShotData, source};
use wingd_measure::setup::Width;
use wingd_measure::setup::{DEFAULT_BENDING_HZ, StiffnessSection};
use wingd_measure::stress::{BendingCurvature, DEFAULT_STEPS, bending_length_m};
use wingd_store::result_sets;
use wingd_store::result_sets::ResultSet;
use wingd_store::{FlightRef, RealDisk, StoreResult, catalogue, installations};

/// Results of a flight to evaluate.
pub enum ResultOrigin {
    Series(ResultSet),
    /// Results of live mode, by their provenance.
    Live(Map<String, Value>),
}

impl ResultOrigin {
    /// Returns the results of live mode, or the results of series by the beginning of their inputs key, with a warning if
    /// there are others; `None` if the flight has none.
    pub fn find(
        root: &Path,
        flight: &FlightRef,
        live: bool,
        inputs: Option<&str>,
    ) -> StoreResult<Option<(Self, Option<String>)>> {
        if live {
            return Ok(live::last_provenance(root, flight)?
                .map(|provenance| (Self::Live(provenance), None)));
        }
        let all = result_sets::flight_result_sets(&RealDisk, flight)?;
        let set = all.choose_set(inputs).cloned();
        Ok(set.map(|set| {
            (
                Self::Series(set),
                all.mixed_inputs_warning(&flight.id, inputs),
            )
        }))
    }

    /// Reads the bending lines of the solved frames, and the reasons for excluding others.
    pub fn read_frames(
        &self,
        root: &Path,
        flight: &FlightRef,
        line: &BendingLine,
    ) -> StoreResult<(Vec<StressFrame>, Vec<String>)> {
        match self {
            Self::Series(set) => series_frames(flight, set, line),
            Self::Live(provenance) => live::live_frames(root, flight, provenance, line),
        }
    }

    /// Returns the inputs of the results.
    pub fn provenance(&self) -> &Map<String, Value> {
        match self {
            Self::Series(set) => &set.provenance,
            Self::Live(provenance) => provenance,
        }
    }

    /// Returns the key of the inputs; `None` for live results.
    pub fn inputs_key(&self) -> Option<&str> {
        match self {
            Self::Series(set) => Some(&set.key),
            Self::Live(_) => None,
        }
    }
}

/// Properties common to the bending lines of all frames.
pub struct BendingLine {
    length_m: f64,
    root_sigma_m: f64,
}

impl BendingLine {
    fn with_curvature(
        &self,
        coefficients_per_m: DVector<f64>,
        covariance: DMatrix<f64>,
    ) -> BendingCurvature {
        let Self {
            length_m,
            root_sigma_m,
        } = *self;
        BendingCurvature {
            coefficients_per_m,
            covariance,
            length_m,
            root_sigma_m,
            steps: DEFAULT_STEPS,
        }
    }
}

/// Requested evaluation; the installation supplies each field that is `None`.
pub struct StressRequest {
    /// Installation; `None` for the one that the results came from.
    pub installation: Option<PathBuf>,
    pub sections: Option<Vec<StiffnessSection>>,
    pub bending_hz: Option<f64>,
    pub slopes: Vec<f64>,
    pub goodman: bool,
    pub levels: usize,
}

impl StressRequest {
    /// Returns the query for the results of a flight, and their bending line.
    ///
    /// # Errors
    /// Returns an error if there is no installation or no stiffness, or if a station lies beyond the tip.
    pub fn to_query(
        &self,
        root: &Path,
        flight: &FlightRef,
        provenance: &Map<String, Value>,
    ) -> TaskResult<(StressQuery, BendingLine)> {
        let installation = self.load_installation(root, flight, provenance)?;
        let own = installation.structure.as_ref();
        let sections = self.sections.clone().or_else(|| own.map(|s| s.sections.clone())).ok_or_else(|| {
            let what = "there is no bending stiffness: give --structure FILE, or [structure] in installation.toml";
            Failure::Usage(what.to_owned())
        })?;
        if let Some(section) = sections
            .iter()
            .find(|s| self.goodman && s.ultimate_n_m.is_none())
        {
            let what = format!(
                "--goodman: ultimate_n_m of the station at {} m is missing",
                section.s_m
            );
            return Err(Failure::Usage(what));
        }
        let orientation = installation.require_orientation()?;
        let length_m = bending_length_m(&installation.setup, orientation);
        let length_m =
            length_m.map_err(|error| Failure::Failed(format!("{}: {error}", flight.id)))?;
        if let Some(section) = sections.iter().find(|s| s.s_m > length_m) {
            let what = format!(
                "a station at {} m lies beyond the tip, {length_m:.2} m",
                section.s_m
            );
            return Err(Failure::Failed(format!(
                "{what} from the bending root; remove it from the structure file"
            )));
        }
        let bending_hz = self
            .bending_hz
            .or(own.map(|s| s.bending_hz))
            .unwrap_or(DEFAULT_BENDING_HZ);
        let (slopes, goodman, levels) = (self.slopes.clone(), self.goodman, self.levels);
        let root_sigma_m = installation.setup.uncertainty[Width::RootOffset];
        Ok((
            StressQuery {
                sections,
                bending_hz,
                slopes,
                goodman,
                levels,
            },
            BendingLine {
                length_m,
                root_sigma_m,
            },
        ))
    }

    fn load_installation(
        &self,
        root: &Path,
        flight: &FlightRef,
        provenance: &Map<String, Value>,
    ) -> TaskResult<Installation> {
        let kept = || {
            let digest = installations::digest_from_provenance(provenance)?;
            Some(installations::installation_folder(root, &digest)).filter(|folder| folder.is_dir())
        };
        let directory = self.installation.clone().or_else(kept).ok_or_else(|| {
            let what = format!(
                "the store has no installation for {}; name it with --installation",
                flight.id
            );
            Failure::from_path_error(root, what)
        })?;
        Ok(installation::load(&directory)?)
    }
}

/// Reads the bending lines of a flight's solved frames, and the reasons for excluding others.
fn series_frames(
    flight: &FlightRef,
    set: &ResultSet,
    line: &BendingLine,
) -> StoreResult<(Vec<StressFrame>, Vec<String>)> {
    let (mut frames, mut excluded) = (Vec::new(), Vec::new());
    for series in catalogue::list_series(&RealDisk, flight)? {
        let Some(read) = source::read_series(&RealDisk, &series, Some(set), &mut excluded) else {
            continue;
        };
        for record in &read.records {
            let Some(stamp) = read.shot_for_record(record).and_then(exposure_stamp) else {
                continue;
            };
            match stress::curvature_coefficients(record) {
                Err(why) => excluded.push(format!("{}/{}: {why}", series.id, record.image)),
                Ok((coefficients_per_m, covariance)) => frames.push(StressFrame {
                    series: series.id.clone(),
                    image: record.image.clone(),
                    stamp,
                    curvature: line.with_curvature(coefficients_per_m, covariance),
                }),
            }
        }
    }
    Ok((frames, excluded))
}

/// Returns the time of exposure as a stamp.
fn exposure_stamp(shot: &ShotData) -> Option<Stamp> {
    let commanded = shot.stamp.clone()?;
    let exposure = shot.exposure.as_ref();
    Some(exposure.map_or(commanded.clone(), |exposure| Stamp {
        utc: exposure.exposure_time,
        since_boot_s: exposure.exposure_since_boot_s,
        ..commanded
    }))
}
