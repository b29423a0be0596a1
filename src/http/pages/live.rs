//! The page of live mode is empty; its scripts draw.

use maud::{Markup, PreEscaped, html};

use super::page;

const STYLE: &str = include_str!("live.css");

/// Empty figures that the scripts fill. `listens`: it is known where a recorder in live mode would answer.
pub fn live(listens: bool) -> Markup {
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        @if !listens {
            p.warning { "It is not known where a recorder in live mode answers: set socket in [live] of wingd.toml, or give "
                code { "wingd serve --live-socket PATH" } "." }
        } @else {
            div #health role="status" .degraded { b #word { "waiting" } span #reasons { "for the recorder" } }
            ul.tiles {
                (tile("age", "Last result"))
                (tile("deflection", "Tip deflection"))
                (tile("twist", "Twist"))
                (tile("rate", "Results"))
                (tile("latency", "Latency"))
                (tile("skipped", "Skipped"))
                (tile("test", "Global test"))
            }
            p #state .soft {}
            div.live {
                (figure("curve", "Deflection along the span"))
                (figure("deflections", "Tip deflection, the last minutes"))
                section { h2 { "Frame" }
                    div.seen { img #frame alt="The newest frame"; svg #outlines aria-hidden="true" {} }
                    p.caption #frame-caption {} }
                (figure("twists", "Twist, the last minutes"))
            }
            script src="/live-plot.js" defer {}
            script src="/live.js" defer {}
        }
    };
    page("Live", &html! {}, &content)
}

fn tile(id: &str, name: &str) -> Markup {
    html! { li { span id={ (id) "-name" } { (name) } b id=(id) { "–" } span.soft id={ (id) "-beside" } {} } }
}

fn figure(id: &str, name: &str) -> Markup {
    html! {
        section { h2 { (name) }
            svg id=(id) viewBox="0 0 560 300" role="img" aria-label=(name) {}
            p.caption id={ (id) "-caption" } {} }
    }
}
