//! Marking page: controls and empty elements that its script fills.

use maud::{Markup, PreEscaped, html};

use wingd_pages::pages::render_html_page;

const STYLE: &str = include_str!("mark.css");

/// Keys and mouse actions with their effects.
const KEYS: [(&str, &str); 12] = [
    ("N, P", "next, previous lost marker"),
    (
        "click",
        "mark the centre of the selected marker, or of the lost one nearby",
    ),
    (
        "Shift and click",
        "mark exactly there, without measurement by the detector",
    ),
    ("drag", "move the selected marker, otherwise the image"),
    ("arrows", "move a mark by 0.5 px, with Shift by 5 px"),
    ("R", "reject the detection or the mark"),
    ("U", "withdraw your mark of this marker"),
    ("E", "assign it to another marker"),
    ("+, -, 0", "zoom in, zoom out, full image"),
    ("[, ]", "previous, next image"),
    (
        "X",
        "change the magnification of residuals and standard deviations",
    ),
    ("Escape", "clear the selection"),
];

/// Renders the marking page. `place`: description of the storage; `who`: default name of the person who marks; `query`: part
/// of the page's address with the token, which its script needs too.
pub fn mark_page(place: &str, who: &str, query: Option<&str>) -> Markup {
    let script = query.map_or("/mark.js".to_owned(), |query| format!("/mark.js?{query}"));
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        div.desk {
            div.view {
                canvas #photo tabindex="0" aria-label="The image with its markers; keys are listed below" {}
                canvas #loupe width="180" height="180" aria-hidden="true" {}
                p #said role="status" { "Reading the image …" }
                div #ask hidden { span #question {} button #yes { "Yes" } button #no { "No" } }
            }
            div.side {
                p.row { button #before title="[" aria-label="previous image" { "‹" }
                    select #picture aria-label="Image" {}
                    button #after title="]" aria-label="next image" { "›" } }
                ul.tiles {
                    li { span #deflection-name { "Tip deflection" } b #deflection { "–" } span.soft #deflection-beside {} }
                    li { span #bare-name { "Without marks" } b #bare { "–" } span.soft #bare-beside {} }
                }
                p.soft #test {}
                p.row { label for="who" { "Who" } input #who maxlength="100" value=(who); }
                p.row { label for="why" { "Why" } input #why maxlength="500" placeholder="glare over its edge, visible by eye"; }
                p.row {
                    button #next title="N" { "Next lost" }
                    button #reject title="R" { "Reject" }
                    button #withdraw title="U" { "Withdraw" }
                    button #rename title="E" { "Rename" }
                    select #to hidden aria-label="New id of the marker" {}
                }
                p.row { button #out title="-" aria-label="zoom out" { "−" } button #in title="+" aria-label="zoom in" { "+" }
                    button #whole title="0" { "Full image" } button #factor title="X" { "× 50" } }
                div.scroll { table #markers { thead { tr { th { "Marker" } th { "State" } th.n { "σ, px" } th.n { "residual, px" } } }
                    tbody {} } }
            }
        }
        details { summary { "Keys" } table { tbody {
            @for (key, does) in KEYS { tr { td { kbd { (key) } } td { (does) } } }
        } } }
        p.caption { "Green: detected. Blue: marked manually. Orange, dashed: predicted outline of a lost marker. Red: rejected. Ellipses are standard \
            deviations and lines are residuals, magnified by the factor on the button. Marks are stored in " code { (place) } "; frames and detections \
            are never changed." }
        script src=(script) defer {}
    };
    render_html_page(
        "Mark",
        &html! {},
        &content,
        "marks are stored with name, time and reason",
    )
}
