//! `wingd deform` moves the nodes of a surface by the measured shape of the wing.

use std::fs;
use std::path::{Path, PathBuf};

use super::flight_shape::{FlightShape, ShapeSource};
use super::{Completion, Failure, TaskResult, print_line, print_notes, write_output};
use crate::desk::stored_flights::{frame_name, select_flights};
use crate::desk::surface::{OtherAxes, OutputFile, Surface, check_nodes};
use crate::installation::LENGTH_UNITS;
use crate::measure::adjust::{JointShape, StationChoice};
use crate::measure::deformation::{
    SampledPoses, SectionPose, WingDeformation, remove_thermal_scale,
};
use crate::measure::geometry::Similarity;

/// Number of sampled wings that standard deviations follow from: these are then known to 5 %.
const SIGMA_SAMPLES: usize = 200;
/// Seed of the samples, so that the same results give the same files.
const SAMPLE_SEED: u64 = 1;
/// Largest number of sampled surfaces.
const MAX_DRAWS: usize = 1000;

/// Move the nodes of a surface from CAD, CFD or FEM by the measured shape of the wing, section by section.
#[derive(clap::Args)]
pub struct DeformArgs {
    /// Store
    store: PathBuf,
    /// Surface: wing.stl, nodes.csv (id,x_m,y_m,z_m) or mesh.su2:MARKER,MARKER
    #[arg(long, value_name = "FILE")]
    surface: PathBuf,
    /// Unit of STL and SU2 files [default: m]
    #[arg(long, value_parser = LENGTH_UNITS.map(|unit| unit.name))]
    unit: Option<String>,
    /// The surface is in the axes of the CAD model, not of the survey; needs `cad.tie_points` in the installation
    #[arg(long)]
    cad: bool,
    /// Flight, for example f0001 [default: the newest]
    #[arg(long)]
    flight: Option<String>,
    /// Frame, named as in the results, for example s000001/0001.jpg [default: the mean over the frames]
    #[arg(long, value_name = "NAME")]
    frame: Option<String>,
    /// Mean shape over the frames of the flight, which is the default
    #[arg(long, conflicts_with = "frame")]
    mean: bool,
    /// Write this number of sampled surfaces, too, each with one error of every source
    #[arg(long, value_name = "N", default_value_t = 0)]
    draws: usize,
    /// Move the wing without its contraction by temperature
    #[arg(long)]
    without_thermal: bool,
    /// Results to use if a flight was solved with several inputs: first characters of their key [default: newest complete
    /// solve]
    #[arg(long, value_name = "KEY")]
    inputs: Option<String>,
    /// Installation [default: the one kept in the store]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Folder of the output
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
}

pub(super) fn run(args: &DeformArgs) -> TaskResult<Completion> {
    if args.draws > MAX_DRAWS {
        return Err(Failure::Usage(format!("--draws: give at most {MAX_DRAWS}")));
    }
    let unit = LENGTH_UNITS
        .into_iter()
        .find(|unit| Some(unit.name) == args.unit.as_deref());
    let surface = Surface::read(&args.surface, unit)?;
    let flight = select_flights(&args.store, args.flight.as_deref())?.pop();
    let flight =
        flight.ok_or_else(|| Failure::from_path_error(&args.store, "the store has no flight"))?;
    let (inputs, installation) = (args.inputs.as_deref(), args.installation.as_deref());
    let source = ShapeSource {
        store: &args.store,
        flight: &flight,
        inputs,
        installation,
    };
    let solved = source.solve(&StationChoice::Standard)?;
    let (shape, frames) = select_shape(&solved, args.frame.as_deref())?;
    let poses = SampledPoses::new(shape, &frames, SIGMA_SAMPLES.max(args.draws), SAMPLE_SEED);
    let cad = solved.installation.cad.as_ref().map(|fit| fit.transform);
    if args.cad && cad.is_none() {
        let what = "the installation has no [cad]; give cad.tie_points, or the surface in the axes of the survey";
        return Err(Failure::Failed(format!("--cad: {what}")));
    }
    let deform = |poses: &[SectionPose], with_cad: bool| {
        let poses = if args.without_thermal {
            remove_thermal_scale(poses)
        } else {
            poses.to_vec()
        };
        deform_in_axes(&poses, cad.as_ref().filter(|_| with_cad))
    };
    let wing = deform(&poses.mean, args.cad)?;
    let samples = poses
        .samples
        .iter()
        .map(|one| deform(one, args.cad))
        .collect::<TaskResult<Vec<_>>>()?;
    let other = cad
        .is_some()
        .then(|| deform(&poses.mean, !args.cad))
        .transpose()?;
    let remedy = if args.cad { "omit --cad" } else { "add --cad" };
    let other = other.as_ref().map(|wing| OtherAxes { wing, remedy });
    let scale = if args.cad {
        cad.map_or(1.0, |cad| cad.scale)
    } else {
        1.0
    };
    let counts = check_nodes(&args.surface, &surface, &wing, shape.reach_m * scale, other)?;
    let motions = surface.move_nodes(&wing, &samples);
    let folded = surface.count_folded_facets(&motions);
    print_notes(counts.warnings());
    if folded > 0 {
        print_notes([format!(
            "{folded} facets are turned over; the surface cannot be used there"
        )]);
    }
    write_surface(&args.output, &surface.to_files(&motions))?;
    for (k, sample) in samples.iter().take(args.draws).enumerate() {
        let folder = args.output.join(format!("draw-{:03}", k + 1));
        write_surface(&folder, &surface.to_files(&surface.move_nodes(sample, &[])))?;
    }
    let largest = motions
        .iter()
        .max_by(|a, b| a.displacement_m.norm().total_cmp(&b.displacement_m.norm()));
    let moved_m = largest.map_or(0.0, |motion| motion.displacement_m.norm());
    let sigma = largest.and_then(|motion| Some(format!(" ± {:.3}", motion.sigma_m?.norm())));
    let what = args
        .frame
        .clone()
        .unwrap_or_else(|| format!("mean of {} frames", frames.len()));
    print_line(&format!(
        "{}, {what}: {} of {} nodes moved, by at most {moved_m:.3}{} m",
        flight.id,
        counts.all - counts.inboard,
        counts.all,
        sigma.unwrap_or_default()
    ))?;
    Ok(Completion::from_success(folded == 0))
}

/// Selects the shape and the frames in it: the one named, or all of a flight that was adjusted jointly.
fn select_shape<'a>(
    solved: &'a FlightShape,
    wanted: Option<&str>,
) -> TaskResult<(&'a JointShape, Vec<usize>)> {
    let names: Vec<String> = solved.frames.iter().map(frame_name).collect();
    let Some(wanted) = wanted else {
        let first = solved
            .shapes
            .first()
            .filter(|one| solved.jointly || one.frames.len() == names.len());
        let what = "the frames were adjusted one by one, and their common errors are unknown; run `wingd solve STORE \
                    --flight`, or name one with --frame";
        let first = first.ok_or_else(|| Failure::Failed(what.into()))?;
        return Ok((&first.shape, (0..first.shape.frames.len()).collect()));
    };
    let place = names
        .iter()
        .position(|name| name == wanted)
        .ok_or_else(|| {
            Failure::Failed(format!(
                "--frame: there is no {wanted}; available: {}",
                names.join(", ")
            ))
        })?;
    let found = solved.shapes.iter().find_map(|one| {
        let k = one.frames.iter().position(|frame| *frame == place)?;
        Some((&one.shape, vec![k]))
    });
    found.ok_or_else(|| {
        Failure::Failed(format!(
            "--frame: {wanted} has no shape; choose another frame"
        ))
    })
}

/// Deformation in the axes of the survey, or of the CAD model if the transform to it is given.
fn deform_in_axes(poses: &[SectionPose], cad: Option<&Similarity>) -> TaskResult<WingDeformation> {
    let transformed: Vec<SectionPose> = poses
        .iter()
        .map(|pose| cad.map_or(*pose, |transform| pose.transformed(transform)))
        .collect();
    WingDeformation::new(&transformed).map_err(Failure::from_error)
}

fn write_surface(folder: &Path, files: &[OutputFile]) -> TaskResult<()> {
    const REMEDY: &str = "choose another folder with --output";
    fs::create_dir_all(folder)
        .map_err(|error| Failure::from_write_error(folder, &error, REMEDY))?;
    for file in files {
        let path = folder.join(file.name);
        write_output(&path, &file.bytes, REMEDY)?;
        print_line(&path.display().to_string())?;
    }
    Ok(())
}
