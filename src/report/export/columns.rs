//! Results become tables here: the rows of a series in named, typed columns.

use super::super::{SeriesData, ShotData, distinct};
use crate::aircraft::Quantity;
use crate::record::{CurveRecord, ImageRecord, MarkerRecord, Parameters, Term, TorsionRecord, word};
use crate::store::installations;

/// Of the columns' names, units and meanings (docs/tables.md). Columns may be added to a version, never changed or removed.
pub const SCHEMA_VERSION: i64 = 3;

/// Values of one column; `None` where there is none.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Words.
    Text(Vec<Option<String>>),
    /// Numbers.
    Number(Vec<Option<f64>>),
    /// Numbers of single precision.
    Single(Vec<Option<f32>>),
    /// Whole numbers.
    Count(Vec<Option<i64>>),
    /// Yes or no.
    Flag(Vec<Option<bool>>),
    /// Moments, microseconds since 1970 UTC.
    Time(Vec<Option<i64>>),
}

impl Values {
    /// Rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(v) => v.len(),
            Self::Number(v) => v.len(),
            Self::Single(v) => v.len(),
            Self::Count(v) | Self::Time(v) => v.len(),
            Self::Flag(v) => v.len(),
        }
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One value in full precision; empty where there is none. A moment as RFC 3339 in UTC.
    pub fn text(&self, row: usize) -> String {
        fn plain<T: ToString>(values: &[Option<T>], row: usize) -> String {
            values.get(row).and_then(Option::as_ref).map(T::to_string).unwrap_or_default()
        }
        match self {
            Self::Text(v) => plain(v, row),
            Self::Number(v) => plain(v, row),
            Self::Single(v) => plain(v, row),
            Self::Count(v) => plain(v, row),
            Self::Flag(v) => plain(v, row),
            Self::Time(v) => {
                let moment = v.get(row).copied().flatten().map(jiff::Timestamp::from_microsecond);
                moment.and_then(Result::ok).map(|t| t.to_string()).unwrap_or_default()
            }
        }
    }

    /// Takes the rows away.
    pub fn clear(&mut self) {
        match self {
            Self::Text(v) => v.clear(),
            Self::Number(v) => v.clear(),
            Self::Single(v) => v.clear(),
            Self::Count(v) | Self::Time(v) => v.clear(),
            Self::Flag(v) => v.clear(),
        }
    }

    /// Puts another column's rows, of the same kind, after these.
    pub fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Text(v), Self::Text(m)) => v.extend(m),
            (Self::Number(v), Self::Number(m)) => v.extend(m),
            (Self::Single(v), Self::Single(m)) => v.extend(m),
            (Self::Count(v), Self::Count(m)) | (Self::Time(v), Self::Time(m)) => v.extend(m),
            (Self::Flag(v), Self::Flag(m)) => v.extend(m),
            // A table's columns have the same kinds for every series.
            _ => {}
        }
    }
}

/// A named column.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// With the unit.
    pub name: String,
    /// Row by row.
    pub values: Values,
}

/// Which rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Table {
    /// One row per marker per image; an image without markers has one row.
    #[default]
    Markers,
    /// One row per point of the curve along the span per image.
    Span,
    /// One row per parameter of the model per image.
    Parameters,
    /// One row per shot that was asked for, with or without a frame.
    Shots,
}

/// What the rows of all series have in common.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Common {
    /// The recorder: the store's random id; `None` in a store without evidence.
    pub store_id: Option<String>,
    /// Names of torsion pairs, each of which has columns.
    pub pairs: Vec<String>,
}

impl Common {
    /// Of series that are at hand.
    pub fn of(store_id: Option<String>, series: &[SeriesData]) -> Self {
        let pairs = series.iter().flat_map(|s| &s.records).flat_map(|r| &r.torsion);
        let names = distinct(pairs.map(|pair| pair.name.as_str()));
        Self { store_id, pairs: names.into_iter().map(str::to_owned).collect() }
    }
}

/// A row of any table.
#[derive(Clone, Copy, Default)]
struct Row<'a> {
    shot: Option<&'a ShotData>,
    image: Option<&'a ImageRecord>,
    marker: Option<&'a MarkerRecord>,
    point: Option<&'a CurveRecord>,
    parameter: Option<Term>,
}

/// The rows of a series.
pub fn columns(table: Table, series: &SeriesData, common: &Common) -> Vec<Column> {
    let rows = rows(table, series);
    let mut columns = identity(series, common, &rows);
    match table {
        Table::Shots => columns.extend(shot_columns(&rows)),
        Table::Markers => {
            columns.extend(image_columns(&rows));
            columns.extend(torsion_columns(&rows, &common.pairs));
            columns.extend(marker_columns(&rows));
            columns.extend(position_columns(&rows));
        }
        Table::Span => columns.extend(point_columns(&rows)),
        Table::Parameters => columns.extend(parameter_columns(&rows)),
    }
    columns.extend(provenance(series, &rows));
    columns
}

fn rows(table: Table, series: &SeriesData) -> Vec<Row<'_>> {
    if table == Table::Shots {
        return series.shots.iter().map(|shot| shot_row(series, shot)).collect();
    }
    series.records.iter().flat_map(|image| image_rows(table, series, image)).collect()
}

fn shot_row<'a>(series: &'a SeriesData, shot: &'a ShotData) -> Row<'a> {
    Row { shot: Some(shot), image: series.record_of(shot), ..Row::default() }
}

fn image_rows<'a>(table: Table, series: &'a SeriesData, image: &'a ImageRecord) -> Vec<Row<'a>> {
    let row = Row { shot: series.shot_of(image), image: Some(image), ..Row::default() };
    match table {
        Table::Span => image.curve.iter().map(|p| Row { point: Some(p), ..row }).collect(),
        Table::Parameters => {
            image.model.terms().into_iter().map(|term| Row { parameter: Some(term), ..row }).collect()
        }
        _ if image.markers.is_empty() => vec![row],
        _ => image.markers.iter().map(|m| Row { marker: Some(m), ..row }).collect(),
    }
}

/// A column of one word.
pub(super) fn text(name: &str, value: Option<&str>, rows: usize) -> Column {
    Column { name: name.to_owned(), values: Values::Text(vec![value.map(str::to_owned); rows]) }
}

/// Which version of the columns a row has: in every table.
pub(super) fn schema_version(rows: usize) -> Column {
    Column { name: "schema_version".to_owned(), values: Values::Count(vec![Some(SCHEMA_VERSION); rows]) }
}

fn words(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<String>) -> Column {
    Column { name: name.to_owned(), values: Values::Text(rows.iter().map(of).collect()) }
}

fn number(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<f64>) -> Column {
    let finite = |row: &Row| of(row).filter(|v| v.is_finite());
    Column { name: name.to_owned(), values: Values::Number(rows.iter().map(finite).collect()) }
}

fn count(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<usize>) -> Column {
    let whole = |row: &Row| of(row).and_then(|n| i64::try_from(n).ok());
    Column { name: name.to_owned(), values: Values::Count(rows.iter().map(whole).collect()) }
}

fn flag(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<bool>) -> Column {
    Column { name: name.to_owned(), values: Values::Flag(rows.iter().map(of).collect()) }
}

/// The key of a shot's results in its recorder.
pub(super) fn result_id(series: &str, shot: u32) -> String {
    format!("{series}/{shot}")
}

fn identity(series: &SeriesData, common: &Common, rows: &[Row]) -> Vec<Column> {
    let utc = |row: &Row| Some(row.shot?.stamp.as_ref()?.utc.as_microsecond());
    let exposure = |row: &Row| row.shot.and_then(|shot| shot.exposure.clone());
    let exposed = |row: &Row| Some(exposure(row)?.exposure_time.as_microsecond());
    let stamp = |row: &Row| row.shot.and_then(|shot| shot.stamp.clone());
    vec![
        words(rows, "recorder_id", |_| common.store_id.clone()),
        words(rows, "flight", |_| Some(series.flight.clone())),
        words(rows, "result_id", |row| Some(result_id(&series.name, row.shot?.number))),
        words(rows, "series", |_| Some(series.name.clone())),
        count(rows, "shot", |row| Some(row.shot?.number as usize)),
        words(rows, "image", |row| {
            row.image.map(|i| i.image.clone()).or_else(|| row.shot.and_then(|s| s.image.clone()))
        }),
        words(rows, "image_sha256", |row| row.shot?.sha256.clone()),
        Column { name: "utc".to_owned(), values: Values::Time(rows.iter().map(utc).collect()) },
        flag(rows, "utc_synchronised", |row| Some(stamp(row)?.utc_synchronised)),
        words(rows, "boot_id", |row| Some(stamp(row)?.boot_id)),
        number(rows, "since_boot_s", |row| Some(stamp(row)?.since_boot_s)),
        Column { name: "exposure_time".to_owned(), values: Values::Time(rows.iter().map(exposed).collect()) },
        number(rows, "exposure_sigma_s", |row| Some(exposure(row)?.exposure_sigma_s)),
        words(rows, "exposure_source", |row| Some(exposure(row)?.exposure_source.name().to_owned())),
        number(rows, "clock_sigma_s", |row| exposure(row)?.clock_sigma_s),
        words(rows, "status", |row| Some(status(row))),
        words(rows, "reason", |row| row.image.and_then(|i| i.reason.clone())),
    ]
}

fn status(row: &Row) -> String {
    match (row.image, row.shot.and_then(|shot| shot.image.as_ref())) {
        (Some(image), _) => word(image.status),
        (None, Some(_)) => "not solved".to_owned(),
        (None, None) => "no frame".to_owned(),
    }
}

/// What the aircraft's data say of a shot: each quantity with its standard deviation.
fn aircraft_columns(rows: &[Row]) -> Vec<Column> {
    let joined =
        |row: &Row, quantity: &Quantity| row.shot.and_then(|shot| shot.aircraft.get(quantity)).copied();
    let both = |quantity: Quantity| {
        let (name, sigma) = (quantity.name(), format!("sigma_{}", quantity.name()));
        [
            number(rows, name, |row| Some(joined(row, &quantity)?.value)),
            number(rows, &sigma, |row| Some(joined(row, &quantity)?.sigma)),
        ]
    };
    Quantity::ALL.into_iter().flat_map(both).collect()
}

fn shot_columns(rows: &[Row]) -> Vec<Column> {
    let mut columns = image_columns(rows);
    columns.extend(aircraft_columns(rows));
    let failures = |row: &Row| row.shot.map(|s| s.failures.join("; ")).filter(|text| !text.is_empty());
    columns.push(count(rows, "failed_attempts", |row| Some(row.shot?.failures.len())));
    columns.push(words(rows, "camera_failures", failures));
    columns
}

/// What a result follows from. The installation's digest names its folder in the store.
fn provenance(series: &SeriesData, rows: &[Row]) -> Vec<Column> {
    let parameters = |p: &Parameters| serde_json::to_string(p).ok();
    vec![
        words(rows, "program", |row| row.image?.provenance.program.clone()),
        words(rows, "installation_sha256", |row| installations::digest_from_provenance(&row.image?.provenance.files)),
        words(rows, "parameters", |row| row.image?.provenance.parameters.as_ref().and_then(parameters)),
        words(rows, "inputs", |row| row.image.and(series.inputs.clone())),
        schema_version(rows.len()),
    ]
}

fn image_columns(rows: &[Row]) -> Vec<Column> {
    vec![
        words(rows, "method", |row| row.image.map(|i| word(i.method))),
        flag(rows, "flight_adjustment", |row| row.image.map(|i| i.flight)),
        number(rows, "variance_factor", |row| row.image?.variance_factor),
        count(rows, "redundancy", |row| row.image?.redundancy),
        words(rows, "global_test", |row| row.image?.global_test.map(word)),
        words(rows, "sigma_kind", |row| row.image?.sigma_kind.map(word)),
        words(rows, "tip_marker", |row| row.image?.tip.as_ref().map(|t| t.marker.clone())),
        number(rows, "tip_deflection_m", |row| row.image?.tip.as_ref().map(|t| t.deflection_m)),
        number(rows, "tip_sigma_deflection_m", |row| row.image?.tip.as_ref()?.sigma_deflection_m),
        number(rows, "tip_deflection_ground_m", |row| row.image?.tip.as_ref()?.deflection_ground_m),
        number(rows, "tip_sigma_deflection_ground_m", |row| {
            row.image?.tip.as_ref()?.sigma_deflection_ground_m
        }),
        number(rows, "tip_deflection_root_m", |row| row.image?.tip.as_ref()?.deflection_root_m),
        number(rows, "tip_sigma_deflection_root_m", |row| row.image?.tip.as_ref()?.sigma_deflection_root_m),
        words(rows, "tip_reference", |row| row.image?.tip.as_ref()?.reference.map(word)),
    ]
}

fn torsion_columns(rows: &[Row], names: &[String]) -> Vec<Column> {
    let of_pair = |name: &String| {
        let pair = |row: &Row| row.image.and_then(|i| i.torsion.iter().find(|t| t.name == *name).cloned());
        let column = |field: &str, of: fn(&TorsionRecord) -> Option<f64>| {
            number(rows, &format!("torsion_{name}_{field}_deg"), |row| of(&pair(row)?))
        };
        [
            column("angle", |p| p.angle_deg),
            column("sigma_angle", |p| p.sigma_deg),
            column("twist", |p| p.twist_deg),
            column("sigma_twist", |p| p.sigma_twist_deg),
        ]
    };
    names.iter().flat_map(of_pair).collect()
}

fn point_columns(rows: &[Row]) -> Vec<Column> {
    let of = |name: &str, field: fn(&CurveRecord) -> Option<f64>| {
        number(rows, name, move |row| row.point.and_then(field))
    };
    vec![
        of("arc_length_m", |p| Some(p.arc_length_m)),
        of("span_m", |p| Some(p.span_m)),
        of("deflection_m", |p| Some(p.deflection_m)),
        of("sigma_deflection_m", |p| p.sigma_deflection_m),
        of("twist_deg", |p| p.twist_deg),
        of("sigma_twist_deg", |p| p.sigma_twist_deg),
    ]
}

/// The terms of a list count from 1.
fn parameter_columns(rows: &[Row]) -> Vec<Column> {
    vec![
        words(rows, "parameter", |row| row.parameter.map(|p| p.name.to_owned())),
        count(rows, "index", |row| Some(row.parameter?.index? + 1)),
        number(rows, "value", |row| Some(row.parameter?.measured?.value)),
        number(rows, "sigma", |row| row.parameter?.measured?.sigma),
    ]
}

fn marker_number(rows: &[Row], name: &str, of: impl Fn(&MarkerRecord) -> Option<f64>) -> Column {
    number(rows, name, |row| row.marker.and_then(&of))
}

fn marker_columns(rows: &[Row]) -> Vec<Column> {
    vec![
        words(rows, "marker", |row| row.marker.map(|m| m.id.clone())),
        words(rows, "shape", |row| row.marker.map(|m| m.shape.name().to_owned())),
        flag(rows, "used", |row| row.marker.map(|m| m.used)),
        words(rows, "marker_reason", |row| row.marker.and_then(|m| m.reason.clone())),
        marker_number(rows, "u_px", |m| m.u_px),
        marker_number(rows, "v_px", |m| m.v_px),
        marker_number(rows, "sigma_u_px", |m| m.sigma_u_px),
        marker_number(rows, "sigma_v_px", |m| m.sigma_v_px),
        marker_number(rows, "residual_u_px", |m| m.residual_u_px),
        marker_number(rows, "residual_v_px", |m| m.residual_v_px),
        marker_number(rows, "redundancy_u", |m| m.redundancy_u),
        marker_number(rows, "redundancy_v", |m| m.redundancy_v),
        marker_number(rows, "w_test", |m| m.w_test),
        marker_number(rows, "mdb_u_px", |m| m.mdb_u_px),
        marker_number(rows, "mdb_v_px", |m| m.mdb_v_px),
        marker_number(rows, "distance_m", |m| m.distance_m),
        marker_number(rows, "sigma_distance_m", |m| m.sigma_distance_m),
        marker_number(rows, "deflection_m", |m| m.deflection_m),
        marker_number(rows, "sigma_deflection_m", |m| m.sigma_deflection_m),
        marker_number(rows, "deflection_ground_m", |m| m.deflection_ground_m),
        marker_number(rows, "sigma_deflection_ground_m", |m| m.sigma_deflection_ground_m),
        marker_number(rows, "deflection_root_m", |m| m.deflection_root_m),
        marker_number(rows, "sigma_deflection_root_m", |m| m.sigma_deflection_root_m),
    ]
}

type Triple = fn(&MarkerRecord) -> Option<[f64; 3]>;

fn position_columns(rows: &[Row]) -> Vec<Column> {
    let kinds: [(&str, &str, Triple); 4] = [
        ("position", "m", |m| m.position_m),
        ("sigma_position", "m", |m| m.sigma_position_m),
        ("position_cad", "m", |m| m.position_cad_m),
        ("sigma_position_cad", "m", |m| m.sigma_position_cad_m),
    ];
    let axes = |(name, unit, of): (&str, &str, Triple)| {
        [("x", 0), ("y", 1), ("z", 2)].map(|(axis, k)| {
            marker_number(rows, &format!("{name}_{axis}_{unit}"), move |m| of(m).map(|p| p[k]))
        })
    };
    kinds.into_iter().flat_map(axes).collect()
}
