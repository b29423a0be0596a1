//! `wingd solve` gives one result per image.

mod images;
mod marks;
mod report;
mod store;

use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::{Done, Failure, pictures, print};
use crate::measure::adjust::{Method, Options, SigmaKind};
use crate::pipeline::Job;
use crate::record::ImageRecord;
use crate::report::{protocol, table};
use crate::store::layout;

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
    /// The installation, with its orientation [default: installation/ of this folder; of a store: the one kept there that
    /// its results came from]
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// How the deflection is modelled
    #[arg(long, value_enum, default_value = "spatial")]
    method: MethodName,
    /// Adjust all the frames together (spatial). Of a store: name the flight to solve, for example
    /// --flight f0001 [default: every flight]
    #[arg(long, value_name = "FLIGHT", num_args = 0..=1, require_equals = true)]
    flight: Option<Option<String>>,
    /// The same as --flight without a name: also the frames of each flight of a store together
    #[arg(long)]
    together: bool,
    /// Which mounting of the camera each frame belongs to (image,mounting); ground: not remounted since the ground
    /// frames [default: remounts are looked for in the frames]
    #[arg(long, value_name = "FILE.csv")]
    mountings: Option<PathBuf>,
    /// Image points measured by hand (id,u_px,v_px,sigma_px, of several images also image): beside images they are added
    /// to what is detected, by id; alone they are solved instead of an image
    #[arg(long, value_name = "FILE.csv")]
    observations: Option<PathBuf>,
    /// Beside images: nothing is detected, the points measured by hand stand alone
    #[arg(long, requires_all = ["observations", "images"])]
    observations_only: bool,
    /// Also write figures and tables as one HTML file
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Which standard deviations [default: posterior where the global test rejects]
    #[arg(long, value_enum)]
    sigma: Option<SigmaName>,
    /// Terms of the curvature, 1 to 10 [default: 8 or 10, chosen by test; with --flight 8]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=10))]
    curvature_terms: Option<u8>,
    /// Estimate variance components of image and survey
    #[arg(long)]
    variance_components: bool,
    /// Of a store: hold air and temperatures as the installation states them, though there are aircraft data
    #[arg(long)]
    no_aircraft_data: bool,
    /// Of a store: leave out what people marked in its frames (`wingd mark`)
    #[arg(long)]
    no_marks: bool,
    /// Print the readable protocol of each adjustment
    #[arg(long, conflicts_with = "json")]
    protocol: bool,
    /// One JSON object per image
    #[arg(long)]
    json: bool,
    /// Every column of the tables, however wide [default: those that fit 80 characters]
    #[arg(long)]
    wide: bool,
    /// Images worked on at once [default: the cores]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    jobs: usize,
    /// Frames: JPEG, PNG, PNM or TIFF, or folders of them; or a store, whose frames get results beside their old ones
    #[arg(required_unless_present = "observations", value_name = "IMAGE|FOLDER|STORE")]
    images: Vec<PathBuf>,
}

impl Args {
    /// Whether the frames of a flight are adjusted together.
    fn together(&self) -> bool {
        self.together || self.flight == Some(None)
    }
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    if args.together() && matches!(args.method, MethodName::Profile) {
        return Err(Failure::Usage(
            "--flight adjusts with the spatial method; leave --method profile out".into(),
        ));
    }
    if let [store] = args.images.as_slice()
        && is_store(store)
    {
        if !store.join(layout::STORE_FILE).exists()
            && std::fs::read_dir(store).is_ok_and(|mut d| d.next().is_none())
        {
            let what = format!(
                "{}: holds nothing; name pictures, a folder of pictures, or a store (`wingd import` makes one of pictures)",
                store.display()
            );
            return Err(Failure::Failed(what));
        }
        if args.observations.is_some() {
            return Err(Failure::Usage("--observations belongs to pictures, not to a store".into()));
        }
        return store::run(args, store);
    }
    if let Some(Some(flight)) = &args.flight {
        return Err(Failure::Usage(format!(
            "--flight {flight} names a flight of a store; name the store too"
        )));
    }
    images::run(args)
}

/// Whether a folder is meant as a store: it is one, or holds no pictures that could be meant instead.
fn is_store(folder: &Path) -> bool {
    folder.is_dir() && (folder.join(layout::STORE_FILE).exists() || !pictures::holds_any(folder))
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

/// Where records go: lines and protocols at once, so that what is done is kept; the table with its widths at the end.
struct Output<'a> {
    args: &'a Args,
    records: Vec<ImageRecord>,
    /// Whole, where a report is to be made of pictures.
    kept: Option<Vec<ImageRecord>>,
    all_well: bool,
}

impl<'a> Output<'a> {
    fn new(args: &'a Args) -> Self {
        Self { args, records: vec![], kept: None, all_well: true }
    }

    fn keeping(args: &'a Args) -> Self {
        Self { kept: args.report.as_ref().map(|_| vec![]), ..Self::new(args) }
    }

    fn take(&mut self, record: ImageRecord) -> Result<(), Failure> {
        self.all_well &= record.is_solved();
        if let Some(kept) = &mut self.kept {
            kept.push(record.clone());
        }
        if self.args.protocol {
            return print(&protocol::protocol(&record));
        }
        if self.args.json {
            let line = serde_json::to_string(&record).map_err(|error| {
                Failure::Failed(format!("{}: result cannot be written as JSON: {error}", record.image))
            })?;
            return print(&line);
        }
        // What the table does not show is let go: a store has thousands of records.
        let (model, quality) = Default::default();
        self.records.push(ImageRecord { model, quality, curve: Vec::new(), ..record });
        Ok(())
    }

    fn end(self) -> Result<Done, Failure> {
        if !self.records.is_empty() {
            print(&table::results(&self.records, self.args.wide))?;
        }
        Ok(Done::all(self.all_well))
    }
}
