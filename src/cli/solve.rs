//! `wingd solve`: one result per image.

use std::path::PathBuf;

use clap::ValueEnum;

use super::{Done, Failure, frames, print};
use crate::installation::{self, Installation};
use crate::measure::adjust::{Method, Options, SigmaKind};
use crate::measure::setup::Orientation;
use crate::pipeline::{self, Job, Sighting, stages};
use crate::record::{ImageRecord, Status};
use crate::report::{protocol, table};

#[derive(Clone, Copy, ValueEnum)]
enum MethodName {
    /// The published method: a parabola in the vertical plane
    Profile,
    /// A beam of rigid sections in space
    Spatial,
}

#[derive(Clone, Copy, ValueEnum)]
enum SigmaName {
    /// From the observations' own standard deviations
    Prior,
    /// Scaled by the root of the variance factor
    Posterior,
}

/// Solve bending, torsion and positions, one result per image.
#[derive(clap::Args)]
pub struct Args {
    /// The installation, with its orientation
    #[arg(long, value_name = "DIR")]
    installation: PathBuf,
    /// How the deflection is modelled
    #[arg(long, value_enum, default_value = "spatial")]
    method: MethodName,
    /// Adjust all the frames together (spatial)
    #[arg(long, conflicts_with = "observations")]
    flight: bool,
    /// Image points measured by hand (id,u_px,v_px,sigma_px) instead of images
    #[arg(long, value_name = "FILE.csv", conflicts_with = "images")]
    observations: Option<PathBuf>,
    /// Which standard deviations [default: posterior where the global test rejects]
    #[arg(long, value_enum)]
    sigma: Option<SigmaName>,
    /// Terms of the curvature, 1 to 10 [default: 8 or 10, chosen by test; with --flight 8]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=10))]
    curvature_terms: Option<u8>,
    /// Estimate variance components of image and survey
    #[arg(long)]
    variance_components: bool,
    /// Print the readable protocol of each adjustment
    #[arg(long, conflicts_with = "json")]
    protocol: bool,
    /// One JSON object per image
    #[arg(long)]
    json: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Frames: JPEG, PNG, PNM or TIFF
    #[arg(required_unless_present = "observations", value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if args.flight && matches!(args.method, MethodName::Profile) {
        return Err(Failure::Usage(
            "--flight adjusts with the spatial method; leave --method profile out".into(),
        ));
    }
    let installation = installation::load(&args.installation)?;
    let orientation = installation.require_orientation()?;
    let job = job(args);
    let records = match &args.observations {
        Some(file) => {
            let observations = installation::read_observations(file, &installation.setup)?;
            let sighting = Sighting::by_hand(&frames::name(file), &observations);
            vec![pipeline::solve_sighting(&sighting, &installation, orientation, &job)]
        }
        None => solve_images(args, &installation, orientation, &job)?,
    };
    write(args, &records);
    Ok(Done::all(records.iter().all(|r| r.status == Status::Ok)))
}

fn job(args: &Args) -> Job {
    let sigma = match args.sigma {
        None => SigmaKind::ByTest,
        Some(SigmaName::Prior) => SigmaKind::Prior,
        Some(SigmaName::Posterior) => SigmaKind::Posterior,
    };
    let method = match args.method {
        MethodName::Profile => Method::Profile,
        MethodName::Spatial => Method::Spatial,
    };
    let curvature_terms = args.curvature_terms.map(usize::from);
    let options = Options {
        sigma,
        curvature_terms,
        variance_components: args.variance_components,
        ..Options::default()
    };
    Job { method, options }
}

fn solve_images(
    args: &Args,
    installation: &Installation,
    orientation: &Orientation,
    job: &Job,
) -> Result<Vec<ImageRecord>, Failure> {
    let sight = |name: &str, bytes: Result<&[u8], String>| match bytes {
        Ok(bytes) => stages::sight(name, bytes, None, installation, Some(orientation)),
        Err(reason) => Sighting { image: name.into(), failure: Some(reason), ..Sighting::default() },
    };
    if args.flight {
        let sightings = frames::map(&args.images, args.jobs, "measuring", sight)?;
        return Ok(pipeline::solve_flight(&sightings, installation, orientation, job));
    }
    frames::map(&args.images, args.jobs, "solving", |name, bytes| {
        pipeline::solve_sighting(&sight(name, bytes), installation, orientation, job)
    })
}

fn write(args: &Args, records: &[ImageRecord]) {
    if args.protocol {
        records.iter().for_each(|r| print(&protocol::protocol(r)));
    } else if args.json {
        for record in records {
            match serde_json::to_string(record) {
                Ok(line) => print(&line),
                Err(error) => eprintln!("wingd: {}: result cannot be written as JSON: {error}", record.image),
            }
        }
    } else {
        print(&table::results(records));
    }
}
