//! Options of a plan for a wing of which only the main dimensions are known.

use wingd_base::failure::{Failure, TaskResult};
use wingd_measure::geometry::Lens;
use wingd_measure::plan::LayoutDraft;
use wingd_measure::setup::WingSide;

/// Dimensions of a wing that has no installation yet.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "A wing that has no installation yet (not with --installation)")]
pub struct DraftArgs {
    /// Distance from the camera to the wing tip along the span, m
    #[arg(long, value_name = "M", requires_all = ["height", "chord", "focal", "sensor"], conflicts_with = "installation")]
    pub reach: Option<f64>,
    /// Side of the wing; without it a right one is drawn, and `side` is left to you
    #[arg(long, requires = "reach", value_parser = ["left", "right"])]
    side: Option<String>,
    /// Camera above the skin at the root, m; the wing is assumed level
    #[arg(long, value_name = "M", requires = "reach")]
    height: Option<f64>,
    /// Chord at the root, m
    #[arg(long, value_name = "M", requires = "reach")]
    chord: Option<f64>,
    /// Focal length, mm
    #[arg(long, value_name = "MM", requires = "reach")]
    focal: Option<f64>,
    /// Sensor: pixels across, pixels down, pixel pitch in micrometres
    #[arg(long, value_name = "WxHxUM", requires = "reach", value_parser = parse_sensor)]
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
    let fault = || {
        "give pixels across, pixels down and the pixel pitch in micrometres, for example 4000x3000x1.54".to_owned()
    };
    let [width, height, pitch] = parts[..] else {
        return Err(fault());
    };
    let side = |t: &str| {
        t.parse()
            .ok()
            .filter(|n: &u32| (100..=20_000).contains(n))
            .ok_or_else(fault)
    };
    let pitch_um = pitch
        .parse()
        .ok()
        .filter(|p: &f64| (0.3..=50.0).contains(p))
        .ok_or_else(fault)?;
    Ok(Sensor {
        width: side(width)?,
        height: side(height)?,
        pitch_um,
    })
}

impl DraftArgs {
    /// Returns the side of the wing if it is given.
    pub fn wing_side(&self) -> Option<WingSide> {
        self.side.as_deref().map(|side| {
            if side == "left" {
                WingSide::Left
            } else {
                WingSide::Right
            }
        })
    }

    /// Returns the dimensions.
    ///
    /// # Errors
    /// Returns an error if a dimension is missing or out of range.
    pub fn to_draft(&self) -> TaskResult<LayoutDraft> {
        let (Some(span_m), Some(height_m), Some(chord_m), Some(focal_mm), Some(sensor)) =
            (self.reach, self.height, self.chord, self.focal, self.sensor)
        else {
            let what =
                "name the installation, or the wing: --reach --height --chord --focal --sensor";
            return Err(Failure::Usage(what.into()));
        };
        let limited = [
            ("--reach", span_m, (3.0, 90.0), "m"),
            ("--height", height_m, (0.1, 30.0), "m"),
            ("--chord", chord_m, (0.1, 30.0), "m"),
            ("--focal", focal_mm, (0.5, 1000.0), "mm"),
        ];
        if let Some((name, _, (low, high), unit)) = limited
            .iter()
            .find(|(_, v, (low, high), _)| !(*low..=*high).contains(v))
        {
            return Err(Failure::Usage(format!(
                "{name} must be from {low} to {high} {unit}"
            )));
        }
        let focal_px = 1e3 * focal_mm / sensor.pitch_um;
        let centre = |side: u32| 0.5 * (f64::from(side) - 1.0);
        let (cx, cy) = (centre(sensor.width), centre(sensor.height));
        Ok(LayoutDraft {
            side: self.wing_side().unwrap_or(WingSide::Right),
            span_m,
            height_m,
            chord_m,
            lens: Lens::pinhole(sensor.width, sensor.height, focal_px, cx, cy),
            markers: usize::from(self.markers),
            fixed: usize::from(self.fixed),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_is_read_or_refused() {
        assert_eq!(
            parse_sensor("4000x3000x1.54"),
            Ok(Sensor {
                width: 4000,
                height: 3000,
                pitch_um: 1.54
            })
        );
        for odd in [
            "4000x3000",
            "4000x3000x0",
            "x3000x1.5",
            "4000x3000x1.54x2",
            "99999x3000x1.5",
            "4000x3000xNaN",
        ] {
            assert!(parse_sensor(odd).is_err(), "{odd}");
        }
    }
}
