//! A plan for a wing of which only the main dimensions are known: an installation is made of them, and written where asked.

use std::path::Path;

use crate::cli::{Failure, RIGHTS, unwritable};
use crate::installation::{self, Installation};
use crate::measure::geometry::Lens;
use crate::measure::plan::{self, Draft, PlanOptions};
use crate::measure::setup::{Orientation, Setup, Uncertainty};
use crate::report::layout_figure;

/// Of a wing that has no installation yet.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "A wing that has no installation yet (not with --installation)")]
pub struct DraftArgs {
    /// From the camera to the wing tip along the span, m
    #[arg(long, value_name = "M", requires_all = ["height", "chord", "focal", "sensor"], conflicts_with = "installation")]
    pub span: Option<f64>,
    /// Camera above the skin at the root, m; the wing is taken to lie level
    #[arg(long, value_name = "M", requires = "span")]
    height: Option<f64>,
    /// Chord at the root, m
    #[arg(long, value_name = "M", requires = "span")]
    chord: Option<f64>,
    /// Focal length, mm
    #[arg(long, value_name = "MM", requires = "span")]
    focal: Option<f64>,
    /// Sensor: pixels across, pixels down, micrometres from one to the next
    #[arg(long, value_name = "WxHxUM", requires = "span", value_parser = sensor)]
    sensor: Option<Sensor>,
    /// Markers on the wing, the pair at the tip included
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u16).range(5..=200))]
    markers: u16,
    /// Marks that are rigid to the cabin, in the frame's corners
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=4))]
    fixed: u8,
}

/// A sensor as it is bought.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sensor {
    width: u32,
    height: u32,
    pitch_um: f64,
}

fn sensor(text: &str) -> Result<Sensor, String> {
    let parts: Vec<&str> = text.split(['x', 'X']).collect();
    let fault = || "give pixels across, pixels down and micrometres, as in 4000x3000x1.54".to_owned();
    let [width, height, pitch] = parts[..] else { return Err(fault()) };
    let side = |t: &str| t.parse().ok().filter(|n: &u32| (100..=20_000).contains(n)).ok_or_else(fault);
    let pitch_um = pitch.parse().ok().filter(|p: &f64| (0.3..=50.0).contains(p)).ok_or_else(fault)?;
    Ok(Sensor { width: side(width)?, height: side(height)?, pitch_um })
}

/// What of a wing can be planned with: name, value, limits, unit.
type Limited = (&'static str, Option<f64>, (f64, f64), &'static str);

impl DraftArgs {
    /// The wing that is meant; `None` where none is.
    fn draft(&self) -> Result<Option<Draft>, Failure> {
        let (Some(span_m), Some(height_m), Some(chord_m), Some(focal_mm), Some(sensor)) =
            (self.span, self.height, self.chord, self.focal, self.sensor)
        else {
            return Ok(None);
        };
        let limited: [Limited; 4] = [
            ("--span", self.span, (3.0, 90.0), "m"),
            ("--height", self.height, (0.1, 30.0), "m"),
            ("--chord", self.chord, (0.1, 30.0), "m"),
            ("--focal", self.focal, (0.5, 1000.0), "mm"),
        ];
        let off = limited
            .iter()
            .find(|(_, value, (low, high), _)| value.is_some_and(|v| !(*low..=*high).contains(&v)));
        if let Some((name, _, (low, high), unit)) = off {
            return Err(Failure::Usage(format!("{name} must be from {low} to {high} {unit}")));
        }
        let focal_px = 1e3 * focal_mm / sensor.pitch_um;
        let centre = |side: u32| 0.5 * (f64::from(side) - 1.0);
        let (cx, cy) = (centre(sensor.width), centre(sensor.height));
        Ok(Some(Draft {
            span_m,
            height_m,
            chord_m,
            lens: Lens::pinhole(sensor.width, sensor.height, focal_px, cx, cy),
            markers: usize::from(self.markers),
            fixed: usize::from(self.fixed),
        }))
    }

    /// An installation of that wing with the best of the layouts that are tried.
    ///
    /// # Errors
    /// Where a number is beyond what can be planned with, or no layout can be adjusted.
    pub fn installation(&self, options: &PlanOptions, frames: usize) -> Result<Installation, Failure> {
        let Some(draft) = self.draft()? else {
            return Err(Failure::Usage(
                "name the installation, or the wing: --span --height --chord --focal --sensor".into(),
            ));
        };
        let folder = tempfile::tempdir()
            .map_err(|e| Failure::Failed(format!("no folder for drafts: {e}; {RIGHTS}")))?;
        let mut first = bare(&draft);
        first.markers = plan::layout(&draft, options.tip_deflection_m);
        write(folder.path(), &first)?;
        let mut installation = installation::load(folder.path())?;
        let best = plan::best_layout(&draft, &installation.setup, options, frames);
        installation.setup = best.map_err(|e| Failure::Failed(format!("no plan: {e}")))?;
        Ok(installation)
    }
}

/// The wing without its markers; what nobody has stated is as an installation leaves it.
fn bare(draft: &Draft) -> Setup {
    Setup {
        name: format!("plan of a wing of {} m", draft.span_m),
        lens: draft.lens,
        projection_centre_m: nalgebra::Vector3::zeros(),
        projection_centre_sigma_m: 0.002,
        mount_repeatability_px: 10.0,
        span_direction: nalgebra::Vector2::new(1.0, 0.0),
        stated_side: Some(crate::measure::setup::Side::Right),
        root_offset_m: ROOT_OFFSET_M.min(0.1 * draft.span_m),
        axis_chord_offset_m: None,
        skin_height: None,
        uncertainty: Uncertainty::default(),
        thermal: None,
        torsion: vec![],
        markers: vec![],
        tie_points: vec![],
        cad_similarity: false,
        window: None,
    }
}

/// From the camera to where bending begins, as in the template that `wingd init` writes.
const ROOT_OFFSET_M: f64 = 0.6;

/// Writes a layout: `installation.toml`, `camera.toml`, `survey.csv` to be replaced by the true survey, and the drawing.
///
/// # Errors
/// Where a file cannot be written.
pub fn write_layout(
    folder: &Path,
    setup: &Setup,
    attitude: &Orientation,
    tip_deflection_m: f64,
) -> Result<(), Failure> {
    write(folder, setup)?;
    let drawing = folder.join("layout.svg");
    std::fs::write(&drawing, layout_figure::figure(setup, attitude, tip_deflection_m))
        .map_err(unwritable(&drawing, RIGHTS))
}

fn write(folder: &Path, setup: &Setup) -> Result<(), Failure> {
    let heads = [
        "# Written by wingd plan. The survey frame has its origin in the lens, x outboard, z up.\n",
        "# A template: glue the markers about here, then put what the total station measures in the place of these numbers.\n",
    ];
    installation::write_installation(folder, setup, heads)
        .map_err(|(file, error)| unwritable(&file, RIGHTS)(error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_is_read_or_refused() {
        assert_eq!(sensor("4000x3000x1.54"), Ok(Sensor { width: 4000, height: 3000, pitch_um: 1.54 }));
        for odd in
            ["4000x3000", "4000x3000x0", "x3000x1.5", "4000x3000x1.54x2", "99999x3000x1.5", "4000x3000xNaN"]
        {
            assert!(sensor(odd).is_err(), "{odd}");
        }
    }
}
