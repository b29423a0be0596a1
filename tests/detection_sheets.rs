//! Promise: a disc over which the sheet lies that another one is printed on is found, and says how well it is told.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod drawn;

use drawn::{Ellipse, discs, nearest, normalised_square, picture, within};
use wingd::measure::detect::detect;

const SKIN: f64 = 190.0;
const BLACK: f64 = 50.0;

/// Nine whole discs, one more beside the last of them, over which that one's sheet lies, and the rows that this leaves of it.
fn scene(hidden: Ellipse, beside: Ellipse, sheet_from: f64) -> impl Fn(f64, f64) -> f64 {
    let mut whole = discs().to_vec();
    whole.push(beside);
    move |x, y| {
        let left = within(hidden, x, y) && y < sheet_from;
        if left || whole.iter().any(|&d| within(d, x, y)) { BLACK } else { SKIN }
    }
}

#[test]
fn what_a_sheet_leaves_of_a_disc_tells_its_place() {
    let (mut squares, mut count) = (0.0, 0);
    for (blur, noise) in [(0.9, 2.0), (1.8, 2.0), (0.9, 5.0)] {
        for seed in 0..4u64 {
            let shift = 0.23 * seed as f64;
            let hidden = [560.4 + shift, 372.0 + shift, 51.0, 6.0, -0.09];
            let beside = [566.0 + shift, 386.5 + shift, 51.7, 6.1, -0.09];
            // Half of it, or a little more or less.
            let sheet_from = 371.5 + 0.6 * seed as f64;
            let found = detect(&picture(scene(hidden, beside, sheet_from), blur, noise, seed)).markers;
            let (marker, error) = nearest(&found, hidden).expect("it is found");
            println!("blur {blur}, noise {noise}: off by {:.2} {:.2} px", error.x, error.y);
            squares += normalised_square(marker, error);
            count += 1;
            assert_eq!(found.len(), 11, "each disc once, and nothing else");
        }
    }
    let normalised = (squares / f64::from(count)).sqrt();
    println!("normalised error {normalised:.2}");
    assert!((0.5..1.4).contains(&normalised), "{normalised} standard deviations");
}
