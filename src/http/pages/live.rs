//! Live page: empty elements that its scripts fill.

use maud::{Markup, PreEscaped, html};

use super::read_only_page;

const STYLE: &str = include_str!("live.css");

/// Renders empty figures for the scripts. `listens`: whether a live socket is configured.
pub fn live_page(listens: bool) -> Markup {
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        @if !listens {
            p.warning { "No live socket is configured. Set socket in [live] of wingd.toml, or start "
                code { "wingd serve --live-socket PATH" } "." }
        } @else {
            div #health role="status" .degraded { b #word { "waiting" } span #reasons { "for the recorder" } }
            ul.tiles {
                (value_tile("age", "Last result"))
                (value_tile("deflection", "Tip deflection"))
                (value_tile("twist", "Twist"))
                (value_tile("rate", "Results"))
                (value_tile("latency", "Latency"))
                (value_tile("skipped", "Skipped"))
                (value_tile("test", "Global test"))
            }
            p #state .soft {}
            div.live {
                (live_figure("curve", "Deflection along the span"))
                (live_figure("deflections", "Tip deflection over time"))
                section { h2 { "Frame" }
                    div.seen { img #frame alt="The newest frame"; svg #outlines aria-hidden="true" {} }
                    p.caption #frame-caption {} }
                (live_figure("twists", "Twist over time"))
            }
            script src="/live-plot.js" defer {}
            script src="/live.js" defer {}
        }
    };
    read_only_page("Live", &html! {}, &content)
}

fn value_tile(id: &str, name: &str) -> Markup {
    html! { li { span id={ (id) "-name" } { (name) } b id=(id) { "–" } span.soft id={ (id) "-beside" } {} } }
}

/// Returns a section with an SVG that the page's script fills.
fn live_figure(id: &str, name: &str) -> Markup {
    html! {
        section { h2 { (name) }
            svg id=(id) viewBox="0 0 560 300" role="img" aria-label=(name) {}
            p.caption id={ (id) "-caption" } {} }
    }
}
