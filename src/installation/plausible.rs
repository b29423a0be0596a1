//! Numbers that are each in order, but cannot belong together: units, span, root, which wing, two markers in one place.

use std::path::Path;

use nalgebra::{Matrix2, Vector2, Vector3};

use super::{Reader, toml_file};
use crate::measure::setup::{Setup, Side};

/// Beyond any wing, m: the widest aircraft that flew measures 117 m from tip to tip.
const MAX_WING_LENGTH_M: f64 = 100.0;
/// Markers lie along a line where their deviation along it is this many times that across.
const ELONGATED: f64 = 3.0;
/// Angle between that line and the span that no planform explains, degrees: a tapered wing's markers keep to 10.
const MAX_SKEW_DEG: f64 = 30.0;

/// Faults that only the numbers together show. Wrong units put all the rest out: then nothing else is said.
pub(super) fn check(reader: &mut Reader, setup: &Setup, survey: &str) {
    let file = reader.directory.join(toml_file::FILE);
    let survey = reader.directory.join(survey);
    let before = reader.faults.len();
    check_units(reader, &file, &survey, setup);
    if reader.faults.len() == before {
        check_sign(reader, &file, setup);
    }
    if reader.faults.len() == before {
        check_skew(reader, &file, setup);
        check_root(reader, &file, setup);
    }
    check_side(reader, &file, setup);
    check_overlap(reader, &survey, setup);
}

/// Markers and camera lie within a wing's length of each other.
fn check_units(reader: &mut Reader, file: &Path, survey: &Path, setup: &Setup) {
    let points = || setup.markers.iter().map(|m| m.position_m);
    let mean = points().sum::<Vector3<f64>>() / setup.markers.len().max(1) as f64;
    let reach_m = points().map(|p| (p - mean).norm()).fold(0.0, f64::max);
    if reach_m > MAX_WING_LENGTH_M {
        let problem = format!("the markers lie up to {:.0} m apart", 2.0 * reach_m);
        reader.fault(survey, "columns x_m, y_m, z_m", problem, "give metres, not millimetres or feet");
        return;
    }
    let nearest_m = points().map(|p| (p - setup.projection_centre_m).norm()).fold(f64::INFINITY, f64::min);
    if nearest_m > MAX_WING_LENGTH_M {
        let problem = format!("lies {nearest_m:.0} m from the nearest marker");
        let mend = "give it in metres, in the survey's frame";
        reader.fault(file, "camera.projection_centre_m", problem, mend);
    }
}

/// The span points to where the markers are.
fn check_sign(reader: &mut Reader, file: &Path, setup: &Setup) {
    let wing = setup.on_the_wing();
    let (markers, behind) = (wing.len(), wing.iter().filter(|(_, point)| point.x < 0.0).count());
    if 2 * behind > markers {
        let [dx, dy] = [setup.span_direction.x, setup.span_direction.y];
        let problem = format!("is [{dx}, {dy}], but {behind} of {markers} markers lie the other way");
        let mend = format!(
            "it points from the camera to the tip: [{}, {}]? else check camera.projection_centre_m",
            -dx, -dy
        );
        reader.fault(file, "wing.span_direction", problem, mend);
    }
}

/// The span runs along the markers, as far as these lie along a line.
fn check_skew(reader: &mut Reader, file: &Path, setup: &Setup) {
    let Some(line) = line_of_markers(setup) else { return };
    let span = setup.span_direction.normalize();
    let skew_deg = span.dot(&line).abs().min(1.0).acos().to_degrees();
    if skew_deg > MAX_SKEW_DEG {
        let outboard = line * span.dot(&line).signum();
        let [dx, dy] = [setup.span_direction.x, setup.span_direction.y];
        let problem =
            format!("is [{dx}, {dy}], {skew_deg:.0} degrees off the line along which the markers lie");
        let mend = format!(
            "give the direction from the root to the tip, near [{:.3}, {:.3}]; else compare the survey's x and y",
            outboard.x, outboard.y
        );
        reader.fault(file, "wing.span_direction", problem, mend);
    }
}

/// Direction of the markers' greatest horizontal variance; `None` where they lie in a heap.
fn line_of_markers(setup: &Setup) -> Option<Vector2<f64>> {
    let wing = setup.markers.iter().filter(|m| !m.fixed);
    let points: Vec<Vector2<f64>> = wing.map(|m| m.position_m.xy()).collect();
    let mean = points.iter().sum::<Vector2<f64>>() / points.len().max(1) as f64;
    let moments: Matrix2<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let axes = moments.symmetric_eigen();
    let longest = axes.eigenvalues.imax();
    let (long, short) = (axes.eigenvalues[longest], axes.eigenvalues[1 - longest].max(0.0));
    (long > ELONGATED * ELONGATED * short).then(|| axes.eigenvectors.column(longest).into_owned())
}

/// Bending starts inboard of most of the markers.
fn check_root(reader: &mut Reader, file: &Path, setup: &Setup) {
    let (wing, root_m) = (setup.on_the_wing(), setup.root_offset_m);
    let (markers, inboard) = (wing.len(), wing.iter().filter(|(_, point)| point.x <= root_m).count());
    if 2 * inboard > markers {
        let problem = format!("is {root_m} m, but {inboard} of {markers} markers lie inboard of it");
        let mend = "give the metres along the span from the camera to where bending starts";
        reader.fault(file, "wing.root_offset_m", problem, mend);
    }
}

/// Leading markers lie ahead of trailing ones, and so on every pair.
fn check_side(reader: &mut Reader, file: &Path, setup: &Setup) {
    let Some(side) = setup.side() else { return };
    let name = if side == Side::Left { "left" } else { "right" };
    for (k, pair) in setup.torsion.iter().enumerate() {
        if setup.side_of_pair(pair).is_some_and(|other| other != side) {
            let place = format!("torsion[{k}]");
            let problem = format!("its leading marker lies behind its trailing one on a {name} wing");
            reader.fault(file, &place, problem, "exchange leading and trailing, or correct wing.side");
        }
    }
}

/// Two markers whose prints would lie on each other.
fn check_overlap(reader: &mut Reader, survey: &Path, setup: &Setup) {
    for (k, marker) in setup.markers.iter().enumerate() {
        let apart_m = |m: f64, other: &Vector3<f64>| (marker.position_m - other).norm() - m;
        let overlaps = |other: &&crate::measure::setup::SurveyMarker| {
            apart_m(0.5 * (marker.diameter_m + other.diameter_m), &other.position_m) < 0.0
        };
        if let Some(other) = setup.markers[..k].iter().find(overlaps) {
            let apart_m = apart_m(0.0, &other.position_m);
            let problem = format!("lies {apart_m:.3} m from {}, so that the two would overlap", other.id);
            let mend = "survey both again, or keep one of them";
            reader.fault(survey, &format!("marker \"{}\"", marker.id), problem, mend);
        }
    }
}
