//! Export tables: the rows of a series in named, typed columns.

use super::super::{SeriesData, ShotData, distinct_values};
use crate::aircraft::Quantity;
use crate::record::{CurveRecord, ImageRecord, MarkerRecord, Parameters, Term, TorsionRecord, variant_name};
use crate::store::installations;

/// Version of names, units and meanings of the columns (docs/tables.md). Within a version columns may be added, never
/// changed or removed.
pub const SCHEMA_VERSION: i64 = 3;

/// Values of one column; `None` for a missing value.
#[derive(Clone, Debug, PartialEq)]
pub enum ColumnValues {
    Text(Vec<Option<String>>),
    Number(Vec<Option<f64>>),
    Single(Vec<Option<f32>>),
    Count(Vec<Option<i64>>),
    Flag(Vec<Option<bool>>),
    /// Times, microseconds since 1970 UTC.
    Time(Vec<Option<i64>>),
}

impl ColumnValues {
    /// Returns the number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(v) => v.len(),
            Self::Number(v) => v.len(),
            Self::Single(v) => v.len(),
            Self::Count(v) | Self::Time(v) => v.len(),
            Self::Flag(v) => v.len(),
        }
    }

    /// Returns true if there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Formats one value in full precision, a time as RFC 3339 in UTC; empty if the value is missing.
    pub fn value_text(&self, row: usize) -> String {
        fn plain_text<T: ToString>(values: &[Option<T>], row: usize) -> String {
            values.get(row).and_then(Option::as_ref).map(T::to_string).unwrap_or_default()
        }
        match self {
            Self::Text(v) => plain_text(v, row),
            Self::Number(v) => plain_text(v, row),
            Self::Single(v) => plain_text(v, row),
            Self::Count(v) => plain_text(v, row),
            Self::Flag(v) => plain_text(v, row),
            Self::Time(v) => {
                let moment = v.get(row).copied().flatten().map(jiff::Timestamp::from_microsecond);
                moment.and_then(Result::ok).map(|t| t.to_string()).unwrap_or_default()
            }
        }
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        match self {
            Self::Text(v) => v.clear(),
            Self::Number(v) => v.clear(),
            Self::Single(v) => v.clear(),
            Self::Count(v) | Self::Time(v) => v.clear(),
            Self::Flag(v) => v.clear(),
        }
    }

    /// Appends the rows of another column of the same type.
    pub fn append(&mut self, more: Self) {
        match (self, more) {
            (Self::Text(v), Self::Text(m)) => v.extend(m),
            (Self::Number(v), Self::Number(m)) => v.extend(m),
            (Self::Single(v), Self::Single(m)) => v.extend(m),
            (Self::Count(v), Self::Count(m)) | (Self::Time(v), Self::Time(m)) => v.extend(m),
            (Self::Flag(v), Self::Flag(m)) => v.extend(m),
            // The columns of a table have the same types for every series.
            _ => {}
        }
    }
}

/// Named column with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportColumn {
    /// Name, with the unit.
    pub name: String,
    pub values: ColumnValues,
}

/// Table to export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ExportTable {
    /// One row per marker per image; an image without markers has one row.
    #[default]
    Markers,
    /// One row per point of the curve along the span per image.
    Span,
    /// One row per parameter of the model per image.
    Parameters,
    /// One row per requested shot, with or without a frame.
    Shots,
}

/// Data common to the rows of all series.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExportContext {
    /// Random id of the recorder's store; `None` in a store without evidence.
    pub store_id: Option<String>,
    /// Names of the torsion pairs; each pair has its own columns.
    pub pairs: Vec<String>,
}

impl ExportContext {
    /// Collects the common data of all series.
    pub fn from_series(store_id: Option<String>, series: &[SeriesData]) -> Self {
        let pairs = series.iter().flat_map(|s| &s.records).flat_map(|r| &r.torsion);
        let names = distinct_values(pairs.map(|pair| pair.name.as_str()));
        Self { store_id, pairs: names.into_iter().map(str::to_owned).collect() }
    }
}

#[derive(Clone, Copy, Default)]
struct ExportRow<'a> {
    shot: Option<&'a ShotData>,
    image: Option<&'a ImageRecord>,
    marker: Option<&'a MarkerRecord>,
    point: Option<&'a CurveRecord>,
    parameter: Option<Term>,
}

/// Builds the columns of a table for one series.
pub fn table_columns(table: ExportTable, series: &SeriesData, common: &ExportContext) -> Vec<ExportColumn> {
    let rows = table_rows(table, series);
    let mut columns = identity_columns(series, common, &rows);
    match table {
        ExportTable::Shots => columns.extend(shot_columns(&rows)),
        ExportTable::Markers => {
            columns.extend(image_columns(&rows));
            columns.extend(torsion_columns(&rows, &common.pairs));
            columns.extend(marker_columns(&rows));
            columns.extend(position_columns(&rows));
        }
        ExportTable::Span => columns.extend(point_columns(&rows)),
        ExportTable::Parameters => columns.extend(parameter_columns(&rows)),
    }
    columns.extend(provenance_columns(series, &rows));
    columns
}

fn table_rows(table: ExportTable, series: &SeriesData) -> Vec<ExportRow<'_>> {
    if table == ExportTable::Shots {
        return series.shots.iter().map(|shot| shot_row(series, shot)).collect();
    }
    series.records.iter().flat_map(|image| image_rows(table, series, image)).collect()
}

fn shot_row<'a>(series: &'a SeriesData, shot: &'a ShotData) -> ExportRow<'a> {
    ExportRow { shot: Some(shot), image: series.record_for_shot(shot), ..ExportRow::default() }
}

fn image_rows<'a>(table: ExportTable, series: &'a SeriesData, image: &'a ImageRecord) -> Vec<ExportRow<'a>> {
    let row = ExportRow { shot: series.shot_for_record(image), image: Some(image), ..ExportRow::default() };
    match table {
        ExportTable::Span => image.curve.iter().map(|p| ExportRow { point: Some(p), ..row }).collect(),
        ExportTable::Parameters => {
            image.model.terms().into_iter().map(|term| ExportRow { parameter: Some(term), ..row }).collect()
        }
        _ if image.markers.is_empty() => vec![row],
        _ => image.markers.iter().map(|m| ExportRow { marker: Some(m), ..row }).collect(),
    }
}

/// Builds a column with the same text in all rows.
pub(super) fn constant_text(name: &str, value: Option<&str>, rows: usize) -> ExportColumn {
    ExportColumn { name: name.to_owned(), values: ColumnValues::Text(vec![value.map(str::to_owned); rows]) }
}

/// Builds the column of the schema version, which every table has.
pub(super) fn schema_version(rows: usize) -> ExportColumn {
    let values = ColumnValues::Count(vec![Some(SCHEMA_VERSION); rows]);
    ExportColumn { name: "schema_version".to_owned(), values }
}

fn text_column(rows: &[ExportRow], name: &str, value: impl Fn(&ExportRow) -> Option<String>) -> ExportColumn {
    ExportColumn { name: name.to_owned(), values: ColumnValues::Text(rows.iter().map(value).collect()) }
}

fn number_column(rows: &[ExportRow], name: &str, value: impl Fn(&ExportRow) -> Option<f64>) -> ExportColumn {
    let finite = |row: &ExportRow| value(row).filter(|v| v.is_finite());
    ExportColumn { name: name.to_owned(), values: ColumnValues::Number(rows.iter().map(finite).collect()) }
}

fn count_column(rows: &[ExportRow], name: &str, value: impl Fn(&ExportRow) -> Option<usize>) -> ExportColumn {
    let whole = |row: &ExportRow| value(row).and_then(|n| i64::try_from(n).ok());
    ExportColumn { name: name.to_owned(), values: ColumnValues::Count(rows.iter().map(whole).collect()) }
}

fn flag_column(rows: &[ExportRow], name: &str, value: impl Fn(&ExportRow) -> Option<bool>) -> ExportColumn {
    ExportColumn { name: name.to_owned(), values: ColumnValues::Flag(rows.iter().map(value).collect()) }
}

/// Returns the key of a shot's results, unique within a recorder.
pub(super) fn result_id(series: &str, shot: u32) -> String {
    format!("{series}/{shot}")
}

fn identity_columns(series: &SeriesData, common: &ExportContext, rows: &[ExportRow]) -> Vec<ExportColumn> {
    let utc = |row: &ExportRow| Some(row.shot?.stamp.as_ref()?.utc.as_microsecond());
    let exposure = |row: &ExportRow| row.shot.and_then(|shot| shot.exposure.clone());
    let exposed = |row: &ExportRow| Some(exposure(row)?.exposure_time.as_microsecond());
    let exposure_times = ColumnValues::Time(rows.iter().map(exposed).collect());
    let stamp = |row: &ExportRow| row.shot.and_then(|shot| shot.stamp.clone());
    vec![
        text_column(rows, "recorder_id", |_| common.store_id.clone()),
        text_column(rows, "flight", |_| Some(series.flight.clone())),
        text_column(rows, "result_id", |row| Some(result_id(&series.name, row.shot?.number))),
        text_column(rows, "series", |_| Some(series.name.clone())),
        count_column(rows, "shot", |row| Some(row.shot?.number as usize)),
        text_column(rows, "image", |row| {
            row.image.map(|i| i.image.clone()).or_else(|| row.shot.and_then(|s| s.image.clone()))
        }),
        text_column(rows, "image_sha256", |row| row.shot?.sha256.clone()),
        ExportColumn { name: "utc".to_owned(), values: ColumnValues::Time(rows.iter().map(utc).collect()) },
        flag_column(rows, "utc_synchronised", |row| Some(stamp(row)?.utc_synchronised)),
        text_column(rows, "boot_id", |row| Some(stamp(row)?.boot_id)),
        number_column(rows, "since_boot_s", |row| Some(stamp(row)?.since_boot_s)),
        ExportColumn { name: "exposure_time".to_owned(), values: exposure_times },
        number_column(rows, "exposure_sigma_s", |row| Some(exposure(row)?.exposure_sigma_s)),
        text_column(rows, "exposure_source", |row| Some(exposure(row)?.exposure_source.name().to_owned())),
        number_column(rows, "clock_sigma_s", |row| exposure(row)?.clock_sigma_s),
        text_column(rows, "status", |row| Some(shot_status(row))),
        text_column(rows, "reason", |row| row.image.and_then(|i| i.reason.clone())),
    ]
}

fn shot_status(row: &ExportRow) -> String {
    match (row.image, row.shot.and_then(|shot| shot.image.as_ref())) {
        (Some(image), _) => variant_name(image.status),
        (None, Some(_)) => "not solved".to_owned(),
        (None, None) => "no frame".to_owned(),
    }
}

/// Builds the columns of the aircraft data of a shot, each quantity with its standard deviation.
fn aircraft_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    let joined = |row: &ExportRow, quantity: &Quantity| row.shot.and_then(|shot| shot.aircraft.get(quantity)).copied();
    let both = |quantity: Quantity| {
        let (name, sigma) = (quantity.name(), format!("sigma_{}", quantity.name()));
        [
            number_column(rows, name, |row| Some(joined(row, &quantity)?.value)),
            number_column(rows, &sigma, |row| Some(joined(row, &quantity)?.sigma)),
        ]
    };
    Quantity::ALL.into_iter().flat_map(both).collect()
}

fn shot_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    let mut columns = image_columns(rows);
    columns.extend(aircraft_columns(rows));
    let failures = |row: &ExportRow| row.shot.map(|s| s.failures.join("; ")).filter(|text| !text.is_empty());
    columns.push(count_column(rows, "failed_attempts", |row| Some(row.shot?.failures.len())));
    columns.push(text_column(rows, "camera_failures", failures));
    columns
}

/// Builds the columns of a result's inputs. The installation's digest names its folder in the store.
fn provenance_columns(series: &SeriesData, rows: &[ExportRow]) -> Vec<ExportColumn> {
    let parameters = |p: &Parameters| serde_json::to_string(p).ok();
    vec![
        text_column(rows, "program", |row| row.image?.provenance.program.clone()),
        text_column(rows, "installation_sha256", |row| {
            installations::digest_from_provenance(&row.image?.provenance.files)
        }),
        text_column(rows, "parameters", |row| row.image?.provenance.parameters.as_ref().and_then(parameters)),
        text_column(rows, "inputs", |row| row.image.and(series.inputs.clone())),
        schema_version(rows.len()),
    ]
}

fn image_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    vec![
        text_column(rows, "method", |row| row.image.map(|i| variant_name(i.method))),
        flag_column(rows, "flight_adjustment", |row| row.image.map(|i| i.flight)),
        number_column(rows, "variance_factor", |row| row.image?.variance_factor),
        count_column(rows, "redundancy", |row| row.image?.redundancy),
        text_column(rows, "global_test", |row| row.image?.global_test.map(variant_name)),
        text_column(rows, "sigma_kind", |row| row.image?.sigma_kind.map(variant_name)),
        text_column(rows, "tip_marker", |row| row.image?.tip.as_ref().map(|t| t.marker.clone())),
        number_column(rows, "tip_deflection_m", |row| row.image?.tip.as_ref().map(|t| t.deflection_m)),
        number_column(rows, "tip_sigma_deflection_m", |row| row.image?.tip.as_ref()?.sigma_deflection_m),
        number_column(rows, "tip_deflection_ground_m", |row| row.image?.tip.as_ref()?.deflection_ground_m),
        number_column(rows, "tip_sigma_deflection_ground_m", |row| row.image?.tip.as_ref()?.sigma_deflection_ground_m),
        number_column(rows, "tip_deflection_root_m", |row| row.image?.tip.as_ref()?.deflection_root_m),
        number_column(rows, "tip_sigma_deflection_root_m", |row| row.image?.tip.as_ref()?.sigma_deflection_root_m),
        text_column(rows, "tip_reference", |row| row.image?.tip.as_ref()?.reference.map(variant_name)),
    ]
}

fn torsion_columns(rows: &[ExportRow], names: &[String]) -> Vec<ExportColumn> {
    let of_pair = |name: &String| {
        let pair = |row: &ExportRow| row.image.and_then(|i| i.torsion.iter().find(|t| t.name == *name).cloned());
        let column = |field: &str, value: fn(&TorsionRecord) -> Option<f64>| {
            number_column(rows, &format!("torsion_{name}_{field}_deg"), |row| value(&pair(row)?))
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

fn point_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    let column = |name: &str, field: fn(&CurveRecord) -> Option<f64>| {
        number_column(rows, name, move |row| row.point.and_then(field))
    };
    vec![
        column("arc_length_m", |p| Some(p.arc_length_m)),
        column("span_m", |p| Some(p.span_m)),
        column("deflection_m", |p| Some(p.deflection_m)),
        column("sigma_deflection_m", |p| p.sigma_deflection_m),
        column("twist_deg", |p| p.twist_deg),
        column("sigma_twist_deg", |p| p.sigma_twist_deg),
    ]
}

/// Builds the columns of the parameters; the terms of a list are numbered from 1.
fn parameter_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    vec![
        text_column(rows, "parameter", |row| row.parameter.map(|p| p.name.to_owned())),
        count_column(rows, "index", |row| Some(row.parameter?.index? + 1)),
        number_column(rows, "value", |row| Some(row.parameter?.measured?.value)),
        number_column(rows, "sigma", |row| row.parameter?.measured?.sigma),
    ]
}

fn marker_column(rows: &[ExportRow], name: &str, value: impl Fn(&MarkerRecord) -> Option<f64>) -> ExportColumn {
    number_column(rows, name, |row| row.marker.and_then(&value))
}

fn marker_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    vec![
        text_column(rows, "marker", |row| row.marker.map(|m| m.id.clone())),
        text_column(rows, "shape", |row| row.marker.map(|m| m.shape.name().to_owned())),
        flag_column(rows, "used", |row| row.marker.map(|m| m.used)),
        text_column(rows, "marker_reason", |row| row.marker.and_then(|m| m.reason.clone())),
        marker_column(rows, "u_px", |m| m.u_px),
        marker_column(rows, "v_px", |m| m.v_px),
        marker_column(rows, "sigma_u_px", |m| m.sigma_u_px),
        marker_column(rows, "sigma_v_px", |m| m.sigma_v_px),
        marker_column(rows, "residual_u_px", |m| m.residual_u_px),
        marker_column(rows, "residual_v_px", |m| m.residual_v_px),
        marker_column(rows, "redundancy_u", |m| m.redundancy_u),
        marker_column(rows, "redundancy_v", |m| m.redundancy_v),
        marker_column(rows, "w_test", |m| m.w_test),
        marker_column(rows, "mdb_u_px", |m| m.mdb_u_px),
        marker_column(rows, "mdb_v_px", |m| m.mdb_v_px),
        marker_column(rows, "distance_m", |m| m.distance_m),
        marker_column(rows, "sigma_distance_m", |m| m.sigma_distance_m),
        marker_column(rows, "deflection_m", |m| m.deflection_m),
        marker_column(rows, "sigma_deflection_m", |m| m.sigma_deflection_m),
        marker_column(rows, "deflection_ground_m", |m| m.deflection_ground_m),
        marker_column(rows, "sigma_deflection_ground_m", |m| m.sigma_deflection_ground_m),
        marker_column(rows, "deflection_root_m", |m| m.deflection_root_m),
        marker_column(rows, "sigma_deflection_root_m", |m| m.sigma_deflection_root_m),
    ]
}

type PositionField = fn(&MarkerRecord) -> Option<[f64; 3]>;

fn position_columns(rows: &[ExportRow]) -> Vec<ExportColumn> {
    let kinds: [(&str, &str, PositionField); 4] = [
        ("position", "m", |m| m.position_m),
        ("sigma_position", "m", |m| m.sigma_position_m),
        ("position_cad", "m", |m| m.position_cad_m),
        ("sigma_position_cad", "m", |m| m.sigma_position_cad_m),
    ];
    let axes = |(name, unit, position): (&str, &str, PositionField)| {
        [("x", 0), ("y", 1), ("z", 2)]
            .map(|(axis, k)| marker_column(rows, &format!("{name}_{axis}_{unit}"), move |m| position(m).map(|p| p[k])))
    };
    kinds.into_iter().flat_map(axes).collect()
}
