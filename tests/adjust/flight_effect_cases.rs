//! Promise: in-flight effects that images do not show are covered by their priors. The tables of all effects, one by one and at
//! sizes that must be covered or detected: `make table TABLE=kinds`.

use crate::aircraft::{SetUp, sample_errors};
use crate::effect_kinds::{KINDS, figures};

/// Deflections alone, with effects that resemble pitch, bending or root rotation: only priors can cover them.
#[test]
fn unobservable_effects_are_covered_by_their_priors() {
    let kinds = [
        ("kink", SetUp::Default, 1.0, 1.3),
        ("root turns", SetUp::Stayed, 5.0, 2.0),
        ("skin bulges", SetUp::Stayed, 6.0, 2.0),
    ];
    for (name, set_up, times, most) in kinds {
        let kind = KINDS.iter().find(|kind| kind.name.starts_with(name)).unwrap();
        let shown = sample_errors(9700, set_up, 5, 24, |rng| (kind.draw)(rng, times)).all;
        let [deflection, ..] = figures(&shown);
        println!("{} times {times}, {set_up:?}: {deflection:.2}", kind.name);
        assert!(deflection < most, "{} times {times}, {set_up:?}: {deflection:.2}", kind.name);
    }
}
