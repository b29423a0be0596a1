//! The page that shows the clock: a single file that needs no server.

use crate::measure::time_code::{
    BITS, COUNT_BITS, DISC_RADIUS, DISCS, FAST_BITS, HAMMING, SIZE, TICK_MS, cell_rectangle,
};

/// Page that draws the clock, without its data.
const PAGE_TEMPLATE: &str = include_str!("clock_page.html");

/// Returns the page, with the positions and numbers of the code filled in.
pub fn clock_page() -> String {
    let discs = DISCS
        .map(|[x, y]| format!(r#"<circle cx="{x}" cy="{y}" r="{DISC_RADIUS}"/>"#))
        .join("\n  ");
    let rect = |(bit, opposite): (usize, bool)| {
        let [x, y, width, height] = cell_rectangle(bit, opposite);
        format!(
            r#"<rect data-bit="{bit}" data-opposite="{opposite}" x="{x:.4}" y="{y:.4}" width="{width:.4}" height="{height:.4}"/>"#
        )
    };
    let cells: Vec<String> = (0..BITS)
        .flat_map(|bit| [(bit, false), (bit, true)])
        .map(rect)
        .collect();
    PAGE_TEMPLATE
        .replace("{{SIZE}}", &format!("{} {}", SIZE[0], SIZE[1]))
        .replace("{{DISCS}}", &discs)
        .replace("{{CELLS}}", &cells.join("\n  "))
        .replace("{{TICK_MS}}", &TICK_MS.to_string())
        .replace("{{HAMMING}}", &format!("{HAMMING:?}"))
        .replace("{{COUNT_BITS}}", &COUNT_BITS.to_string())
        .replace("{{FAST_BITS}}", &FAST_BITS.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_self_contained() {
        let page = clock_page();
        assert!(!page.contains("{{") && !page.contains("http"), "{page}");
        assert_eq!(
            (
                page.matches("<circle").count(),
                page.matches("<rect").count()
            ),
            (4, 2 * BITS)
        );
    }
}
