//! Tables of the pages that take minutes to hours, from the wings of the tests in `tests/adjust`: `make table TABLE=name`.
//! Options are environment variables, named at each table.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
// The files of the tests have more than the tables use.
#![allow(dead_code, unused_imports)]

#[path = "../../adjust/aircraft.rs"]
mod aircraft;
#[path = "../../adjust/builds.rs"]
mod builds;
#[path = "../../common/mod.rs"]
mod common;
#[path = "../../adjust/effect_kinds.rs"]
mod effect_kinds;
mod effects;
mod flight_priors;
mod layout;
#[path = "../../adjust/learning.rs"]
mod learning;
#[path = "../../adjust/live.rs"]
mod live;
mod modes;
#[path = "../../adjust/modes.rs"]
mod vibration;

/// Name, program.
const TABLES: [(&str, fn()); 6] = [
    ("effects", effects::print_effects),
    ("kinds", effects::print_kinds),
    ("flight-priors", flight_priors::print_flight_priors),
    ("live", effects::print_live),
    ("layout", layout::print_layout),
    ("modes", modes::write_modes),
];

fn main() {
    let asked = std::env::args().nth(1).unwrap_or_default();
    match TABLES.iter().find(|(name, _)| *name == asked) {
        Some((_, print)) => print(),
        None => {
            eprintln!("give one of {}", TABLES.map(|(name, _)| name).join(", "));
            std::process::exit(2);
        }
    }
}
