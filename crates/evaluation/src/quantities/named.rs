//! Constructors of quantities, and the quantities that readers of live results name.

use super::{ResultQuantity, ResultRow, ValueGetter, quantity};
use crate::record::Tip;
use wingd_measure::estimation::quality::GlobalTest;
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
.word_since(2, Vec::new);
/// Number of the live result, from 1 at each start.
pub const NUMBER: ResultQuantity = count(
    "number",
    "number since the start of live mode, from 1",
    |r| Some(r.live?.number as usize),
)
.stored(U64);
/// Whether the live frame was solved, 1 or 0.
pub const SOLVED: ResultQuantity = count("solved", "1 or 0; name in version 1 of `status`", |r| {
    Some(usize::from(r.live?.is_solved()))
})
.stored(U8);
/// Whether the global test of a live result passed, 1 or 0.
pub const GLOBAL_TEST_PASSED: ResultQuantity = count(
    "global_test_passed",
    "1 or 0; name in version 1 of `global_test`",
    |r| Some(usize::from(r.image?.global_test? == GlobalTest::Passed)),
)
.stored(U8)
.only_live();
/// Standard deviations of the tip's deflection relative to survey, ground frame and root, by their stored names.
pub const TIP_SIGMAS: [ResultQuantity; 3] = [
    number(
        "sigma_tip_deflection",
        "m",
        "version 1 of `tip_sigma_deflection_m`",
        |r| tip(r)?.sigma_deflection_m,
    )
    .stored(F32)
    .only_live(),
    number(
        "sigma_tip_deflection_ground",
        "m",
        "version 1, ground frame",
        |r| tip(r)?.sigma_deflection_ground_m,
    )
    .stored(F32)
    .only_live(),
    number(
        "sigma_tip_deflection_root",
        "m",
        "version 1, root's tangent",
        |r| tip(r)?.sigma_deflection_root_m,
    )
    .stored(F32)
    .only_live(),
];
/// Columns of the first version of the live format: other columns hold their values, and exports omit them.
pub const FIRST_VERSION: [&str; 5] = [
    SOLVED.name,
    GLOBAL_TEST_PASSED.name,
    TIP_SIGMAS[0].name,
    TIP_SIGMAS[1].name,
    TIP_SIGMAS[2].name,
];
/// Coefficients of the curvature of the bending line, 1/m.
pub const CURVATURE: ResultQuantity =
    number("curvature", "1/m", "coefficients of the curvature", |r| {
        r.curvature?.per_m.get(r.index?).copied()
    })
    .stored(F64);
/// Covariance of the curvature coefficients, 1/m².
pub const CURVATURE_COVARIANCE: ResultQuantity = number(
    "curvature_covariance",
    "1/m2",
    "upper triangle of their covariance, row by row",
    |r| r.curvature?.covariance.get(r.index?).copied(),
)
.stored(F64);

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
