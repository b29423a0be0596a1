//! Promise: dark paint that touches an end of a flat disc shifts it within its standard deviation.

use wingd::measure::detect::{detect, second_pass};

use crate::common::drawn::{
    blurred, discs, expected_discs, local, nearest, normalised_square, on_skin, with_noise,
};

/// A dash at an end of a disc: its grey, and its bounds along and across the disc, px.
struct Dash {
    grey: f64,
    along: [f64; 2],
    across: [f64; 2],
}

#[test]
fn a_dash_that_touches_an_end_is_in_the_standard_deviation() {
    let flat = discs().map(|[x, y, a, _, angle]| [x, y, a, 0.1 * a, angle]);
    let touched = flat[4];
    let dashes = [
        Dash {
            grey: 35.0,
            along: [-46.0, -36.0],
            across: [0.3, 4.0],
        },
        Dash {
            grey: 55.0,
            along: [-48.0, -38.0],
            across: [-3.0, 1.0],
        },
        Dash {
            grey: 20.0,
            along: [34.0, 44.0],
            across: [-4.0, -0.5],
        },
        Dash {
            grey: 55.0,
            along: [37.0, 50.0],
            across: [-1.5, 2.0],
        },
    ];
    let (mut square, mut count) = (0.0, 0.0);
    for (k, dash) in dashes.iter().enumerate() {
        let disc = on_skin(&flat, 165.0, 55.0);
        let scene = |x: f64, y: f64| {
            let (p, q) = local(touched, x, y);
            let (s, t) = (p * touched[2], q * touched[3]);
            let is_dash = (dash.along[0]..dash.along[1]).contains(&s)
                && (dash.across[0]..dash.across[1]).contains(&t);
            if is_dash && p.hypot(q) >= 1.0 {
                dash.grey
            } else {
                disc(x, y)
            }
        };
        let light = blurred(scene, 1.0);
        for seed in 0..4 {
            let image = with_noise(&light, 1.5, seed);
            let mut found = detect(&image);
            second_pass(
                &image,
                &mut found,
                &expected_discs(&flat, &detect(&image).markers),
            );
            let (m, error) = nearest(&found.markers, touched).expect("the disc is found");
            println!(
                "dash {k}: {error:.3?}, variances {:.4?}",
                m.covariance_px2.diagonal()
            );
            square += normalised_square(m, error);
            count += 1.0;
        }
    }
    let normalised: f64 = f64::sqrt(square / count);
    println!("normalised {normalised:.2}");
    assert!(
        (0.3..1.6).contains(&normalised),
        "{normalised} standard deviations"
    );
}
