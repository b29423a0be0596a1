//! The rows of an export, column by column; units are in the names.

use super::super::SeriesData;
use crate::record::{ImageRecord, MarkerRecord, Status, TorsionRecord};

/// A column's values; `None` where there is none.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Words.
    Text(Vec<Option<String>>),
    /// Numbers.
    Number(Vec<Option<f64>>),
    /// Counts.
    Count(Vec<Option<i64>>),
    /// Yes or no.
    Flag(Vec<Option<bool>>),
}

impl Values {
    /// Rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Text(v) => v.len(),
            Self::Number(v) => v.len(),
            Self::Count(v) => v.len(),
            Self::Flag(v) => v.len(),
        }
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One value in full precision; empty where there is none.
    pub fn text(&self, row: usize) -> String {
        fn plain<T: ToString>(values: &[Option<T>], row: usize) -> String {
            values.get(row).and_then(Option::as_ref).map(T::to_string).unwrap_or_default()
        }
        match self {
            Self::Text(v) => plain(v, row),
            Self::Number(v) => plain(v, row),
            Self::Count(v) => plain(v, row),
            Self::Flag(v) => plain(v, row),
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

/// A marker of an image; images without markers have one row.
struct Row<'a> {
    series: &'a SeriesData,
    image: &'a ImageRecord,
    marker: Option<&'a MarkerRecord>,
}

impl Row<'_> {
    fn shot(&self) -> Option<&super::super::ShotData> {
        self.series.shots.iter().find(|s| s.image.as_deref() == Some(self.image.image.as_str()))
    }

    fn pair(&self, name: &str) -> Option<&TorsionRecord> {
        self.image.torsion.iter().find(|t| t.name == name)
    }
}

/// One row per marker per image, with all the fields.
pub fn columns(series: &[SeriesData]) -> Vec<Column> {
    let rows: Vec<Row> = series.iter().flat_map(rows_of).collect();
    let mut columns = image_columns(&rows);
    columns.extend(torsion_columns(&rows));
    columns.extend(marker_columns(&rows));
    columns.extend(position_columns(&rows));
    columns
}

fn rows_of(series: &SeriesData) -> Vec<Row<'_>> {
    let of_image = |image| {
        let row = move |marker| Row { series, image, marker };
        let markers: Vec<Row> = image.markers.iter().map(|m| row(Some(m))).collect();
        if markers.is_empty() { vec![row(None)] } else { markers }
    };
    series.records.iter().flat_map(of_image).collect()
}

fn text(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<String>) -> Column {
    Column { name: name.to_owned(), values: Values::Text(rows.iter().map(of).collect()) }
}

fn number(rows: &[Row], name: &str, of: impl Fn(&Row) -> Option<f64>) -> Column {
    let finite = |row: &Row| of(row).filter(|v| v.is_finite());
    Column { name: name.to_owned(), values: Values::Number(rows.iter().map(finite).collect()) }
}

fn marker_number(rows: &[Row], name: &str, of: impl Fn(&MarkerRecord) -> Option<f64>) -> Column {
    number(rows, name, |row| row.marker.and_then(&of))
}

fn image_columns(rows: &[Row]) -> Vec<Column> {
    let count = |row: &Row| row.image.redundancy.and_then(|r| i64::try_from(r).ok());
    let status = |row: &Row| if row.image.status == Status::Ok { "ok" } else { "failed" };
    let utc = |row: &Row| Some(row.shot()?.stamp.as_ref()?.utc.to_string());
    let synchronised = |row: &Row| Some(row.shot()?.stamp.as_ref()?.utc_synchronised);
    let counts = Values::Count(rows.iter().map(count).collect());
    let flags = Values::Flag(rows.iter().map(synchronised).collect());
    let together = Values::Flag(rows.iter().map(|row| Some(row.image.flight)).collect());
    vec![
        text(rows, "flight", |row| Some(row.series.flight.clone())),
        text(rows, "series", |row| Some(row.series.name.clone())),
        text(rows, "image", |row| Some(row.image.image.clone())),
        text(rows, "image_sha256", |row| row.shot()?.sha256.clone()),
        text(rows, "utc", utc),
        Column { name: "utc_synchronised".to_owned(), values: flags },
        number(rows, "since_boot_s", |row| Some(row.shot()?.stamp.as_ref()?.since_boot_s)),
        text(rows, "status", |row| Some(status(row).to_owned())),
        text(rows, "reason", |row| row.image.reason.clone()),
        text(rows, "method", |row| Some(row.image.method.clone())),
        Column { name: "flight_adjustment".to_owned(), values: together },
        number(rows, "variance_factor", |row| row.image.variance_factor),
        Column { name: "redundancy".to_owned(), values: counts },
        text(rows, "global_test", |row| row.image.global_test.clone()),
        text(rows, "sigma_kind", |row| row.image.sigma_kind.clone()),
        text(rows, "tip_marker", |row| row.image.tip.as_ref().map(|t| t.marker.clone())),
        number(rows, "tip_lift_m", |row| row.image.tip.as_ref().map(|t| t.lift_m)),
        number(rows, "tip_sigma_lift_m", |row| row.image.tip.as_ref()?.sigma_lift_m),
    ]
}

fn torsion_columns(rows: &[Row]) -> Vec<Column> {
    let mut names: Vec<&str> = Vec::new();
    for pair in rows.iter().flat_map(|row| &row.image.torsion) {
        if !names.contains(&pair.name.as_str()) {
            names.push(&pair.name);
        }
    }
    let of_pair = |name: &&str| {
        let column = |field: &str, of: fn(&TorsionRecord) -> Option<f64>| {
            number(rows, &format!("torsion_{name}_{field}_deg"), |row| row.pair(name).and_then(of))
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

fn marker_columns(rows: &[Row]) -> Vec<Column> {
    let used = Values::Flag(rows.iter().map(|row| row.marker.map(|m| m.used)).collect());
    vec![
        text(rows, "marker", |row| row.marker.map(|m| m.id.clone())),
        text(rows, "shape", |row| row.marker.map(|m| m.shape.clone())),
        Column { name: "used".to_owned(), values: used },
        text(rows, "marker_reason", |row| row.marker.and_then(|m| m.reason.clone())),
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
        marker_number(rows, "lift_m", |m| m.lift_m),
        marker_number(rows, "sigma_lift_m", |m| m.sigma_lift_m),
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
