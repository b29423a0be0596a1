//! The page on which markers are marked is empty but for its controls; its script draws.

use maud::{Markup, PreEscaped, html};

use super::sheet;

const STYLE: &str = include_str!("mark.css");

/// What is marked with the keyboard, and what each does.
const KEYS: [(&str, &str); 12] = [
    ("N, P", "next, previous marker that is lost"),
    ("click", "the centre of the marker that is chosen, or of the lost one nearby"),
    ("Shift and click", "exactly there: the detector does not measure"),
    ("drag", "a marker that is chosen; else the picture"),
    ("arrows", "move a mark by half a pixel, with Shift by five"),
    ("R", "reject what is detected, or the mark"),
    ("U", "take what you said of this marker back"),
    ("E", "give it another marker's name"),
    ("+, -, 0", "nearer, farther, the whole picture"),
    ("[, ]", "the picture before, the next one"),
    ("X", "enlarge residuals and standard deviations more, or less"),
    ("Escape", "choose none"),
];

/// `place`: where marks are kept; `who`: in whose name.
pub fn mark(place: &str, who: &str) -> Markup {
    let content = html! {
        style { (PreEscaped(STYLE)) }
        noscript { p.warning { "This page needs its script, which comes from this server." } }
        div.desk {
            div.view {
                canvas #photo tabindex="0" aria-label="The picture with its markers; keys are listed below" {}
                canvas #loupe width="180" height="180" aria-hidden="true" {}
                p #said role="status" { "Reading the picture …" }
                div #ask hidden { span #question {} button #yes { "Yes" } button #no { "No" } }
            }
            div.side {
                p.row { button #before title="[" aria-label="the picture before" { "‹" }
                    select #picture aria-label="Picture" {}
                    button #after title="]" aria-label="the next picture" { "›" } }
                ul.tiles {
                    li { span #deflection-name { "Tip deflection" } b #deflection { "–" } span.soft #deflection-beside {} }
                    li { span #bare-name { "Without marks" } b #bare { "–" } span.soft #bare-beside {} }
                }
                p.soft #test {}
                p.row { label for="who" { "Who" } input #who maxlength="100" value=(who); }
                p.row { label for="why" { "Why" } input #why maxlength="500" list="reasons" placeholder="glare over its edge, seen by eye";
                    datalist #reasons {} }
                p.row {
                    button #next title="N" { "Next lost" }
                    button #reject title="R" { "Reject" }
                    button #withdraw title="U" { "Take back" }
                    button #rename title="E" { "Rename" }
                    select #to hidden aria-label="The name it is to have" {}
                }
                p.row { button #out title="-" aria-label="farther" { "−" } button #in title="+" aria-label="nearer" { "+" }
                    button #whole title="0" { "Whole" } button #factor title="X" { "× 50" } }
                div.scroll { table #markers { thead { tr { th { "Marker" } th { "Seen" } th.n { "σ, px" } th.n { "residual, px" } } }
                    tbody {} } }
            }
        }
        details { summary { "Keys" } table { tbody {
            @for (key, does) in KEYS { tr { td { kbd { (key) } } td { (does) } } }
        } } }
        p.caption { "Green: detected. Blue: by hand. Orange, dashed: where a lost marker should be. Red: rejected. Ellipses are standard \
            deviations and lines residuals, enlarged as the button says. Marks are kept with " code { (place) } "; frames and detections \
            are never changed." }
        script src="/mark.js" defer {}
    };
    sheet("Mark", &html! {}, &content, "marks are kept with who, when and why")
}
