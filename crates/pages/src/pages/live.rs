//! Live page: empty elements that its scripts fill.

use maud::{Markup, PreEscaped, html};

use super::render_read_only_page;
use wingd_evaluation::figures::axis::Axis;
use wingd_evaluation::figures::figure::{Figure, FigureTrack, MAIN_COLOUR};

const STYLE: &str = include_str!("live.css");

/// Renders empty figures for the scripts. `listens`: whether a recorder in live mode serves the page.
pub fn live_page(listens: bool) -> Markup {
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        @if !listens {
            p.warning { "Live mode is off. Set rate_hz in [live] of wingd.toml; the recorder serves this page." }
        } @else {
            div #health role="status" .degraded { b #word { "waiting" } span #reasons { "for the recorder" } }
            ul.tiles {
                (render_value_tile("age", "Last result"))
                (render_value_tile("deflection", "Tip deflection"))
                (render_value_tile("twist", "Twist"))
                (render_value_tile("streamwise", "Streamwise twist"))
                (render_value_tile("rate", "Results"))
                (render_value_tile("latency", "Latency"))
                (render_value_tile("skipped", "Skipped"))
                (render_value_tile("test", "Global test"))
            }
            p #state .soft {}
            div.live {
                (live_figure("curve", "Deflection along the span", "span / m", "deflection / m"))
                (live_figure("deflections", "Tip deflection over time", "time / s", "deflection / m"))
                section { h2 { "Frame" }
                    div.seen { img #frame alt="The newest frame"; svg #outlines aria-hidden="true" {} }
                    p.caption #frame-caption {} }
                (live_figure("twists", "Twist over time", "time / s", "twist / deg"))
            }
            script src="/figure.js" defer {}
            script src="/live.js" defer {}
        }
    };
    render_read_only_page("Live", &html! {}, &content)
}

fn render_value_tile(id: &str, name: &str) -> Markup {
    html! { li { span id={ (id) "-name" } { (name) } b id=(id) { "–" } span.soft id={ (id) "-beside" } {} } }
}

/// Returns a section with a figure, whose points, range and note the page's script sets.
fn live_figure(id: &str, name: &str, x_label: &str, y_label: &str) -> Markup {
    let track = |(name, colour, class)| FigureTrack {
        class,
        ..FigureTrack::from_points(name, colour, Vec::new())
    };
    let tracks = [
        ("results", MAIN_COLOUR, ""),
        ("test rejected", "#8f3c0b", "doubt"),
        ("no results", "#667080", "hole"),
    ];
    let range = || [0.0, 10.0].into_iter();
    let figure = Figure {
        name: name.to_owned(),
        height: 260.0,
        x: Axis::from_values(range(), x_label),
        y: Axis::from_values(range(), y_label),
        tracks: tracks.map(track).to_vec(),
    };
    html! {
        section { h2 { (name) }
            div.graph.empty id=(id) { p.note {} (figure.draw()) }
            p.caption id={ (id) "-caption" } {} }
    }
}
