//! Causes that many markers have in common: where several lie off together, one of these is likelier than as many blunders.

use nalgebra::Vector3;

use crate::adjust::input::{Input, Sights};
use crate::adjust::term::Term;
use crate::adjust::terms;
use crate::setup::Side;

/// Fewest markers on either side of a cause: fewer are blunders.
const MIN_MARKERS: usize = 3;
/// Places along the span, shares of the length, that a cause may begin at.
const PLACES: [f64; 3] = [0.4, 0.6, 0.8];

/// A cause: markers that are displaced together along the skin's normal.
#[derive(Clone, Debug, PartialEq)]
pub struct CommonDisplacement {
    /// Which markers, for a person.
    what: String,
    markers: Vec<usize>,
}

impl CommonDisplacement {
    /// Its unknown, m.
    pub fn term(&self, input: &Input) -> Term {
        let mut field = vec![Vector3::zeros(); input.setup.markers.len()];
        self.markers.iter().for_each(|marker| field[*marker] = Vector3::y());
        terms::common_cause(field)
    }

    /// What is said of it.
    pub fn sentence(&self, displaced_m: f64) -> String {
        format!(
            "the markers {} lie together {:.1} mm {} than the others put them, and an unknown takes that up: look for one \
             cause (a moving part that survey.csv does not name, a survey from two set-ups, a panel)",
            self.what,
            1e3 * displaced_m.abs(),
            if displaced_m > 0.0 { "higher" } else { "lower" }
        )
    }
}

/// All that are looked at: aft of the axis, outboard of a place, both, and each quarter of the picture.
pub fn causes(input: &Input, sights: &Sights) -> Vec<CommonDisplacement> {
    let ground = &input.scene.ground;
    let nose = if input.setup.side() == Some(Side::Left) { -1.0 } else { 1.0 };
    let aft = |k: usize| nose * (ground.stations[k].surveyed_m.z - ground.axis.root_m.z) > 0.0;
    let beyond = |k: usize, place: f64| ground.stations[k].arc_m > place * ground.axis.length_m;
    let wing: Vec<usize> =
        (0..sights.len()).filter(|k| sights[*k].is_some() && !input.scene.is_fixed(*k)).collect();
    let mut list = vec![];
    let mut add = |what: String, of: &dyn Fn(usize) -> bool| {
        let markers: Vec<usize> = wing.iter().copied().filter(|k| of(*k)).collect();
        if markers.len() >= MIN_MARKERS && wing.len() - markers.len() >= MIN_MARKERS {
            list.push(CommonDisplacement { what, markers });
        }
    };
    add("aft of the bending axis".into(), &aft);
    for place in PLACES {
        let percent = 100.0 * place;
        add(format!("outboard of {percent:.0} % of the length"), &|k| beyond(k, place));
        add(format!("aft and outboard of {percent:.0} % of the length"), &|k| aft(k) && beyond(k, place));
    }
    let lens = &input.setup.lens;
    for (what, right, below) in [
        ("upper left", false, false),
        ("upper right", true, false),
        ("lower left", false, true),
        ("lower right", true, true),
    ] {
        let inside = |k: usize| {
            sights[k].is_some_and(|seen| {
                (seen.pixel.x > 0.5 * f64::from(lens.width)) == right
                    && (seen.pixel.y > 0.5 * f64::from(lens.height)) == below
            })
        };
        add(format!("in the picture's {what} quarter"), &inside);
    }
    list
}
