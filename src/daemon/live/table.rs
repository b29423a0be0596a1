//! Converts live results to rows of the store's table (docs/store.md).

use std::sync::Arc;

use serde_json::{Map, Value};

use wingd_base::clock::Stamp;
use wingd_evaluation::pipeline::live::LiveResult;
use wingd_evaluation::quantities::{
    LiveSource, REASON, ResultQuantity, ResultRow, Subject, stored_quantities,
};
use wingd_store::columns::{LiveColumn, LiveRow, LiveTable, WORD};

/// Layout of the rows, taken from one result.
pub(crate) struct RowLayout {
    pub table: LiveTable,
    pub first: Arc<LiveResult>,
    columns: Vec<StoredColumn>,
}

/// Column of the rows.
struct StoredColumn {
    quantity: &'static ResultQuantity,
    /// Number of values in a row.
    width: usize,
    /// Words that its numbers stand for.
    words: Vec<String>,
}

/// Reasons of frames without numbers, in order of appearance.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct ReasonWords(Vec<String>);

/// Maximum number of distinct reasons in a table. Each new one begins a file; apart from the numbers in them there are few.
const MAX_REASONS: usize = 32;
/// Reason that replaces all reasons beyond [`MAX_REASONS`].
const OTHER_REASON: &str = "one of more than 32 reasons; see the recorder's log";

impl ReasonWords {
    /// Registers the reason of a result; returns whether it is new.
    pub fn register(&mut self, result: &LiveResult) -> bool {
        let Some(reason) = &result.tracked.record.reason else {
            return false;
        };
        let known = self.0.contains(reason) || self.0.len() > MAX_REASONS;
        if !known {
            let one = if self.0.len() == MAX_REASONS {
                OTHER_REASON
            } else {
                reason.as_str()
            };
            self.0.push(one.to_owned());
        }
        !known
    }
}

impl RowLayout {
    /// Creates the layout from the first result with numbers; `provenance` is that of all results, `reasons` are those
    /// registered so far. A table with other reasons begins a new file.
    pub fn from_result(
        first: Arc<LiveResult>,
        provenance: &Map<String, Value>,
        reasons: &ReasonWords,
    ) -> Self {
        let (record, terms) = (&first.tracked.record, first.curvature_terms());
        let (mut columns, mut described) = (vec![], vec![]);
        // The reasons come first in the file.
        let mut words: Map<String, Value> = [(REASON.name.to_owned(), reasons.0.clone().into())]
            .into_iter()
            .collect();
        for (subject, form, quantity) in stored_quantities() {
            let width = match subject {
                Subject::Marker => record.markers.len(),
                Subject::Station => record.curve.len(),
                Subject::Section => record.moments.len(),
                Subject::Pair => record.torsion.len(),
                Subject::CurvatureTerm => terms,
                Subject::CurvatureTermPair => terms * (terms + 1) / 2,
                Subject::Row | Subject::Aircraft => 1,
            };
            let (name, unit) = (
                quantity.stored_name(subject),
                quantity.stored_unit().to_owned(),
            );
            let own = if quantity.name == REASON.name {
                reasons.0.clone()
            } else {
                (form.words)()
            };
            if unit == WORD {
                words.insert(name.clone(), own.clone().into());
            }
            if width > 0 {
                described.push(LiveColumn {
                    name,
                    unit,
                    kind: form.kind,
                    width,
                });
                columns.push(StoredColumn {
                    quantity,
                    width,
                    words: own,
                });
            }
        }
        let source = LiveSource {
            provenance: provenance.clone(),
            method: Some("live".to_owned()),
            words,
            markers: record
                .markers
                .iter()
                .map(|marker| marker.id.clone().into())
                .collect(),
            stations: record
                .curve
                .iter()
                .map(|station| station.arc_length_m.into())
                .collect(),
            sections: record
                .moments
                .iter()
                .map(|moment| moment.arc_length_m.into())
                .collect(),
            torsion: record
                .torsion
                .iter()
                .map(|pair| pair.name.clone().into())
                .collect(),
            tip: record.tip.as_ref().map(|tip| tip.marker.clone()),
        };
        let source = serde_json::to_value(source).unwrap_or_default();
        Self {
            table: LiveTable {
                source,
                columns: described,
            },
            first,
            columns,
        }
    }

    /// Returns the values of a result in the order of the columns.
    pub fn row(&self, result: &LiveResult) -> LiveRow {
        let exposure = &result.exposure;
        let stamp = Stamp {
            utc: exposure.exposure_time,
            utc_synchronised: exposure.clock.synchronised,
            since_boot_s: exposure.exposure_since_boot_s,
            boot_id: String::new(),
        };
        let row = ResultRow {
            stamp: Some(&stamp),
            exposure: Some(exposure),
            image: Some(&result.tracked.record),
            live: Some(result),
            curvature: result
                .tracked
                .curvature
                .as_ref()
                .filter(|_| result.curvature_terms() == self.first.curvature_terms()),
            ..ResultRow::default()
        };
        let values = |column: &StoredColumn| {
            let value = |index| {
                column.quantity.encode(
                    &ResultRow {
                        index: Some(index),
                        ..row
                    },
                    &column.words,
                )
            };
            (0..column.width).map(value).collect::<Vec<f64>>()
        };
        self.columns.iter().flat_map(values).collect()
    }
}
