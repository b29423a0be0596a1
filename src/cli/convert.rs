//! `wingd convert`: a camera from and to other programs' files.

use std::path::PathBuf;

use super::{Done, Failure, print};
use crate::installation::{self, CameraFormat, ReadCamera};

/// A camera from and to the files of OpenCV, ROS, Kalibr and mrcal; what is read is shown
#[derive(clap::Args)]
pub struct Args {
    /// The camera as it is
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Where it is written: camera.toml, NAME.cameramodel, camchain.yaml, camera_info.yaml, NAME.yaml (OpenCV)
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Which camera of IN, where it holds several: Kalibr's cam0, cam1
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Format of IN, where neither its name nor its keys tell
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
    /// OpenCV's YAML; XML and JSON are read
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
    let to = args.to.map(CameraFormat::from).or_else(|| installation::format_of_name(&args.output));
    let to = to.ok_or_else(|| {
        Failure::Usage(format!("the name {} does not tell its format; give --to", args.output.display()))
    })?;
    let from = args.from.map(CameraFormat::from);
    let read = installation::read_exchange(&args.input, from, args.camera.as_deref())?;
    installation::write_exchange(&args.output, &read.lens, to).map_err(|e| Failure::Failed(e.to_string()))?;
    print(&shown(args, &read, to))?;
    Ok(Done::All)
}

/// What was read, term by term, what stayed behind, and what is to be looked at.
fn shown(args: &Args, read: &ReadCamera, to: CameraFormat) -> String {
    let l = &read.lens;
    let name = read.name.as_ref().map_or(String::new(), |name| format!(", {name}"));
    let mut text =
        format!("{}: {}{name}, {}\n", installation::shown_path(&args.input), read.format, read.model);
    text += &format!("  {} x {} px, fx {} fy {} cx {} cy {} px\n", l.width, l.height, l.fx, l.fy, l.cx, l.cy);
    text += &format!("  k1 {} k2 {} p1 {} p2 {} k3 {}", l.k1, l.k2, l.p1, l.p2, l.k3);
    if l.denominator != [0.0; 3] {
        let [k4, k5, k6] = l.denominator;
        text += &format!(" k4 {k4} k5 {k5} k6 {k6}");
    }
    let dropped = if read.left.is_empty() { "nothing".to_owned() } else { read.left.join(", ") };
    text += &format!("\n  dropped: {dropped}\n");
    read.remarks.iter().for_each(|remark| text += &format!("  to be looked at: {remark}\n"));
    text + &format!("{}: written, {to}", installation::shown_path(&args.output))
}
