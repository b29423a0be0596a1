//! `wingd diagnose` finds the error of installation, frame or manual marks that explains images which do not fit.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::orient;
use wingd_base::failure::{Completion, Failure};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::inputs::default_paths::{load_installation, resolve_installation};
use wingd_evaluation::inputs::{batch, manual_points::ManualPoints};
use wingd_evaluation::installation::Installation;
use wingd_evaluation::pipeline::{self, ProcessedFrame, SolveJob, orienting, stages};
use wingd_evaluation::record::Reason;
use wingd_measure::identify::{self, Diagnosis, Explanation, IdentifyError, OTHER_AIRCRAFT};
use wingd_measure::observation::Estimate;

/// Find the error that explains images which do not fit: lens, survey, projection centre, axes, units, names, bend, marks.
#[derive(clap::Args)]
pub struct DiagnoseArgs {
    /// Installation [default: installation/ in this directory]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// The images show the wing in flight, and the installation has an orientation
    #[arg(long)]
    joint: bool,
    /// Manual marks in the images (id,u_px,v_px,sigma_px; for several images also image)
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Print one JSON object: status, variance_factor, global_test, causes, ranking
    #[arg(long)]
    json: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Ground frames, or with --joint frames in flight
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
}

/// Diagnoses images and prints the causes.
pub(super) fn run(args: &DiagnoseArgs) -> Result<Completion, Failure> {
    let installation = load_installation(&resolve_installation(args.installation.as_deref())?)?;
    let outcomes = if args.joint {
        diagnose_flights(args, &installation)?
    } else {
        diagnose_ground(args, &installation)?
    };
    for (image, outcome) in &outcomes {
        match args.json {
            true => print_json(&outcome.to_json(image))?,
            false => print_line(&outcome.text(image))?,
        }
    }
    Ok(Completion::from_success(
        outcomes
            .iter()
            .all(|(_, outcome)| outcome.status() == SOUND),
    ))
}

/// Result of an image.
enum DiagnosedImage {
    /// Ranked causes.
    Ranked(Diagnosis),
    /// Cause, or why none was found.
    Sentence(String),
}

/// Diagnosed images with their names.
type DiagnosedImages = Vec<(String, DiagnosedImage)>;

fn diagnose_ground(
    args: &DiagnoseArgs,
    installation: &Installation,
) -> Result<DiagnosedImages, Failure> {
    let setup = &installation.setup;
    let mut frames = orient::read_frames(
        &args.images,
        args.observations.as_deref(),
        args.jobs,
        installation,
    )?;
    let error = orienting::orient_frames(setup, &mut frames).err();
    let is_oriented = error.is_none();
    let outcome = match error {
        Some(error) if error.names_cause() => DiagnosedImage::Sentence(error.to_string()),
        error => {
            let reason = match error {
                None => "the images cannot be diagnosed".to_owned(),
                Some(error @ IdentifyError::NoConsensus { .. }) => {
                    format!("{error}: {OTHER_AIRCRAFT}")
                }
                Some(error) => error.to_string(),
            };
            let found = identify::diagnose_ground(setup, &orienting::detected_markers(&frames));
            let found = found.filter(|found| is_oriented || !found.causes().is_empty());
            found.map_or(DiagnosedImage::Sentence(reason), DiagnosedImage::Ranked)
        }
    };
    let images: Vec<&str> = frames
        .iter()
        .map(|frame| frame.processed.image.as_str())
        .collect();
    Ok(vec![(images.join(", "), outcome)])
}

fn diagnose_flights(
    args: &DiagnoseArgs,
    installation: &Installation,
) -> Result<DiagnosedImages, Failure> {
    let (setup, orientation) = (&installation.setup, installation.require_orientation()?);
    let files = batch::expand_folders(&args.images)?;
    let marks = match &args.observations {
        Some(file) => ManualPoints::read(file, &files, setup)?,
        None => ManualPoints::default(),
    };
    let process = |name: &str, bytes: Result<&[u8], Reason>| {
        let mut processed = match bytes {
            Ok(bytes) => stages::process_frame(name, bytes, None, setup, Some(orientation)),
            Err(reason) => ProcessedFrame::failed(name, reason),
        };
        processed.add_manual(marks.for_image(name));
        let mut found = pipeline::diagnose_frame(&processed, setup, orientation);
        if found.as_ref().is_ok_and(|found| found.causes().is_empty()) {
            let job = SolveJob::default();
            let solved =
                pipeline::solve_processed_frame(&processed, installation, orientation, &job);
            found = solved.reason.map_or(found, |reason| Err(Some(reason)));
        }
        let reason = processed
            .failure
            .map_or("the image cannot be diagnosed".to_owned(), |reason| {
                reason.to_string()
            });
        let sentence = |cause: Option<String>| DiagnosedImage::Sentence(cause.unwrap_or(reason));
        (
            processed.image,
            found.map_or_else(sentence, DiagnosedImage::Ranked),
        )
    };
    let mut outcomes = vec![];
    batch::for_each_image(
        &files,
        args.jobs,
        "diagnosing",
        process,
        batch::collect_into(&mut outcomes),
    )?;
    Ok(outcomes)
}

impl DiagnosedImage {
    fn status(&self) -> &'static str {
        let Self::Ranked(found) = self else {
            return "failed";
        };
        match found.causes().len() {
            0 => SOUND,
            1 => "found",
            _ => "ambiguous",
        }
    }

    fn to_json(&self, image: &str) -> Value {
        let size = |s: &Estimate| json!({"value": s.value, "sigma": s.sigma});
        let explanation = |e: &Explanation| {
            json!({
                "cause": format!("{:?}", e.cause),
                "text": e.text,
                "size": e.size.iter().map(size).collect::<Vec<_>>(),
                "decrease": e.decrease,
                "variance_factor": e.variance_factor,
            })
        };
        match self {
            Self::Ranked(found) => json!({
                "status": self.status(),
                "image": image,
                "variance_factor": found.variance_factor,
                "global_test": found.global_test,
                "causes": found.causes().iter().map(explanation).collect::<Vec<_>>(),
                "further": found.further.as_ref().map(explanation),
                "ranking": found.ranking.iter().take(SHOWN).map(explanation).collect::<Vec<_>>(),
            }),
            Self::Sentence(reason) => {
                json!({"status": self.status(), "image": image, "reason": reason})
            }
        }
    }

    fn text(&self, image: &str) -> String {
        let found = match self {
            Self::Sentence(reason) => return format!("{image}: {reason}"),
            Self::Ranked(found) => found,
        };
        let factor = found.variance_factor;
        let causes = found.causes();
        if causes.is_empty() {
            return format!("{image}: no error found; variance factor {factor:.2}");
        }
        let line =
            |e: &Explanation| format!("\n- {}; variance factor {:.2}", e.text, e.variance_factor);
        let lines: String = causes.iter().chain(&found.further).map(line).collect();
        let head = match (causes.len(), &found.further) {
            (1, None) => "one cause explains it",
            (1, Some(_)) => "two causes together explain it",
            _ => "these causes explain it equally well",
        };
        format!("{image}: the images do not fit, variance factor {factor:.2}; {head}:{lines}")
    }
}

/// Status without error.
const SOUND: &str = "sound";
/// Number of causes that the ranking lists.
const SHOWN: usize = 6;
