//! Section of the report with the aircraft data.

use maud::{Markup, html};

use wingd_evaluation::aircraft::Quantity;
use wingd_evaluation::grid::Grid;
use wingd_evaluation::number::{NONE, format_measured};
use wingd_evaluation::results::ReportData;

/// Returns the section; empty without aircraft data.
pub fn aircraft_section(data: &ReportData) -> Markup {
    let Some((unused, samples)) = data.feed else {
        return html! {};
    };
    html! {
        h2 id="aircraft" { "Aircraft data" }
        (aircraft_table(data).html())
        p.caption {
            "Values with 1 sigma at the first shot of each series that has aircraft data, interpolated by time tag. " (samples) " samples used; lines not used: "
            (unused.unread) " without data, " (unused.repeated) " repeated, " (unused.jumped) " with an implausible time."
        }
    }
}

fn aircraft_table(data: &ReportData) -> Grid {
    let joined: Vec<Quantity> = Quantity::ALL
        .into_iter()
        .filter(|q| {
            data.series
                .iter()
                .flat_map(|s| &s.shots)
                .any(|shot| shot.aircraft.contains_key(q))
        })
        .collect();
    let mut titles = vec!["<series"];
    titles.extend(joined.iter().map(|q| q.name()));
    let mut grid = Grid::new(&titles);
    for series in &data.series {
        let first = series.shots.iter().find(|shot| !shot.aircraft.is_empty());
        let cell = |q: &Quantity| {
            let value = first.and_then(|shot| shot.aircraft.get(q));
            value.map_or(NONE.to_owned(), |j| {
                format_measured(Some(j.value), Some(j.sigma), 2)
            })
        };
        grid.push(
            std::iter::once(series.name.clone())
                .chain(joined.iter().map(cell))
                .collect(),
        );
    }
    grid
}
