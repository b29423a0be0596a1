//! `wingd convert` reads and writes the camera files of other programs.

use std::path::PathBuf;

use super::{Completion, Failure, TaskResult, print_line};
use crate::exchange::{self, CameraFormat, ReadCamera};
use crate::installation;

/// Convert a camera from or to the files of OpenCV, ROS, Kalibr and mrcal, and print the parameters read
#[derive(clap::Args)]
pub struct ConvertArgs {
    /// Camera file to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// File to write: camera.toml, NAME.cameramodel, camchain.yaml, camera_info.yaml, NAME.yaml (OpenCV)
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Camera of IN if it holds several: Kalibr's cam0, cam1
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Format of IN if it cannot be derived from its name or keys
    #[arg(long, value_name = "FORMAT")]
    from: Option<CameraFormat>,
    /// Format of OUT if it cannot be derived from its name
    #[arg(long, value_name = "FORMAT")]
    to: Option<CameraFormat>,
}

pub(super) fn run(args: &ConvertArgs) -> TaskResult<Completion> {
    let to = args.to.or_else(|| exchange::output_format(&args.output));
    let to = to.ok_or_else(|| {
        Failure::Usage(format!(
            "the name {} does not determine its format; give --to",
            args.output.display()
        ))
    })?;
    let read = exchange::read_exchange(&args.input, args.from, args.camera.as_deref())?;
    exchange::write_exchange(&args.output, &read.lens, to).map_err(Failure::from_error)?;
    print_line(&conversion_text(args, &read, to))?;
    Ok(Completion::All)
}

/// Lists the parameters read, those dropped, and warnings.
fn conversion_text(args: &ConvertArgs, read: &ReadCamera, to: CameraFormat) -> String {
    let l = &read.lens;
    let name = read
        .name
        .as_ref()
        .map_or(String::new(), |name| format!(", {name}"));
    let mut text = format!(
        "{}: {}{name}, {}\n",
        installation::printable_path(&args.input),
        read.format,
        read.model
    );
    text += &format!(
        "  {} x {} px, fx {} fy {} cx {} cy {} px\n",
        l.width, l.height, l.fx, l.fy, l.cx, l.cy
    );
    text += &format!(
        "  k1 {} k2 {} p1 {} p2 {} k3 {}",
        l.k1, l.k2, l.p1, l.p2, l.k3
    );
    if l.denominator != [0.0; 3] {
        let [k4, k5, k6] = l.denominator;
        text += &format!(" k4 {k4} k5 {k5} k6 {k6}");
    }
    let dropped = if read.left.is_empty() {
        "nothing".to_owned()
    } else {
        read.left.join(", ")
    };
    text += &format!("\n  dropped: {dropped}\n");
    read.remarks
        .iter()
        .for_each(|remark| text += &format!("  warning: {remark}\n"));
    text + &format!(
        "{}: written, {to}",
        installation::printable_path(&args.output)
    )
}
