//! Plan for a wing of which only the main dimensions are known: an installation is derived from them, and written on
//! request.

use std::path::Path;

use crate::cli::{CHECK_WRITE_ACCESS, Failure, write_failure};
use crate::installation::{self, Installation};
use crate::measure::geometry::Lens;
use crate::measure::plan::{self, LayoutDraft, PlanOptions};
use crate::measure::setup::{Orientation, Setup, SetupUncertainty};
use crate::report::layout_figure;

/// Dimensions of a wing that has no installation yet.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "A wing that has no installation yet (not with --installation)")]
pub struct DraftArgs {
    /// Distance from the camera to the wing tip along the span, m
    #[arg(long, value_name = "M", requires_all = ["height", "chord", "focal", "sensor"], conflicts_with = "installation")]
    pub span: Option<f64>,
    /// Camera above the skin at the root, m; the wing is assumed level
    #[arg(long, value_name = "M", requires = "span")]
    height: Option<f64>,
    /// Chord at the root, m
    #[arg(long, value_name = "M", requires = "span")]
    chord: Option<f64>,
    /// Focal length, mm
    #[arg(long, value_name = "MM", requires = "span")]
    focal: Option<f64>,
    /// Sensor: pixels across, pixels down, pixel pitch in micrometres
    #[arg(long, value_name = "WxHxUM", requires = "span", value_parser = parse_sensor)]
    sensor: Option<Sensor>,
    /// Number of markers on the wing, including the pair at the tip
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(5..=200))]
    markers: u16,
    /// Number of fixed targets, rigid to the cabin, in the corners of the image
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=4))]
    fixed: u8,
}

/// A sensor by its data sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sensor {
    width: u32,
    height: u32,
    pitch_um: f64,
}

fn parse_sensor(text: &str) -> Result<Sensor, String> {
    let parts: Vec<&str> = text.split(['x', 'X']).collect();
    let fault =
        || "give pixels across, pixels down and the pixel pitch in micrometres, for example 4000x3000x1.54".to_owned();
    let [width, height, pitch] = parts[..] else { return Err(fault()) };
    let side = |t: &str| t.parse().ok().filter(|n: &u32| (100..=20_000).contains(n)).ok_or_else(fault);
    let pitch_um = pitch.parse().ok().filter(|p: &f64| (0.3..=50.0).contains(p)).ok_or_else(fault)?;
    Ok(Sensor { width: side(width)?, height: side(height)?, pitch_um })
}

/// Dimension of a wing for planning: name, value, limits, unit.
type DimensionLimit = (&'static str, Option<f64>, (f64, f64), &'static str);

impl DraftArgs {
    /// Returns the dimensions; `None` if any is missing.
    fn to_draft(&self) -> Result<Option<LayoutDraft>, Failure> {
        let (Some(span_m), Some(height_m), Some(chord_m), Some(focal_mm), Some(sensor)) =
            (self.span, self.height, self.chord, self.focal, self.sensor)
        else {
            return Ok(None);
        };
        let limited: [DimensionLimit; 4] = [
            ("--span", self.span, (3.0, 90.0), "m"),
            ("--height", self.height, (0.1, 30.0), "m"),
            ("--chord", self.chord, (0.1, 30.0), "m"),
            ("--focal", self.focal, (0.5, 1000.0), "mm"),
        ];
        let off = limited.iter().find(|(_, value, (low, high), _)| value.is_some_and(|v| !(*low..=*high).contains(&v)));
        if let Some((name, _, (low, high), unit)) = off {
            return Err(Failure::Usage(format!("{name} must be from {low} to {high} {unit}")));
        }
        let focal_px = 1e3 * focal_mm / sensor.pitch_um;
        let centre = |side: u32| 0.5 * (f64::from(side) - 1.0);
        let (cx, cy) = (centre(sensor.width), centre(sensor.height));
        Ok(Some(LayoutDraft {
            span_m,
            height_m,
            chord_m,
            lens: Lens::pinhole(sensor.width, sensor.height, focal_px, cx, cy),
            markers: usize::from(self.markers),
            fixed: usize::from(self.fixed),
        }))
    }

    /// Creates an installation of the wing with the best layout of those tried.
    ///
    /// # Errors
    /// Returns an error if a dimension is out of range, or no layout can be adjusted.
    pub fn draft_installation(&self, options: &PlanOptions, frames: usize) -> Result<Installation, Failure> {
        let Some(draft) = self.to_draft()? else {
            return Err(Failure::Usage(
                "name the installation, or the wing: --span --height --chord --focal --sensor".into(),
            ));
        };
        let folder = tempfile::tempdir()
            .map_err(|e| Failure::Failed(format!("no temporary folder: {e}; {CHECK_WRITE_ACCESS}")))?;
        let mut first = setup_without_markers(&draft);
        first.markers = plan::even_layout(&draft, options.tip_deflection_m);
        write_setup(folder.path(), &first)?;
        let mut installation = installation::load(folder.path())?;
        let best = plan::best_layout(&draft, &installation.setup, options, frames);
        installation.setup = best.map_err(|e| Failure::Failed(format!("no plan: {e}")))?;
        Ok(installation)
    }
}

/// Returns the setup of the wing without its markers; other values are the defaults of an installation.
fn setup_without_markers(draft: &LayoutDraft) -> Setup {
    Setup {
        name: format!("plan of a wing of {} m", draft.span_m),
        lens: draft.lens,
        projection_centre_m: nalgebra::Vector3::zeros(),
        projection_centre_sigma_m: 0.002,
        mount_repeatability_px: 10.0,
        span_direction: nalgebra::Vector2::new(1.0, 0.0),
        configured_side: Some(crate::measure::setup::WingSide::Right),
        root_offset_m: DEFAULT_ROOT_OFFSET_M.min(0.1 * draft.span_m),
        axis_chord_offset_m: None,
        skin_height: None,
        uncertainty: SetupUncertainty::DEFAULT,
        thermal: None,
        torsion: vec![],
        markers: vec![],
        tie_points: vec![],
        cad_similarity: false,
        window: None,
    }
}

/// Distance from the camera to the bending root, as in the template of `wingd init`.
const DEFAULT_ROOT_OFFSET_M: f64 = 0.6;

/// Writes a layout: `installation.toml`, `camera.toml`, `survey.csv` to be replaced by the true survey, and the drawing.
///
/// # Errors
/// Returns an error if a file cannot be written.
pub fn write_layout(
    folder: &Path,
    setup: &Setup,
    attitude: &Orientation,
    tip_deflection_m: f64,
) -> Result<(), Failure> {
    write_setup(folder, setup)?;
    let drawing = folder.join("layout.svg");
    std::fs::write(&drawing, layout_figure::layout_svg(setup, attitude, tip_deflection_m))
        .map_err(write_failure(&drawing, CHECK_WRITE_ACCESS))
}

fn write_setup(folder: &Path, setup: &Setup) -> Result<(), Failure> {
    let heads = [
        "# Written by wingd plan. The survey frame has its origin in the lens, x outboard, z up.\n",
        "# A template: glue the markers near these positions, then replace the numbers by those of the total station.\n",
    ];
    installation::write_installation(folder, setup, heads)
        .map_err(|(file, error)| write_failure(&file, CHECK_WRITE_ACCESS)(error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_is_read_or_refused() {
        assert_eq!(parse_sensor("4000x3000x1.54"), Ok(Sensor { width: 4000, height: 3000, pitch_um: 1.54 }));
        for odd in ["4000x3000", "4000x3000x0", "x3000x1.5", "4000x3000x1.54x2", "99999x3000x1.5", "4000x3000xNaN"] {
            assert!(parse_sensor(odd).is_err(), "{odd}");
        }
    }
}
