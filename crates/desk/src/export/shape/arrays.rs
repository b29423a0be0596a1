//! Arrays of the dataset of shapes: places, frames, functions with their factors.

use nalgebra::DMatrix;

use super::super::dataset::{ArrayDataset, ArrayValues, AttributeValue, NamedArray};
use super::{
    AXES, BASIS, CadValues, DatedShape, MOMENT, REFERENCES, ReducedShape, SOURCES, ShapeArray,
    ShapeExport, factors,
};
use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::record::variant_name;

impl ShapeExport {
    /// Creates the dataset; `attributes` of the store are included.
    pub fn to_dataset(&self, attributes: Vec<(String, AttributeValue)>) -> ArrayDataset {
        let columns = |kind: usize| {
            let of = |one: &ReducedShape| factors(&one.dated.shape)[kind].ncols();
            self.shapes.iter().map(of).max().unwrap_or(0)
        };
        let bases = self.shapes.iter().filter_map(|one| one.basis.as_ref());
        let sections = self.sections_m.len();
        let dimensions = vec![
            ("frame", self.shapes.len()),
            ("eta", self.shape.arcs_m.len()),
            ("marker", self.marker_ids.len()),
            ("axis", AXES.len()),
            ("reference", REFERENCES.len()),
            ("row", 4),
            ("column", 4),
            (SOURCES[0], columns(0)),
            (SOURCES[1], columns(1)),
            (SOURCES[2], columns(2)),
            (SOURCES[3], if self.cad.is_some() { 4 } else { 0 }),
            (
                "lasting_source",
                bases.map(|b| b.nrows()).max().unwrap_or(0),
            ),
            ("section", sections),
            ("stiffness", if sections > 0 { sections + 1 } else { 0 }),
        ];
        let facts = self.facts.iter().cloned();
        let mut data = ArrayDataset {
            dimensions,
            arrays: vec![],
            coordinates: vec!["arc_length", "time", "image", "flight", "recorder_id"],
            attributes: attributes
                .into_iter()
                .chain(facts.map(|(name, value)| (name.to_owned(), value)))
                .collect(),
        };
        self.add_places(&mut data);
        self.add_frames(&mut data);
        self.arrays
            .iter()
            .for_each(|array| self.add_functions(&mut data, array));
        data
    }

    /// Adds indices, and places on the ground.
    fn add_places(&self, data: &mut ArrayDataset) {
        let numbers = |values: Vec<f64>| ArrayValues::Numbers(values);
        let texts =
            |texts: &[&str]| ArrayValues::Texts(texts.iter().map(|t| (*t).to_owned()).collect());
        let arcs = &self.shape.arcs_m;
        // Rounded, so that a given fraction is found as such.
        let eta = |arc_m: &f64| (arc_m / self.shape.length_m * 1e12).round() * 1e-12;
        let sources = SOURCES.map(|source| (source, data_size(&data.dimensions, source)));
        let mut add = |name: &str, unit, meaning: &str, dimensions: &[&'static str], values| {
            add_array(data, (name, unit, meaning), dimensions, values)
        };
        let meaning = "arc length over that of the model's tip";
        let etas = arcs
            .iter()
            .map(eta)
            .map(|eta| format!("{eta:.12}").parse().unwrap_or(eta));
        add("eta", "1", meaning, &["eta"], numbers(etas.collect()));
        let meaning = "arc length from the bending root along the axis on the ground";
        add("arc_length", "m", meaning, &["eta"], numbers(arcs.clone()));
        let ids = ArrayValues::Texts(self.marker_ids.clone());
        add("marker", "", "id in the survey", &["marker"], ids);
        add(
            "axis",
            "",
            "axis of the frame of reference",
            &["axis"],
            texts(&AXES),
        );
        let meaning = "reference of a deflection";
        add("reference", "", meaning, &["reference"], texts(&REFERENCES));
        let meaning = "arc length of a section of known stiffness from the bending root";
        add(
            "section",
            "m",
            meaning,
            &["section"],
            numbers(self.sections_m.clone()),
        );
        for (source, count) in sources {
            let counts = numbers((0..count).map(|k| k as f64).collect());
            add(source, "1", "source of errors", &[source], counts);
        }
        let meaning = "bending axis on the ground, survey frame";
        let values = numbers(self.ground_m.clone());
        add("ground_position", "m", meaning, &["eta", "axis"], values);
        let values = numbers(self.marker_ground_m.clone());
        let meaning = "surveyed position, survey frame";
        add(
            "marker_ground_position",
            "m",
            meaning,
            &["marker", "axis"],
            values,
        );
        if let Some(fit) = &self.cad {
            let linear = fit.transform.rotation.matrix() * fit.transform.scale;
            let entry = |i: usize, j: usize| match (i, j) {
                (3, _) => f64::from(u8::from(j == 3)),
                (_, 3) => fit.transform.translation_m[i],
                _ => linear[(i, j)],
            };
            let matrix = (0..4).flat_map(|i| (0..4).map(move |j| entry(i, j)));
            let meaning = "transform of points from the survey to the CAD frame, m";
            add(
                "cad_from_survey",
                "1",
                meaning,
                &["row", "column"],
                numbers(matrix.collect()),
            );
        }
    }

    /// Adds names, times, tests, conditions and digests of the frames.
    fn add_frames(&self, data: &mut ArrayDataset) {
        let shapes = || self.shapes.iter().map(|one| &one.dated);
        let texts =
            |text: &dyn Fn(&DatedShape) -> String| ArrayValues::Texts(shapes().map(text).collect());
        let numbers = |value: &dyn Fn(&DatedShape) -> f64| {
            ArrayValues::Numbers(shapes().map(value).collect())
        };
        let flags =
            |flag: &dyn Fn(&DatedShape) -> bool| ArrayValues::Flags(shapes().map(flag).collect());
        let mut add = |name: &str, unit: &'static str, meaning: &str, values: ArrayValues| {
            add_array(data, (name, unit, meaning), &["frame"], values);
        };
        add(
            "image",
            "",
            "series and file, or series",
            texts(&|one| one.name.clone()),
        );
        add("flight", "", "flight", texts(&|one| one.flight.clone()));
        let ids = texts(&|one| one.recorder_id.clone());
        add("recorder_id", "", "id of the recorder's store", ids);
        let time = |one: &DatedShape| {
            one.time
                .map(|(time, _)| time.as_microsecond() as f64 * 1e-6)
        };
        let seconds = numbers(&|one| time(one).unwrap_or(f64::NAN));
        let meaning = "middle of the exposure, of the first frame";
        add(
            "time",
            "seconds since 1970-01-01 00:00:00",
            meaning,
            seconds,
        );
        let sigma = |one: &DatedShape| one.time.and_then(|(_, sigma)| sigma);
        let sigmas = numbers(&|one| sigma(one).unwrap_or(f64::NAN));
        add("sigma_time", "s", "standard deviation of the time", sigmas);
        let meaning = "1 if the clock was set by a reference";
        add(
            "time_synchronised",
            "1",
            meaning,
            flags(&|one| one.time_synchronised),
        );
        let meaning = "number of frames, of which the shape is the mean";
        add("frames", "1", meaning, numbers(&|one| one.count as f64));
        add(
            "status",
            "",
            "status of the result",
            texts(&|one| one.status.clone()),
        );
        let reasons = texts(&|one| one.reason.clone().unwrap_or_default());
        add("reason", "", "reason for a status other than ok", reasons);
        let meaning = "1 if the frames of the flight were adjusted jointly";
        add(
            "jointly",
            "1",
            meaning,
            flags(&|one| one.shape.lasting.ncols() > 0),
        );
        let tests = texts(&|one| one.global_test.map(variant_name).unwrap_or_default());
        add(
            "global_test",
            "",
            "test of the adjustment: passed or rejected",
            tests,
        );
        let factors = numbers(&|one| one.variance_factor.unwrap_or(f64::NAN));
        add(
            "variance_factor",
            "1",
            "variance factor of the adjustment",
            factors,
        );
        let meaning = "1 if the factors are scaled by the root of the variance factor";
        add("posterior", "1", meaning, flags(&|one| one.posterior));
        add(
            "inputs",
            "",
            "key of the results' inputs",
            texts(&|one| one.inputs.clone()),
        );
        for (kind, name) in SOURCES.iter().enumerate() {
            let digests = texts(&|one| one.sources[kind].clone());
            let meaning = "digest of the sources of errors";
            add(&format!("{name}_sources"), "", meaning, digests);
        }
        let mut quantities: Vec<_> = shapes()
            .flat_map(|one| one.conditions.keys().copied())
            .collect();
        quantities.sort_unstable();
        quantities.dedup();
        for quantity in quantities {
            let (name, unit) = (quantity.name(), condition_unit(quantity));
            let value = |one: &DatedShape| one.conditions.get(&quantity).map(|e| e.value);
            let values = numbers(&|one| value(one).unwrap_or(f64::NAN));
            add(name, unit, "aircraft data at the exposure", values);
            let sigma = |one: &DatedShape| one.conditions.get(&quantity).and_then(|e| e.sigma);
            let sigmas = numbers(&|one| sigma(one).unwrap_or(f64::NAN));
            add(
                &format!("sigma_{name}"),
                unit,
                "standard deviation of the instrument",
                sigmas,
            );
        }
        let predicted = shapes()
            .flat_map(|one| one.predicted.iter().copied())
            .collect();
        let meaning = "1 if the marker was not used and the adjusted shape predicts it";
        let array = ("predicted", "1", meaning);
        add_array(
            data,
            array,
            &["frame", "marker"],
            ArrayValues::Flags(predicted),
        );
        let sizes = ["lasting_source", SOURCES[0]].map(|name| data_size(&data.dimensions, name));
        let bases = self.shapes.iter().map(|one| one.basis.as_deref());
        let entries = bases
            .flat_map(|basis| padded_entries(basis, sizes))
            .collect();
        let array = (BASIS, "1", "basis of the reduced lasting factors");
        let dimensions = ["frame", "lasting_source", SOURCES[0]];
        add_array(data, array, &dimensions, ArrayValues::Singles(entries));
    }

    /// Adds values, standard deviations and factors of functions; displacements in the CAD frame too, if there is one.
    fn add_functions(&self, data: &mut ArrayDataset, array: &ShapeArray) {
        let ShapeArray {
            name,
            unit,
            meaning,
            rows,
            ..
        } = array;
        let dimensions = [&["frame"], &array.dimensions[..]].concat();
        let meaning_in = |frame: &str| match dimensions.contains(&"axis") {
            true => format!("{meaning}, {frame} frame"),
            false => (*meaning).to_owned(),
        };
        let meaning = meaning_in("survey");
        let all = |of: &dyn Fn(&ReducedShape, usize) -> f64| {
            let of_shape = |one| rows.iter().map(move |row| of(one, *row));
            ArrayValues::Numbers(self.shapes.iter().flat_map(of_shape).collect())
        };
        let values = all(&|one, row| one.dated.shape.values[row]);
        add_array(data, (name, unit, &meaning), &dimensions, values);
        let text = format!("standard deviation: {meaning}");
        let sigmas = all(&|one, row| one.sigmas[row]);
        add_array(
            data,
            (&format!("sigma_{name}"), unit, &text),
            &dimensions,
            sigmas,
        );
        if self
            .shapes
            .iter()
            .any(|one| one.dated.shape.scatter.is_some())
        {
            let text = format!("standard deviation of single frames about their mean: {meaning}");
            let scatter = |one: &ReducedShape, row: usize| {
                let of_shape = one.dated.shape.scatter.as_ref()?;
                of_shape.get(row).copied()
            };
            let values = all(&|one, row| scatter(one, row).unwrap_or(f64::NAN));
            add_array(
                data,
                (&format!("scatter_{name}"), unit, &text),
                &dimensions,
                values,
            );
        }
        for (kind, source) in SOURCES[..3].iter().enumerate() {
            let size = data_size(&data.dimensions, source);
            let entries = self.shapes.iter().flat_map(|one| {
                let factor = factors(&one.dated.shape)[kind];
                rows.iter().flat_map(move |row| {
                    (0..size).map(move |k| factor.get((*row, k)).copied().unwrap_or(0.0))
                })
            });
            let text = format!("factor of the covariance, sources {source}: {meaning}");
            let with_sources = [&dimensions[..], &[source]].concat();
            let values = match self.is_full {
                true => ArrayValues::Numbers(entries.collect()),
                false => ArrayValues::Singles(entries.map(|entry| entry as f32).collect()),
            };
            add_array(
                data,
                (&format!("{name}_{source}"), unit, &text),
                &with_sources,
                values,
            );
            if !self.is_full && size > 0 {
                let text = format!("standard deviation beside {name}_{source}: {meaning}");
                let rest = all(&|one, row| one.rests[kind].get(row).copied().unwrap_or(0.0));
                let array = (&*format!("{name}_{source}_rest"), *unit, &*text);
                add_array(data, array, &dimensions, rest);
            }
        }
        if *name == MOMENT {
            let size = data_size(&data.dimensions, "stiffness");
            let shapes = self.shapes.iter();
            let entries =
                shapes.flat_map(|one| padded_entries(Some(&one.stiffness), [rows.len(), size]));
            let text = "factor of the errors of stiffness and root, common to an installation";
            let array = (&*format!("{name}_stiffness"), *unit, text);
            let dimensions = ["frame", "section", "stiffness"];
            add_array(
                data,
                array,
                &dimensions,
                ArrayValues::Numbers(entries.map(f64::from).collect()),
            );
        }
        if array.in_cad && self.cad.is_some() {
            self.add_cad(data, array, &dimensions, &meaning_in("CAD"));
        }
    }

    fn add_cad(
        &self,
        data: &mut ArrayDataset,
        ShapeArray { name, unit, .. }: &ShapeArray,
        dimensions: &[&'static str],
        meaning: &str,
    ) {
        let all = |of: &dyn Fn(&CadValues) -> Vec<f64>| {
            let shapes = self.shapes.iter().filter_map(|one| one.cad.get(name));
            ArrayValues::Numbers(shapes.flat_map(of).collect())
        };
        let values = all(&|cad| cad.values.clone());
        add_array(
            data,
            (&format!("{name}_cad"), unit, meaning),
            dimensions,
            values,
        );
        let text = format!("standard deviation: {meaning}");
        let sigmas = all(&|cad| cad.sigmas.clone());
        add_array(
            data,
            (&format!("sigma_{name}_cad"), unit, &text),
            dimensions,
            sigmas,
        );
        let text = format!("factor of the covariance, sources fit: {meaning}");
        let fit = all(&|cad| cad.fit.transpose().iter().copied().collect());
        let with_sources = [dimensions, &[SOURCES[3]]].concat();
        add_array(
            data,
            (&format!("{name}_cad_fit"), unit, &text),
            &with_sources,
            fit,
        );
    }
}

fn data_size(dimensions: &[(&'static str, usize)], name: &str) -> usize {
    let found = dimensions.iter().find(|(dimension, _)| *dimension == name);
    found.map_or(0, |(_, size)| *size)
}

/// Entries of a matrix row by row, filled with zeros to a size.
fn padded_entries(
    matrix: Option<&DMatrix<f64>>,
    [rows, columns]: [usize; 2],
) -> impl Iterator<Item = f32> {
    let entry = move |i: usize, j: usize| {
        let known = matrix.and_then(|matrix| matrix.get((i, j)));
        known.map_or(0.0, |entry| *entry as f32)
    };
    (0..rows).flat_map(move |i| (0..columns).map(move |j| entry(i, j)))
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

fn add_array(
    data: &mut ArrayDataset,
    (name, unit, meaning): (&str, &'static str, &str),
    dimensions: &[&'static str],
    values: ArrayValues,
) {
    let (name, dimensions, meaning) = (name.to_owned(), dimensions.to_vec(), meaning.to_owned());
    data.arrays.push(NamedArray {
        name,
        dimensions,
        unit,
        meaning,
        values,
    });
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
