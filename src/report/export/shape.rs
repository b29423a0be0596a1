//! Joint shape of a flight as a dataset: motions of stations and markers, and factors of their covariance.

use nalgebra::DMatrix;

use super::dataset::{ArrayDataset, ArrayValues, NamedArray};
use crate::aircraft::AircraftState;
use crate::clock::Stamp;
use crate::installation::Installation;
use crate::measure::adjust::{FrameShape, JointShape};
use crate::record::variant_name;

/// Frame of a shape.
pub struct ShapeFrame {
    /// Series and file.
    pub name: String,
    pub stamp: Stamp,
    pub aircraft: AircraftState,
    /// Index among the frames that were adjusted together.
    pub frame: usize,
}

/// Array of a shape: name, unit, meaning, and the first of its functions of each station ([`STATION_FUNCTIONS`]).
///
/// [`STATION_FUNCTIONS`]: crate::measure::adjust::STATION_FUNCTIONS
const STATION_ARRAYS: [(&str, &str, &str, usize, usize); 5] = [
    ("displacement", "m", "displacement of the bending axis against the survey, survey frame", 0, 3),
    ("slope", "rad", "change of the slope along the span, tip up", 3, 1),
    ("twist", "rad", "twist about the bending axis, nose up", 4, 1),
    ("streamwise_twist", "rad", "change of the incidence in the vertical plane of the flow, nose up", 5, 1),
    ("rotation", "rad", "rotation vector of the section, survey frame", 6, 3),
];

/// Function that returns a factor of a frame's covariance.
type FactorGetter = fn(&FrameShape) -> &DMatrix<f64>;

/// Factors of the covariance, by the dimension of their sources.
const FACTORS: [(&str, FactorGetter); 3] =
    [("lasting", |f| &f.lasting), ("shared", |f| &f.shared), ("own", |f| &f.own)];

type DatedFrame<'a> = (ShapeFrame, &'a JointShape, &'a FrameShape);

/// Creates the dataset of a flight's frames, at least one. `attributes` of the store are included.
pub fn shape_dataset(
    frames: &[DatedFrame],
    installation: &Installation,
    jointly: bool,
    attributes: Vec<(String, String)>,
) -> ArrayDataset {
    let Some((_, shape, first)) = frames.first() else { return ArrayDataset::default() };
    let own = frames.iter().map(|(_, _, frame)| frame.own.ncols()).max().unwrap_or(0);
    let dimensions = vec![
        ("frame", frames.len()),
        ("station", shape.arcs_m.len()),
        ("marker", shape.markers.len()),
        ("axis", 3),
        ("lasting", first.lasting.ncols()),
        ("shared", first.shared.ncols()),
        ("own", own),
        ("row", 4),
        ("column", 4),
    ];
    let mut data = ArrayDataset { dimensions, arrays: vec![], attributes };
    add_stations(&mut data, shape, installation);
    add_frames(&mut data, frames);
    for (name, unit, meaning, function, components) in STATION_ARRAYS {
        let row = |station: usize, component: usize| shape.station_function(function + component, station);
        let rows = (0..shape.arcs_m.len()).flat_map(|s| (0..components).map(move |c| row(s, c))).collect();
        add_functions(&mut data, frames, (name, unit, meaning), ("station", components), rows);
    }
    let rows = (0..shape.markers.len()).flat_map(|m| (0..3).map(move |c| shape.marker_function(m) + c)).collect();
    let meaning = "displacement of the marker against the survey, survey frame";
    add_functions(&mut data, frames, ("marker_displacement", "m", meaning), ("marker", 3), rows);
    add_facts(&mut data, frames, installation, jointly);
    data
}

fn add_array(
    data: &mut ArrayDataset,
    (name, unit, meaning): (&str, &'static str, &str),
    dimensions: &[&'static str],
    values: ArrayValues,
) {
    let (name, dimensions, meaning) = (name.to_owned(), dimensions.to_vec(), meaning.to_owned());
    data.arrays.push(NamedArray { name, dimensions, unit, meaning, values });
}

/// Places on the ground.
fn add_stations(data: &mut ArrayDataset, shape: &JointShape, installation: &Installation) {
    let markers = || shape.markers.iter().map(|m| &installation.setup.markers[*m]);
    let numbers = |values: Vec<f64>| ArrayValues::Numbers(values);
    let eta = shape.arcs_m.iter().map(|arc_m| arc_m / shape.length_m).collect();
    let arc = ("arc_length", "m", "arc length from the bending root along the axis on the ground");
    add_array(data, arc, &["station"], numbers(shape.arcs_m.clone()));
    add_array(data, ("eta", "", "arc length over that of the model's tip"), &["station"], numbers(eta));
    let ground = ("ground_position", "m", "bending axis on the ground, survey frame");
    let places = shape.ground_m.iter().flat_map(|p| p.iter().copied()).collect();
    add_array(data, ground, &["station", "axis"], numbers(places));
    let surveyed = ("marker_ground_position", "m", "surveyed position, survey frame");
    let places = markers().flat_map(|m| m.position_m.iter().copied()).collect();
    add_array(data, surveyed, &["marker", "axis"], numbers(places));
    let ids = markers().map(|m| m.id.clone()).collect();
    add_array(data, ("marker_id", "", "id in the survey"), &["marker"], ArrayValues::Texts(ids));
    if let Some(fit) = &installation.cad {
        let (linear, moved) = (fit.transform.rotation.matrix() * fit.transform.scale, fit.transform.translation_m);
        let entry = |i: usize, j: usize| match (i, j) {
            (3, _) => f64::from(u8::from(j == 3)),
            (_, 3) => moved[i],
            _ => linear[(i, j)],
        };
        let matrix = (0..4).flat_map(|i| (0..4).map(move |j| entry(i, j))).collect();
        let meaning = "transform of points from the survey to the CAD frame, m; displacements take its 3 x 3 part";
        add_array(data, ("cad_from_survey", "", meaning), &["row", "column"], numbers(matrix));
    }
}

/// Names, times, tests and conditions of the frames.
fn add_frames(data: &mut ArrayDataset, frames: &[DatedFrame]) {
    let texts = |text: &dyn Fn(&DatedFrame) -> String| ArrayValues::Texts(frames.iter().map(text).collect());
    let numbers = |value: &dyn Fn(&DatedFrame) -> f64| ArrayValues::Numbers(frames.iter().map(value).collect());
    add_array(data, ("image", "", "series and file"), &["frame"], texts(&|(frame, ..)| frame.name.clone()));
    let time = numbers(&|(frame, ..)| frame.stamp.utc.as_microsecond() as f64 * 1e-6);
    add_array(data, ("time", "seconds since 1970-01-01 00:00:00 UTC", "request to the camera"), &["frame"], time);
    let synchronised = ArrayValues::Flags(frames.iter().map(|(frame, ..)| frame.stamp.utc_synchronised).collect());
    add_array(data, ("time_synchronised", "", "1 if the clock was set by a reference"), &["frame"], synchronised);
    let test = texts(&|(_, _, shape)| shape.solution.global_test.map(variant_name).unwrap_or_default());
    add_array(data, ("global_test", "", "test of the adjustment: passed or rejected"), &["frame"], test);
    let factor = numbers(&|(_, _, shape)| shape.solution.variance_factor.unwrap_or(f64::NAN));
    add_array(data, ("variance_factor", "", "variance factor of the adjustment"), &["frame"], factor);
    let posterior = ArrayValues::Flags(frames.iter().map(|(_, _, shape)| shape.solution.posterior).collect());
    let meaning = "1 if the factors are scaled by the root of the variance factor";
    add_array(data, ("posterior", "", meaning), &["frame"], posterior);
    let used = frames.iter().flat_map(|(_, joint, shape)| {
        joint.markers.iter().map(|m| !shape.solution.markers.get(*m).is_some_and(|marker| marker.used))
    });
    let predicted = ArrayValues::Flags(used.collect());
    let meaning = "1 if the marker was not used and the adjusted shape predicts it";
    add_array(data, ("predicted", "", meaning), &["frame", "marker"], predicted);
    let mut quantities: Vec<_> = frames.iter().flat_map(|(frame, ..)| frame.aircraft.keys().copied()).collect();
    quantities.sort_unstable();
    quantities.dedup();
    for quantity in quantities {
        let value = numbers(&|(frame, ..)| frame.aircraft.get(&quantity).map_or(f64::NAN, |joined| joined.value));
        add_array(data, (quantity.name(), "", "aircraft data at the exposure"), &["frame"], value);
    }
}

/// Values, standard deviations and factors of functions, one row each.
fn add_functions(
    data: &mut ArrayDataset,
    frames: &[DatedFrame],
    (name, unit, meaning): (&str, &'static str, &str),
    (place, components): (&'static str, usize),
    rows: Vec<usize>,
) {
    let mut dimensions = vec!["frame", place];
    dimensions.extend((components > 1).then_some("axis"));
    let values = frames.iter().flat_map(|(_, _, frame)| rows.iter().map(|row| frame.values[*row]));
    add_array(data, (name, unit, meaning), &dimensions, ArrayValues::Numbers(values.collect()));
    let sigmas = frames.iter().flat_map(|(_, _, frame)| {
        let variances = frame.variances();
        let known = |row: &usize| if frame.values[*row].is_nan() { f64::NAN } else { variances[*row].sqrt() };
        rows.iter().map(known).collect::<Vec<_>>()
    });
    let sigma = format!("standard deviation: {meaning}");
    add_array(data, (&format!("sigma_{name}"), unit, &sigma), &dimensions, ArrayValues::Numbers(sigmas.collect()));
    for (source, factor) in FACTORS {
        let sources = data.dimensions.iter().find(|(dimension, _)| *dimension == source).map_or(0, |(_, size)| *size);
        if sources == 0 {
            continue;
        }
        let entry = |frame: &FrameShape, row: usize, k: usize| factor(frame).get((row, k)).copied().unwrap_or(0.0);
        let entries = frames.iter().flat_map(|(_, _, frame)| {
            rows.iter().flat_map(move |row| (0..sources).map(move |k| entry(frame, *row, k)))
        });
        let with_sources = [&dimensions[..], &[source]].concat();
        let text = format!("factor of the covariance, sources {source}: {meaning}");
        add_array(
            data,
            (&format!("{name}_{source}"), unit, &text),
            &with_sources,
            ArrayValues::Numbers(entries.collect()),
        );
    }
}

/// Attributes that say how to read the arrays.
fn add_facts(data: &mut ArrayDataset, frames: &[DatedFrame], installation: &Installation, jointly: bool) {
    let errors = match jointly {
        true => {
            "value = truth + lasting u + shared s + own e, all of u, s, e independent with standard deviation 1: u is common \
             to all flights with the same installation, s to the frames of this flight, e belongs to each frame"
        }
        false => {
            "value = truth + own e, with e independent with standard deviation 1 within a frame; the frames were adjusted \
             singly, so the errors that they have in common are not known: solve with --flight to compare or average them"
        }
    };
    let thermal = installation.setup.thermal.as_ref().map_or(1.0, |thermal| thermal.scale());
    let facts = [
        ("title", "shape of a wing in flight".to_owned()),
        ("installation", installation.setup.name.clone()),
        ("frame_of_reference", "survey frame of the installation; z up".to_owned()),
        ("reference", "the wing as surveyed, with its load at the survey".to_owned()),
        ("errors", errors.to_owned()),
        ("length_to_tip_m", format!("{:.6}", frames[0].1.length_m)),
        ("outermost_marker_m", format!("{:.6}", frames[0].1.reach_m)),
        ("thermal_scale", format!("{thermal:.9}")),
    ];
    data.attributes.extend(facts.map(|(name, text)| (name.to_owned(), text)));
    let flow = installation.setup.flow_direction.map(|flow| format!("{}, {}", flow.x, flow.y));
    let flow = flow.unwrap_or_else(|| "unknown: streamwise_twist is missing; give wing.flow_direction".into());
    data.attributes.push(("flow_direction".to_owned(), flow));
}
