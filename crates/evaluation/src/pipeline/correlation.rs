//! Correlation of the parameters of a solution, as the record has it.

use crate::record::Correlation;
use wingd_measure::adjust::{Parameter, Solution};

/// Returns the names of the parameters and their correlation matrix; `None` if the solution has none.
pub(super) fn correlation_record(s: &Solution) -> Option<Correlation> {
    let names = |p: &Parameter| {
        (0..p.values.len())
            .map(|k| format!("{}[{k}]", p.kind.name()))
            .collect::<Vec<String>>()
    };
    let finite = |r: &f64| Some(*r).filter(|r| r.is_finite());
    (s.correlation.nrows() > 0).then(|| Correlation {
        parameters: s.parameters.iter().flat_map(names).collect(),
        matrix: s
            .correlation
            .row_iter()
            .map(|row| row.iter().map(finite).collect())
            .collect(),
    })
}
