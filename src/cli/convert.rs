//! `wingd convert`: a camera from and to other programs' files.

use std::path::PathBuf;

use super::{Done, Failure};
use crate::installation::{self, CameraFormat};

/// A camera from and to the files of OpenCV, ROS, Kalibr and mrcal
#[derive(clap::Args)]
pub struct Args {
    /// The camera as it is
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Where it is written: camera.toml, NAME.cameramodel, camchain.yaml, camera_info.yaml, NAME.yaml (OpenCV)
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Format of IN, where its ending does not tell
    #[arg(long, value_name = "FORMAT")]
    from: Option<Format>,
    /// Format of OUT, where its name does not tell
    #[arg(long, value_name = "FORMAT")]
    to: Option<Format>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    /// camera.toml
    Wingd,
    /// OpenCV's YAML
    Opencv,
    /// ROS camera_info
    Ros,
    /// Kalibr's camchain
    Kalibr,
    /// mrcal's cameramodel
    Mrcal,
}

impl From<Format> for CameraFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Wingd => Self::Wingd,
            Format::Opencv => Self::Opencv,
            Format::Ros => Self::Ros,
            Format::Kalibr => Self::Kalibr,
            Format::Mrcal => Self::Mrcal,
        }
    }
}

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let text = std::fs::read_to_string(&args.input).ok();
    let told = |given: Option<Format>, file: &PathBuf, text: Option<&str>, option: &str| {
        given.map(CameraFormat::from).or_else(|| installation::format_of(file, text)).ok_or_else(|| {
            Failure::Usage(format!("the name {} does not tell its format; give {option}", file.display()))
        })
    };
    let from = told(args.from, &args.input, text.as_deref(), "--from")?;
    let to = told(args.to, &args.output, None, "--to")?;
    let lens = installation::read_exchange(&args.input, from)?;
    installation::write_exchange(&args.output, &lens, to).map_err(Failure::Undone)?;
    if from == CameraFormat::Wingd && text.is_some_and(|t| t.contains("covariance")) {
        eprintln!("the covariance stays behind: {} has no place for it", args.output.display());
    }
    Ok(Done::All)
}
