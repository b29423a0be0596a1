//! Consistency checks of numbers that are individually valid: units, span, root, left or right wing, overlapping markers.

use std::path::Path;

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, U3, Vector2, Vector3};

use super::{INSTALLATION_FILE, Reader};
use wingd_base::fault::Fault;
use wingd_measure::identify::UNITS;
use wingd_measure::setup::{MAX_BREAKS, Setup, Shape, SurveyMarker, WingSide};

/// Largest length of a wing, m: the largest wingspan of an aircraft that has flown is 117 m.
const MAX_WING_LENGTH_M: f64 = 100.0;
/// Smallest ratio of the markers' extents along and across a line at which they define its direction.
const MIN_ELONGATION: f64 = 3.0;
/// Largest angle between that line and the span, degrees: markers on a tapered wing are within 10.
const MAX_SKEW_DEG: f64 = 30.0;

/// Reports errors that only a combination of numbers shows. Wrong units cause further errors, so only they are reported
/// then.
pub(super) fn check_plausibility(reader: &mut Reader, setup: &Setup, survey: &str) {
    let file = reader.directory.join(INSTALLATION_FILE);
    let survey = reader.directory.join(survey);
    let before = reader.faults.len();
    let survey_fault =
        |setup: &Setup| spread_fault(&survey, setup).or_else(|| vertical_fault(&survey, setup));
    if let Some(of_all) = survey_fault(setup) {
        let of_one = single_slip(&survey, setup, |rest| survey_fault(rest).is_none());
        reader.faults.push(of_one.unwrap_or(of_all));
    } else {
        check_distance(reader, &file, setup);
    }
    if reader.faults.len() == before {
        check_sign(reader, &file, setup);
    }
    if reader.faults.len() == before {
        check_skew(reader, &file, setup);
        check_root(reader, &file, setup);
        check_breaks(reader, &file, setup);
    }
    check_side(reader, &file, setup);
    check_flow(reader, &file, setup);
    check_overlap(reader, &survey, setup);
}

/// Returns the error of the one marker without which the others are plausible; `None` if there is not exactly one.
fn single_slip(
    survey: &Path,
    setup: &Setup,
    is_plausible: impl Fn(&Setup) -> bool,
) -> Option<Fault> {
    let without = |k: &usize| {
        let mut rest = setup.clone();
        rest.markers.remove(*k);
        is_plausible(&rest)
    };
    let mut found = (0..setup.markers.len()).filter(without);
    let (Some(only), None) = (found.next(), found.next()) else {
        return None;
    };
    let marker = &setup.markers[only];
    let [x, y, z] = marker.position_m.into();
    let others = setup.markers.iter().filter(|m| m.id != marker.id);
    let nearest_m = others
        .map(|m| (m.position_m - marker.position_m).norm())
        .fold(f64::INFINITY, f64::min);
    let problem = format!("is at [{x}, {y}, {z}], {nearest_m:.1} m from the nearest other marker");
    Some(Fault::of_marker(survey, &marker.id, problem, SLIP_REMEDY))
}

const SLIP_REMEDY: &str = "check its coordinates against the survey's records: a decimal point, a sign, exchanged columns";

/// Least number of markers of which one can contradict the others in plan.
const MIN_PLAN_MARKERS: usize = 6;
/// Distance from the others' line in plan beyond which a marker is doubtful, as a multiple of the largest of the others, and
/// with this margin, m: cranked wings and tips stay below.
const PLAN_OUTLIER: (f64, f64) = (3.0, 1.0);

/// Returns a warning about a marker that is far off the line of the others, as seen from above.
pub(super) fn plan_outlier(setup: &Setup, survey: &Path) -> Option<Fault> {
    let wing = setup.wing_markers();
    let off_line = |k: usize| {
        let others = || {
            wing.iter()
                .enumerate()
                .filter(|(j, _)| *j != k)
                .map(|(_, (_, p))| p)
        };
        let count = others().count() as f64;
        let mean = others().sum::<Vector3<f64>>() / count;
        let slope = others()
            .map(|p| (p.x - mean.x) * (p.z - mean.z))
            .sum::<f64>()
            / others().map(|p| (p.x - mean.x).powi(2)).sum::<f64>();
        let off = |p: &Vector3<f64>| (p.z - mean.z - slope * (p.x - mean.x)).abs();
        (off(&wing[k].1), others().map(off).fold(0.0, f64::max))
    };
    let (factor, margin_m) = PLAN_OUTLIER;
    let is_off = |k: &usize| {
        let (own, others) = off_line(*k);
        own > factor * others + margin_m
    };
    let found = (0..wing.len())
        .find(is_off)
        .filter(|_| wing.len() >= MIN_PLAN_MARKERS)?;
    let id = &setup.markers.get(wing[found].0)?.id;
    let problem = format!(
        "is {:.1} m off the line of the other markers, as seen from above",
        off_line(found).0
    );
    Some(Fault::of_marker(survey, id, problem, SLIP_REMEDY))
}

/// Returns an error if the markers are further apart than the ends of a wing.
fn spread_fault(survey: &Path, setup: &Setup) -> Option<Fault> {
    let points = || setup.markers.iter().map(|m| m.position_m);
    let mean = points().sum::<Vector3<f64>>() / setup.markers.len().max(1) as f64;
    let reach_m = points().map(|p| (p - mean).norm()).fold(0.0, f64::max);
    let problem = format!("the markers are up to {:.0} m apart", 2.0 * reach_m);
    let remedy = "give metres, not millimetres or feet";
    let fault = || Fault::new(survey, "columns x_m, y_m, z_m", problem, remedy);
    (reach_m > MAX_WING_LENGTH_M).then(fault)
}

/// Checks that the camera is within a wing's length of the markers.
fn check_distance(reader: &mut Reader, file: &Path, setup: &Setup) {
    let points = || setup.markers.iter().map(|m| m.position_m);
    let nearest_m = points()
        .map(|p| (p - setup.projection_centre_m).norm())
        .fold(f64::INFINITY, f64::min);
    if nearest_m > MAX_WING_LENGTH_M {
        let apart_m = |survey: f64, centre: f64| {
            points()
                .map(|p| (p * survey - setup.projection_centre_m * centre).norm())
                .fold(f64::INFINITY, f64::min)
        };
        let of_unit = |(name, m): &(&'static str, f64)| {
            [(*name, "the survey", *m, 1.0), (*name, "it", 1.0, *m)]
        };
        let nearest = UNITS
            .iter()
            .flat_map(of_unit)
            .min_by(|a, b| apart_m(a.2, a.3).total_cmp(&apart_m(b.2, b.3)));
        let (problem, remedy) = (
            format!("is {nearest_m:.0} m from the nearest marker"),
            nearest.map_or(String::new(), |(name, which, survey, centre)| {
                let apart_m = apart_m(survey, centre);
                format!("give both in metres, in one frame (with {which} in {name} they would be {apart_m:.0} m apart)")
            }),
        );
        reader.fault(file, "camera.projection_centre_m", problem, remedy);
    }
}

/// Largest angle between the vertical and the normal of the plane through the markers, degrees: dihedral, incidence and the
/// slope of a jacked aircraft are together smaller.
const MAX_TILT_DEG: f64 = 40.0;
/// Largest ratio of the markers' smallest extent to the next at which they define a plane.
const MAX_FLATNESS: f64 = 0.5;

/// Returns the principal axes of points with the sums of the squared distances from the mean along them.
pub(super) fn principal_axes(
    points: impl Iterator<Item = Vector3<f64>> + Clone,
) -> SymmetricEigen<f64, U3> {
    let mean = points.clone().sum::<Vector3<f64>>() / points.clone().count().max(1) as f64;
    points
        .map(|p| (p - mean) * (p - mean).transpose())
        .sum::<Matrix3<f64>>()
        .symmetric_eigen()
}

/// Returns an error if the markers are in a plane that is far from horizontal.
fn vertical_fault(survey: &Path, setup: &Setup) -> Option<Fault> {
    let wing = || {
        setup
            .markers
            .iter()
            .filter(|m| !m.fixed)
            .map(|m| m.position_m)
    };
    let axes = principal_axes(wing());
    let smallest = axes.eigenvalues.imin();
    // Of a single place all three are equal.
    let middle = (0..3)
        .find(|k| *k != smallest && *k != axes.eigenvalues.imax())
        .unwrap_or(smallest);
    let normal = axes.eigenvectors.column(smallest);
    let flatness = (axes.eigenvalues[smallest].max(0.0) / axes.eigenvalues[middle]).sqrt();
    let tilt_deg = normal.z.abs().min(1.0).acos().to_degrees();
    let up = ["x_m", "y_m", "z_m"][normal.iamax()];
    let problem = format!(
        "the markers' plane is {tilt_deg:.0} degrees off the horizontal: {up} seems to be the height"
    );
    let remedy = "give z upwards, here and in camera.projection_centre_m";
    (wing().count() > 3 && flatness < MAX_FLATNESS && tilt_deg > MAX_TILT_DEG)
        .then(|| Fault::new(survey, "column z_m", problem, remedy))
}

/// Checks that the span points towards the markers.
fn check_sign(reader: &mut Reader, file: &Path, setup: &Setup) {
    let wing = setup.wing_markers();
    let (markers, behind) = (
        wing.len(),
        wing.iter().filter(|(_, point)| point.x < 0.0).count(),
    );
    if 2 * behind > markers {
        let [dx, dy] = [setup.span_direction.x, setup.span_direction.y];
        let problem = format!(
            "is [{dx}, {dy}], but {behind} of {markers} markers are in the opposite direction"
        );
        let is_ahead = |axis: &usize| {
            let mut flipped = setup.clone();
            for m in &mut flipped.markers {
                m.position_m[*axis] *= -1.0;
            }
            let wing = flipped.wing_markers();
            2 * wing.iter().filter(|(_, p)| p.x < 0.0).count() < markers
        };
        let sign = (0..2).find(is_ahead).map_or(String::new(), |axis| {
            format!(" or the sign of {} in the survey", ["x_m", "y_m"][axis])
        });
        let remedy = format!(
            "it must point from the camera to the tip: try [{}, {}], or check camera.projection_centre_m{sign}",
            -dx, -dy
        );
        reader.fault(file, "wing.span_direction", problem, remedy);
    }
}

/// Checks that the span runs along the markers if they form a line.
fn check_skew(reader: &mut Reader, file: &Path, setup: &Setup) {
    if let Some(skew) = SpanSkew::of_setup(setup).filter(|skew| skew.angle_deg > MAX_SKEW_DEG) {
        reader.faults.push(skew.fault(file, setup));
    }
}

/// Line of the markers as seen from above, against the configured span.
pub(super) struct SpanSkew {
    /// Direction of the line, outboard.
    outboard: Vector2<f64>,
    pub(super) angle_deg: f64,
    /// Standard deviation of the angle: chordwise places of the markers are random, and a degree of taper.
    sigma_deg: f64,
}

/// Standard deviation of the line of markers on a tapered wing against its bending axis, degrees.
const LINE_SIGMA_DEG: f64 = 1.0;
/// Number of standard deviations beyond which the span contradicts the line of the markers.
const SKEW_SIGMAS: f64 = 3.0;

impl SpanSkew {
    /// Returns the angle between line and span; `None` if the markers form no line.
    pub(super) fn of_setup(setup: &Setup) -> Option<Self> {
        let along_z = setup.wing_frame().wing_from_survey.inverse() * Vector3::z();
        let straight = |(k, p): (usize, Vector3<f64>)| {
            setup.markers[k].position_m - along_z * setup.swept_m(p.x)
        };
        let points: Vec<Vector2<f64>> = setup
            .wing_markers()
            .into_iter()
            .map(|one| straight(one).xy())
            .collect();
        let mean = points.iter().sum::<Vector2<f64>>() / points.len().max(1) as f64;
        let moments: Matrix2<f64> = points
            .iter()
            .map(|p| (p - mean) * (p - mean).transpose())
            .sum();
        let axes = moments.symmetric_eigen();
        let longest = axes.eigenvalues.imax();
        let (long, short) = (
            axes.eigenvalues[longest],
            axes.eigenvalues[1 - longest].max(0.0),
        );
        if long <= MIN_ELONGATION * MIN_ELONGATION * short {
            return None;
        }
        let (line, span) = (
            axes.eigenvectors.column(longest).into_owned(),
            setup.span_direction.normalize(),
        );
        let by_places = (short / long / points.len().max(1) as f64)
            .sqrt()
            .to_degrees();
        Some(Self {
            outboard: line * span.dot(&line).signum(),
            angle_deg: span.dot(&line).abs().min(1.0).acos().to_degrees(),
            sigma_deg: by_places.hypot(LINE_SIGMA_DEG),
        })
    }

    /// Returns a warning about a span that contradicts the line of the markers.
    pub(super) fn warning(setup: &Setup, file: &Path) -> Option<Fault> {
        Self::of_setup(setup)
            .filter(|s| s.angle_deg > SKEW_SIGMAS * s.sigma_deg)
            .map(|skew| skew.fault(file, setup))
    }

    fn fault(&self, file: &Path, setup: &Setup) -> Fault {
        let Self {
            outboard,
            angle_deg,
            sigma_deg,
        } = self;
        let [dx, dy] = [setup.span_direction.x, setup.span_direction.y];
        let problem = format!(
            "is [{dx}, {dy}], {angle_deg:.0} degrees off the line of the markers (± {sigma_deg:.1})"
        );
        let swept = if setup.sweeps().next().is_some() {
            " and wing.breaks.sweep_deg"
        } else {
            ""
        };
        let remedy = format!(
            "give the direction along the wing from the root to the tip, about [{:.3}, {:.3}], or check the survey's x and y{swept}",
            outboard.x, outboard.y
        );
        Fault::new(file, "wing.span_direction", problem, remedy)
    }
}

/// Checks that bending starts inboard of most markers.
fn check_root(reader: &mut Reader, file: &Path, setup: &Setup) {
    let (wing, root_m) = (setup.wing_markers(), setup.root_offset_m);
    let (markers, inboard) = (
        wing.len(),
        wing.iter().filter(|(_, point)| point.x <= root_m).count(),
    );
    if 2 * inboard > markers {
        let problem =
            format!("is {root_m} m, but {inboard} of {markers} markers are inboard of it");
        let remedy = "give the distance along the span from the camera to the bending root, m";
        reader.fault(file, "wing.root_offset_m", problem, remedy);
    }
}

/// Least number of markers on each side of a configured break, which determine the slope there.
const MARKERS_BESIDE_BREAK: usize = 2;

/// Checks that markers determine the slope on both sides of each configured break, and that a configured sweep has a side and
/// lies outboard of the root.
fn check_breaks(reader: &mut Reader, file: &Path, setup: &Setup) {
    let (wing, most) = (setup.wing_markers(), MAX_BREAKS);
    if setup.breaks.len() > most {
        let problem = format!(
            "has {} breaks, at most {most} can be determined",
            setup.breaks.len()
        );
        reader.fault(file, "wing.breaks", problem, "give the largest ones");
    }
    if setup.side().is_none() && setup.sweeps().next().is_some() {
        let problem = "is given, but not on which side the wing is";
        reader.fault(file, "wing.breaks.sweep_deg", problem, "give wing.side");
    }
    if let Some((span_m, _)) = setup
        .sweeps()
        .find(|(span_m, _)| *span_m <= setup.root_offset_m)
    {
        let problem = format!(
            "is {span_m} m, inboard of the bending root at {} m",
            setup.root_offset_m
        );
        let remedy = "leave its sweep_deg out, and give span_direction outboard of it";
        reader.fault(file, "wing.breaks.span_m", problem, remedy);
    }
    let mut ends: Vec<f64> = [f64::NEG_INFINITY, f64::INFINITY]
        .into_iter()
        .chain(setup.breaks.iter().map(|one| one.span_m))
        .collect();
    ends.sort_by(f64::total_cmp);
    for (from, to) in ends.iter().zip(ends.iter().skip(1)) {
        let between = wing
            .iter()
            .filter(|(_, point)| (*from..*to).contains(&point.x))
            .count();
        if ends.len() > 2 && between < MARKERS_BESIDE_BREAK {
            let at = if from.is_finite() { from } else { to };
            let problem = format!(
                "is {at} m, but only {between} markers lie between it and the next break or end of the wing"
            );
            let remedy = "give the distance along the span from the camera, m, or leave the break out: the survey finds it";
            return reader.fault(file, "wing.breaks.span_m", problem, remedy);
        }
    }
}

fn name_side(side: WingSide) -> &'static str {
    match side {
        WingSide::Left => "left",
        WingSide::Right => "right",
    }
}

/// Checks for every pair that the leading marker is ahead of the trailing one.
fn check_side(reader: &mut Reader, file: &Path, setup: &Setup) {
    let Some(side) = setup.side() else { return };
    let name = name_side(side);
    for (k, pair) in setup.torsion.iter().enumerate() {
        if setup
            .side_from_pair(pair)
            .is_some_and(|other| other != side)
        {
            let place = format!("torsion[{k}]");
            let problem = format!("its leading marker is behind its trailing one on a {name} wing");
            let remedy = match setup.is_lens_below_wing() {
                true => {
                    "the lens is below the wing: if it is not, z_m points down (body axes), and y and z need the opposite \
                     sign; else exchange leading and trailing, or correct wing.side"
                }
                false => "exchange leading and trailing, or correct wing.side",
            };
            reader.fault(file, &place, problem, remedy);
        }
    }
}

/// Cosine of the largest angle between the flow and the chord: no wing is swept by more than 70 degrees.
const MIN_FLOW_COSINE: f64 = 0.34;

/// Checks that the flow runs from the leading to the trailing edge.
fn check_flow(reader: &mut Reader, file: &Path, setup: &Setup) {
    let Some((flow, side)) = setup
        .flow_direction
        .and_then(|flow| flow.try_normalize(0.0))
        .zip(setup.side())
    else {
        return;
    };
    let in_wing = setup.wing_frame().wing_from_survey * Vector3::new(flow.x, flow.y, 0.0);
    let aft = if side == WingSide::Left {
        -in_wing.z
    } else {
        in_wing.z
    };
    if aft < MIN_FLOW_COSINE {
        let name = name_side(side);
        let problem = format!(
            "is [{}, {}], {:.0} degrees off the chord from leading to trailing edge of a {name} wing",
            flow.x,
            flow.y,
            aft.acos().to_degrees()
        );
        let remedy = "give the horizontal direction from nose to tail in the survey frame, or correct wing.side";
        reader.fault(file, "wing.flow_direction", problem, remedy);
    }
}

/// Reports markers whose prints would overlap.
fn check_overlap(reader: &mut Reader, survey: &Path, setup: &Setup) {
    let has_decal = |m: &&SurveyMarker| m.shape != Shape::Point;
    for (k, marker) in setup
        .markers
        .iter()
        .enumerate()
        .filter(|(_, m)| has_decal(m))
    {
        let apart_m = |other: &SurveyMarker| (marker.position_m - other.position_m).norm();
        let overlaps = |other: &&SurveyMarker| {
            has_decal(other) && 2.0 * apart_m(other) < marker.diameter_m + other.diameter_m
        };
        if let Some(other) = setup.markers[..k].iter().find(overlaps) {
            let (id, apart_m) = (&other.id, apart_m(other));
            let problem = format!("is {apart_m:.3} m from {id}: the two would overlap");
            let remedy = "survey both again, or keep one of them";
            let fault = Fault::of_marker(survey, &marker.id, problem, remedy);
            reader.faults.push(fault);
        }
    }
}
