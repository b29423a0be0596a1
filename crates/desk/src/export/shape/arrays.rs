//! Arrays of the dataset of shapes: places, frames, functions with their factors.

use nalgebra::Vector3;
use serde_json::Value;

use super::super::dataset::ArrayValues::{Flags, Numbers, Singles, Texts};
use super::super::dataset::{ArrayDataset, ArrayValues};
use super::{
    AXES, BASIS, DIGESTS, DatedShape, ExportedShape, REFERENCES, SOURCES, ShapeArray, ShapeExport,
};
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::record::variant_name;
use wingd_measure::adjust::JointShape;
use wingd_measure::estimation::symmetric_root;

/// Rows of rotation and scale in the covariance of a fit; a displacement does not depend on the translation.
const CAD_PARAMETERS: [usize; 4] = [0, 1, 2, 6];

/// Describes dimensions, indices and places on the ground.
pub(super) fn describe_places(
    shape: &JointShape,
    installation: &Installation,
    attributes: Vec<(&'static str, Value)>,
) -> ArrayDataset {
    let sections = installation.structure.as_deref();
    let sections = sections.unwrap_or_default();
    let of_fit = installation
        .cad
        .as_ref()
        .map_or(0, |_| CAD_PARAMETERS.len());
    let markers = shape.markers.iter();
    let markers = Vec::from_iter(markers.map(|m| &installation.setup.markers[*m]));
    let mut data = ArrayDataset {
        dimensions: vec![
            ("eta", shape.arcs_m.len()),
            ("marker", markers.len()),
            ("axis", AXES.len()),
            ("reference", REFERENCES.len()),
            ("row", 4),
            ("column", 4),
            ("section", sections.len()),
            ("parameter", of_fit),
            ("fit", of_fit),
        ],
        arrays: vec![],
        coordinates: vec!["arc_length", "time", "image", "flight", "recorder_id"],
        attributes,
    };
    // Rounded, so that a given fraction is found as such.
    let eta = |arc_m: &f64| {
        let eta = (arc_m / shape.length_m * 1e12).round() * 1e-12;
        format!("{eta:.12}").parse().unwrap_or(eta)
    };
    let texts = |texts: &[&str]| Texts(texts.iter().map(|t| (*t).to_owned()).collect());
    let points = |points: &mut dyn Iterator<Item = &Vector3<f64>>| {
        Numbers(points.flat_map(|p| p.iter().copied()).collect())
    };
    let mut add = |name: &str, unit, meaning, dimensions: &[&'static str], values| {
        data.add(name, unit, meaning, dimensions, values);
    };
    let meaning = "arc length over that of the model's tip";
    let etas = Numbers(shape.arcs_m.iter().map(eta).collect());
    add("eta", "1", meaning, &["eta"], etas);
    let meaning = "arc length from the bending root along the axis on the ground";
    let arcs = Numbers(shape.arcs_m.clone());
    add("arc_length", "m", meaning, &["eta"], arcs);
    let ids = Texts(markers.iter().map(|m| m.id.clone()).collect());
    add("marker", "", "id in the survey", &["marker"], ids);
    let meaning = "axis of the frame of reference";
    add("axis", "", meaning, &["axis"], texts(&AXES));
    let meaning = "reference of a deflection";
    add("reference", "", meaning, &["reference"], texts(&REFERENCES));
    let meaning = "arc length of a section of known stiffness from the bending root";
    let arcs = Numbers(sections.iter().map(|section| section.s_m).collect());
    add("section", "m", meaning, &["section"], arcs);
    let meaning = "bending axis on the ground, survey frame";
    let ground = points(&mut shape.ground_m.iter());
    add("ground_position", "m", meaning, &["eta", "axis"], ground);
    let meaning = "surveyed position, survey frame";
    let surveyed = points(&mut markers.iter().map(|m| &m.position_m));
    add(
        "marker_ground_position",
        "m",
        meaning,
        &["marker", "axis"],
        surveyed,
    );
    if let Some(fit) = &installation.cad {
        let linear = fit.transform.rotation.matrix() * fit.transform.scale;
        let matrix = linear.to_homogeneous();
        let matrix = matrix.append_translation(&fit.transform.translation_m);
        let meaning = "transform of points from the survey to the CAD frame, m";
        let rows = Numbers(matrix.transpose().iter().copied().collect());
        add("cad_from_survey", "1", meaning, &["row", "column"], rows);
        let covariance = fit.covariance.select_rows(&CAD_PARAMETERS);
        let root = symmetric_root(&covariance.select_columns(&CAD_PARAMETERS));
        let meaning = "factor of the errors of the transform: rotation vector in the CAD frame, rad, and scale";
        let rows = Numbers(root.transpose().iter().copied().collect());
        add("cad_fit", "1", meaning, &["parameter", "fit"], rows);
    }
    data
}

impl ShapeExport {
    /// Creates the dataset; `attributes` of the store are included.
    pub fn to_dataset(&self, attributes: Vec<(&'static str, Value)>) -> ArrayDataset {
        let mut data = self.places.clone();
        data.attributes.splice(0..0, attributes);
        data.dimensions.push(("frame", self.shapes.len()));
        for (kind, source) in SOURCES.into_iter().enumerate() {
            let count = self.largest(|one| one.factors[kind].ncols());
            data.dimensions.push((source, count));
            let counts = Numbers((0..count).map(|k| k as f64).collect());
            data.add(source, "1", "source of errors", &[source], counts);
        }
        let sources = self.largest(|one| one.basis.as_ref().map_or(0, |basis| basis.nrows()));
        data.dimensions.push(("lasting_source", sources));
        self.add_frames(&mut data);
        for array in &self.arrays {
            self.add_functions(&mut data, array);
        }
        data
    }

    fn largest(&self, size: impl Fn(&ExportedShape) -> usize) -> usize {
        self.shapes.iter().map(size).max().unwrap_or(0)
    }

    /// Adds names, times, tests, conditions and digests of the frames.
    fn add_frames(&self, data: &mut ArrayDataset) {
        let shapes = || self.shapes.iter().map(|one| &one.dated);
        let texts = |text: &dyn Fn(&DatedShape) -> String| Texts(shapes().map(text).collect());
        let numbers = |value: &dyn Fn(&DatedShape) -> Option<f64>| {
            let values = shapes().map(|one| value(one).unwrap_or(f64::NAN));
            Numbers(values.collect())
        };
        let mut add = |name: &str, unit: &'static str, meaning: &str, values: ArrayValues| {
            data.add(name, unit, meaning, &["frame"], values);
        };
        let names = texts(&|one| one.name.clone());
        add("image", "", "series and file", names);
        add("flight", "", "flight", texts(&|one| one.flight.clone()));
        let ids = texts(&|one| one.recorder_id.clone());
        add("recorder_id", "", "id of the recorder's store", ids);
        let seconds = numbers(&|one| Some(one.time?.0.as_microsecond() as f64 * 1e-6));
        let unit = "seconds since 1970-01-01 00:00:00";
        let meaning = "middle of the exposure";
        add("time", unit, meaning, seconds);
        let sigmas = numbers(&|one| one.time?.1);
        add("sigma_time", "s", "standard deviation of the time", sigmas);
        let statuses = texts(&|one| one.status.clone());
        add("status", "", "status of the result", statuses);
        let reasons = texts(&|one| one.reason.clone().unwrap_or_default());
        add("reason", "", "reason for a status other than ok", reasons);
        let meaning = "1 if the frames of the flight were adjusted jointly";
        let jointly = self.shapes.iter().map(|one| one.factors[0].ncols() > 0);
        add(
            "jointly",
            "1",
            meaning,
            Flags(jointly.map(i8::from).collect()),
        );
        let meaning = "test of the adjustment: passed or rejected";
        let tests = texts(&|one| one.global_test.map(variant_name).unwrap_or_default());
        add("global_test", "", meaning, tests);
        let meaning = "variance factor of the adjustment";
        add(
            "variance_factor",
            "1",
            meaning,
            numbers(&|one| one.variance_factor),
        );
        let keys = texts(&|one| one.inputs.clone());
        add("inputs", "", "key of the results' inputs", keys);
        for (kind, name) in DIGESTS.iter().enumerate() {
            let digests = texts(&|one| one.sources[kind].clone());
            let name = format!("{name}_sources");
            add(&name, "", "digest of the sources of errors", digests);
        }
        let is_known = |one: &Quantity| shapes().any(|shape| shape.conditions.contains_key(one));
        for quantity in Quantity::ALL.into_iter().filter(is_known) {
            let (name, unit) = (quantity.name(), condition_unit(quantity));
            let values = numbers(&|one| Some(one.conditions.get(&quantity)?.value));
            add(name, unit, "aircraft data at the exposure", values);
            let sigmas = numbers(&|one| Some(one.conditions.get(&quantity)?.sigma));
            let meaning = "standard deviation of the instrument";
            add(&format!("sigma_{name}"), unit, meaning, sigmas);
        }
        let predicted = shapes().flat_map(|one| one.predicted.iter().copied().map(i8::from));
        let predicted = Flags(predicted.collect());
        let meaning = "1 if the marker was not used and the adjusted shape predicts it";
        data.add("predicted", "1", meaning, &["frame", "marker"], predicted);
        let dimensions = ["frame", "lasting_source", SOURCES[0]];
        let [_, rows, columns] = dimensions.map(|name| data.size_of(name));
        let entry = |one: &ExportedShape, k: usize| {
            let entry = one.basis.as_ref()?.get((k / columns, k % columns)).copied();
            entry.map(|entry| entry as f32)
        };
        let of_shape = |one| (0..rows * columns).map(move |k| entry(one, k).unwrap_or(0.0));
        let entries = Singles(self.shapes.iter().flat_map(of_shape).collect());
        let meaning = "basis of the reduced lasting factors";
        data.add(BASIS, "1", meaning, &dimensions, entries);
    }

    /// Adds values, standard deviations and factors of functions.
    fn add_functions(&self, data: &mut ArrayDataset, array: &ShapeArray) {
        let ShapeArray {
            name,
            unit,
            meaning,
            rows,
            ..
        } = array;
        let dimensions = [&["frame"], array.dimensions].concat();
        let all = |of: &dyn Fn(&ExportedShape, usize) -> Option<f64>| {
            let of_shape = |one| {
                rows.iter()
                    .map(move |row| of(one, *row).unwrap_or(f64::NAN))
            };
            Numbers(self.shapes.iter().flat_map(of_shape).collect())
        };
        let values = all(&|one, row| one.dated.shape.values.get(row).copied());
        data.add(name, unit, meaning, &dimensions, values);
        let text = format!("standard deviation: {meaning}");
        let sigmas = all(&|one, row| one.sigmas.get(row).copied());
        data.add(&format!("sigma_{name}"), unit, &text, &dimensions, sigmas);
        for &kind in array.kinds {
            let source = SOURCES[kind];
            let size = data.size_of(source);
            let entries = self.shapes.iter().flat_map(|one| {
                let factor = &one.factors[kind];
                rows.iter().flat_map(move |row| {
                    (0..size).map(move |k| factor.get((*row, k)).copied().unwrap_or(0.0))
                })
            });
            let rests = |one: &ExportedShape, row: usize| one.rests.get(kind)?.get(row).copied();
            let is_reduced = kind < 3 && !self.is_full;
            let values = match is_reduced {
                true => Singles(entries.map(|entry| entry as f32).collect()),
                false => Numbers(entries.collect()),
            };
            let text = format!("factor of the covariance, sources {source}: {meaning}");
            let name = format!("{name}_{source}");
            let with_sources = [&dimensions[..], &[source]].concat();
            data.add(&name, unit, &text, &with_sources, values);
            if is_reduced && size > 0 {
                let text = format!("standard deviation beside {name}: {meaning}");
                data.add(
                    &format!("{name}_rest"),
                    unit,
                    &text,
                    &dimensions,
                    all(&rests),
                );
            }
        }
    }
}

/// Returns the unit of aircraft data by the suffix of its name.
fn condition_unit(quantity: Quantity) -> &'static str {
    const UNITS: [(&str, &str); 7] = [
        ("_m_s", "m s-1"),
        ("_m", "m"),
        ("_c", "degree_Celsius"),
        ("_hpa", "hPa"),
        ("_kg", "kg"),
        ("_deg", "degree"),
        ("_percent", "percent"),
    ];
    let has_suffix = |(suffix, _): &&(&str, &str)| quantity.name().ends_with(suffix);
    UNITS.iter().find(has_suffix).map_or("1", |(_, unit)| unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_have_the_unit_of_their_name() {
        let unit = |name: &str| {
            let named = Quantity::ALL.into_iter().find(|one| one.name() == name);
            condition_unit(named.unwrap())
        };
        assert_eq!(unit("mach"), "1");
        assert_eq!(unit("pressure_altitude_m"), "m");
        assert_eq!(unit("true_airspeed_m_s"), "m s-1");
        assert_eq!(unit("static_temperature_c"), "degree_Celsius");
        assert_eq!(unit("load_factor"), "1");
    }
}
