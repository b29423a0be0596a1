//! `wingd solve` gives one result per image.

mod images;
mod report;
mod store;

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use report::ReportFile;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_json, print_line};
use wingd_evaluation::inputs::image_files;
use wingd_evaluation::pipeline::SolveJob;
use wingd_evaluation::record::ImageRecord;
use wingd_evaluation::results::{ReportBuilder, table};
use wingd_measure::adjust::{AdjustmentMethod, Options, SigmaKind};
use wingd_store::layout;

#[derive(Clone, Copy, ValueEnum)]
enum MethodName {
    /// The published method: a parabola in the vertical plane
    Profile,
    /// A beam of rigid sections in space
    Spatial,
}

#[derive(Clone, Copy, ValueEnum)]
enum SigmaName {
    /// Computed from the standard deviations of the observations
    Prior,
    /// Scaled by the square root of the variance factor
    Posterior,
}

/// Estimate bending, torsion and positions, one result per image.
///
/// The frames of each flight of a store are adjusted jointly, images one by one unless --joint is given. A flight with more
/// than 200 frames, which take 40 s and 300 MB, is adjusted frame by frame, with a note.
#[derive(clap::Args)]
pub struct SolveArgs {
    /// Installation with its orientation [default: installation/ in this directory; for a store: the one kept there that
    /// its results came from]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Model of the deflection
    #[arg(long, value_enum, default_value = "spatial")]
    method: MethodName,
    /// Adjust the frames of all images jointly (spatial); the flights of a store are adjusted so by default
    #[arg(long, conflicts_with = "single")]
    joint: bool,
    /// For a store: adjust each frame alone
    #[arg(long)]
    single: bool,
    /// For a store: flight to solve, for example f0001 [default: all flights]
    #[arg(long, value_name = "NAME")]
    flight: Option<String>,
    /// Camera mounting of each frame (image,mounting); ground: not remounted since the ground frames [default: remounts are
    /// detected from the frames]
    #[arg(long, value_name = "FILE.csv")]
    mountings: Option<PathBuf>,
    /// Manually measured image points (id,u_px,v_px,sigma_px; for several images also image): with images they are added to
    /// the detections, by id; alone they are solved instead of an image
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Use only the manually measured points of the images; nothing is detected
    #[arg(long, requires_all = ["observations", "images"])]
    observations_only: bool,
    /// Write figures and tables as one HTML file (not in the on-board build)
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Kind of standard deviations [default: posterior if the global test rejects]
    #[arg(long, value_enum)]
    sigma: Option<SigmaName>,
    /// Number of curvature terms, 1 to 10 [default: 10, jointly 8]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=10))]
    curvature_terms: Option<u8>,
    /// Estimate variance components of image and survey
    #[arg(long)]
    variance_components: bool,
    /// For a store: use air data and temperatures of the installation, even if there are aircraft data
    #[arg(long)]
    no_aircraft_data: bool,
    /// For a store: ignore manual marks in its frames (`wingd mark`)
    #[arg(long)]
    no_marks: bool,
    /// Print one JSON object per image
    #[arg(long)]
    json: bool,
    /// Show all columns of the tables [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Images processed in parallel [default: number of cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Images (JPEG, PNG, PNM or TIFF) or folders of them; or a store, whose frames get results in addition to older ones
    #[arg(
        required_unless_present = "observations",
        value_name = "IMAGE|FOLDER|STORE"
    )]
    images: Vec<PathBuf>,
}

impl SolveArgs {
    /// Returns whether the spatial method is chosen; the profile method adjusts each image alone.
    fn is_spatial(&self) -> bool {
        matches!(self.method, MethodName::Spatial)
    }
}

/// Solves image files or the frames of a store, prints the results, and writes a report if requested.
pub(super) fn run(args: &SolveArgs, reports: Option<ReportBuilder>) -> TaskResult<Completion> {
    if args.joint && !args.is_spatial() {
        return Err(Failure::Usage(
            "--joint needs the spatial method; omit --method profile".into(),
        ));
    }
    let report = ReportFile::from_option(args.report.as_deref(), reports)?;
    if let [store] = args.images.as_slice()
        && is_store(store)
    {
        if !store.join(layout::STORE_FILE).exists()
            && std::fs::read_dir(store).is_ok_and(|mut d| d.next().is_none())
        {
            let what = format!(
                "{}: is empty; name images, a folder of images, or a store (`wingd import` creates one from images)",
                store.display()
            );
            return Err(Failure::Failed(what));
        }
        if args.observations.is_some() {
            return Err(Failure::Usage(
                "--observations is only for images, not for a store".into(),
            ));
        }
        return store::solve_store(args, store, report);
    }
    let of_stores = [
        (args.flight.is_some(), "--flight"),
        (args.single, "--single"),
    ];
    if let Some((_, option)) = of_stores.iter().find(|(given, _)| *given) {
        return Err(Failure::Usage(format!(
            "{option} is for a store; name one instead of images"
        )));
    }
    images::solve_images(args, report)
}

/// Returns whether a folder is to be treated as a store because it is one, or has no images.
fn is_store(folder: &Path) -> bool {
    folder.is_dir()
        && (folder.join(layout::STORE_FILE).exists() || !image_files::contains_images(folder))
}

fn job_from_args(args: &SolveArgs) -> SolveJob {
    let sigma = match args.sigma {
        None => SigmaKind::ByTest,
        Some(SigmaName::Prior) => SigmaKind::Prior,
        Some(SigmaName::Posterior) => SigmaKind::Posterior,
    };
    let method = match args.method {
        MethodName::Profile => AdjustmentMethod::Profile,
        MethodName::Spatial => AdjustmentMethod::Spatial,
    };
    let curvature_terms = args.curvature_terms.map(usize::from);
    let options = Options {
        sigma,
        curvature_terms,
        variance_components: args.variance_components,
        ..Options::default()
    };
    SolveJob { method, options }
}

/// Output of records: lines at once, so that finished results are kept; the table at the end, when its column widths are
/// known.
struct ResultOutput<'a> {
    args: &'a SolveArgs,
    records: Vec<ImageRecord>,
    /// Complete records for the report on images, if there is one.
    kept: Option<Vec<ImageRecord>>,
    all_solved: bool,
}

impl<'a> ResultOutput<'a> {
    fn new(args: &'a SolveArgs, keep_records: bool) -> Self {
        Self {
            args,
            records: vec![],
            kept: keep_records.then(Vec::new),
            all_solved: true,
        }
    }

    fn take_record(&mut self, record: ImageRecord) -> TaskResult<()> {
        self.all_solved &= record.is_solved();
        if let Some(kept) = &mut self.kept {
            kept.push(record.clone());
        }
        if self.args.json {
            return print_json(&record);
        }
        // Fields that the table does not show are dropped: a store has thousands of records.
        let (model, quality) = Default::default();
        self.records.push(ImageRecord {
            model,
            quality,
            curve: Vec::new(),
            ..record
        });
        Ok(())
    }

    fn finish(self) -> TaskResult<Completion> {
        if !self.records.is_empty() {
            print_line(&table::results_text(&self.records, self.args.wide))?;
        }
        Ok(Completion::from_success(self.all_solved))
    }
}
