//! Constructors of quantities, and the quantities that readers of live results name.

use super::{ResultQuantity, ResultRow, ValueGetter, quantity};
use crate::record::{RecordStatus, Tip, variant_name};
use wingd_store::columns::ValueKind::{F32, F64, U8, U64};

pub(super) type Number = fn(&ResultRow) -> Option<f64>;
pub(super) type Text = fn(&ResultRow) -> Option<String>;

pub(super) const fn number(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    value: Number,
) -> ResultQuantity {
    quantity(name, unit, meaning, ValueGetter::Number(value))
}

/// Creates the standard deviation of the quantity that has its name without `sigma_`.
pub(super) const fn sigma(name: &'static str, unit: &'static str, value: Number) -> ResultQuantity {
    number(name, unit, "", value)
}

pub(super) const fn count(
    name: &'static str,
    meaning: &'static str,
    value: fn(&ResultRow) -> Option<usize>,
) -> ResultQuantity {
    quantity(name, "", meaning, ValueGetter::Count(value))
}

pub(super) const fn flag(
    name: &'static str,
    meaning: &'static str,
    value: fn(&ResultRow) -> Option<bool>,
) -> ResultQuantity {
    quantity(name, "", meaning, ValueGetter::Flag(value))
}

pub(super) const fn time(
    name: &'static str,
    meaning: &'static str,
    value: fn(&ResultRow) -> Option<jiff::Timestamp>,
) -> ResultQuantity {
    quantity(name, "", meaning, ValueGetter::Time(value))
}

pub(super) const fn text(name: &'static str, meaning: &'static str, value: Text) -> ResultQuantity {
    quantity(name, "", meaning, ValueGetter::Text(value))
}

pub(super) fn tip<'a>(row: &ResultRow<'a>) -> Option<&'a Tip> {
    row.image?.tip.as_ref()
}

/// Time of the result; other readers of live results use it too, as those below.
pub const UTC: ResultQuantity = time(
    "utc",
    "time of the request to the camera; of a live result `exposure_time`",
    |r| Some(r.stamp?.utc),
)
.stored(U64);
/// Time of the result since boot, s.
pub const SINCE_BOOT: ResultQuantity = number("since_boot", "s", "the same time since boot", |r| {
    Some(r.stamp?.since_boot_s)
})
.stored(F64);
/// Standard deviation of the exposure time on this machine's clock, s.
pub const EXPOSURE_SIGMA: ResultQuantity = number(
    "exposure_sigma",
    "s",
    "its standard deviation on the machine's clock",
    |r| Some(r.exposure?.exposure_sigma_s),
)
.stored(F32);
/// Standard deviation of the machine's clock, s.
pub const CLOCK_SIGMA: ResultQuantity = number(
    "clock_sigma",
    "s",
    "standard deviation of the machine's clock",
    |r| r.exposure?.clock_sigma_s,
)
.stored(F32);
/// Reason for a result without numbers.
pub const REASON: ResultQuantity = text("reason", "why the frame has no solution", |r| {
    r.image?.reason.clone()
})
.stored_words(Vec::new);
/// Number of the live result, from 1 at each start.
pub const NUMBER: ResultQuantity = count(
    "number",
    "number since the start of live mode, from 1",
    |r| Some(r.live?.number as usize),
)
.stored(U64);
/// Status of the image; live results store it as the number of its word.
pub const STATUS: ResultQuantity = text(
    "status",
    "`ok`, `doubtful`, `failed`, `not solved`, `no frame`",
    |r| r.status(),
)
.stored_as("solved", U8, || {
    words([
        RecordStatus::Failed,
        RecordStatus::Ok,
        RecordStatus::Doubtful,
    ])
});

/// Returns the words of an enumeration.
pub(super) fn words(all: impl IntoIterator<Item = impl serde::Serialize>) -> Vec<String> {
    all.into_iter().map(variant_name).collect()
}

/// Names of the quantities of a frame that the summary has; those of the aircraft data have none.
pub const SUMMARY: [&str; 19] = [
    "flight",
    "series",
    "image",
    "utc",
    "status",
    "reason",
    "global_test",
    "tip_marker",
    "tip_deflection",
    "tip_sigma_deflection",
    "tip_deflection_ground",
    "tip_sigma_deflection_ground",
    "tip_reference",
    "twist",
    "sigma_twist",
    "streamwise_twist",
    "sigma_streamwise_twist",
    "",
    "sigma_",
];
