//! The page of live mode is empty; its script draws.

use maud::{Markup, PreEscaped, html};

use super::page;

const STYLE: &str = include_str!("live.css");

/// Empty figures that the script fills. `listens`: it is known where a recorder in live mode would answer.
pub fn live(listens: bool) -> Markup {
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        @if !listens {
            p.warning { "It is not known where a recorder in live mode answers: set socket in [live] of wingd.toml, or give "
                code { "wingd serve --live-socket PATH" } "." }
        } @else {
            p #state role="status" .soft { "Waiting for the recorder." }
            ul.tiles {
                (tile("lift", "Tip lift"))
                (tile("twist", "Twist"))
                (tile("rate", "Results"))
                (tile("latency", "Latency"))
                (tile("skipped", "Skipped"))
                (tile("test", "Global test"))
            }
            div.live {
                section { h2 { "Lift along the span" } svg #curve viewBox="0 0 560 300" role="img" aria-label="Lift along the span" {} p.caption #curve-caption {} }
                section { h2 { "Tip lift, the last minutes" } svg #lifts viewBox="0 0 560 300" role="img" aria-label="Tip lift over the last minutes" {} p.caption #lifts-caption {} }
                section { h2 { "Frame" }
                    div.seen { img #frame alt="The newest frame"; svg #outlines aria-hidden="true" {} }
                    p.caption #frame-caption {} }
                section { h2 { "Twist, the last minutes" } svg #twists viewBox="0 0 560 300" role="img" aria-label="Twist over the last minutes" {} p.caption #twists-caption {} }
            }
            script src="/live.js" defer {}
        }
    };
    page("Live", &html! {}, &content)
}

fn tile(id: &str, name: &str) -> Markup {
    html! { li { span id={ (id) "-name" } { (name) } b id=(id) { "–" } span.soft id={ (id) "-beside" } {} } }
}
