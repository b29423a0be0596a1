//! Common displacements of several markers. If several markers disagree with the others, one common cause is more probable
//! than several independent outliers.

use nalgebra::Vector3;

use crate::adjust::input::{AdjustmentInput, FrameObservations};
use crate::adjust::term::ParameterTerm;
use crate::adjust::terms;
use crate::setup::WingSide;

/// Minimum number of markers on either side of a displacement; fewer are treated as outliers.
const MIN_MARKERS: usize = 3;
/// Fractions of the length at which a common displacement may begin.
const SPAN_FRACTIONS: [f64; 3] = [0.4, 0.6, 0.8];

/// Candidate displacement: a set of markers that move together along the skin normal.
#[derive(Clone, Debug, PartialEq)]
pub struct CommonDisplacement {
    /// The set of markers, in words.
    description: String,
    markers: Vec<usize>,
}

impl CommonDisplacement {
    /// Builds the unknown of this displacement, m.
    pub fn term(&self, input: &AdjustmentInput) -> ParameterTerm {
        let mut field = vec![Vector3::zeros(); input.setup.markers.len()];
        self.markers
            .iter()
            .for_each(|marker| field[*marker] = Vector3::y());
        terms::common_displacement(field)
    }

    /// Remark for a result that was estimated with this displacement.
    pub fn remark(&self, displaced_m: f64) -> String {
        format!(
            "the markers {} are jointly {:.1} mm {} than the other markers predict; a common offset was estimated for them. \
             Check for one cause (a moving part missing from survey.csv, a survey from two set-ups, a loose panel)",
            self.description,
            1e3 * displaced_m.abs(),
            if displaced_m > 0.0 { "higher" } else { "lower" }
        )
    }
}

/// Lists sets of markers that may share a displacement: aft of the axis, outboard, and both.
pub fn candidate_displacements(
    input: &AdjustmentInput,
    frame_observations: &FrameObservations,
) -> Vec<CommonDisplacement> {
    let ground = &input.scene.ground;
    let nose = if input.setup.side() == Some(WingSide::Left) {
        -1.0
    } else {
        1.0
    };
    let aft = |k: usize| nose * (ground.stations[k].surveyed_m.z - ground.axis.root_m.z) > 0.0;
    let beyond =
        |k: usize, fraction: f64| ground.stations[k].arc_m > fraction * ground.axis.length_m;
    let wing: Vec<usize> = (0..frame_observations.len())
        .filter(|k| frame_observations[*k].is_some() && !input.scene.is_fixed(*k))
        .collect();
    let mut list = vec![];
    let mut add = |description: String, selects: &dyn Fn(usize) -> bool| {
        let markers: Vec<usize> = wing.iter().copied().filter(|k| selects(*k)).collect();
        if markers.len() >= MIN_MARKERS && wing.len() - markers.len() >= MIN_MARKERS {
            list.push(CommonDisplacement {
                description,
                markers,
            });
        }
    };
    add("aft of the bending axis".into(), &aft);
    for fraction in SPAN_FRACTIONS {
        let percent = 100.0 * fraction;
        add(format!("outboard of {percent:.0} % of the length"), &|k| {
            beyond(k, fraction)
        });
        add(
            format!("aft and outboard of {percent:.0} % of the length"),
            &|k| aft(k) && beyond(k, fraction),
        );
    }
    list
}
