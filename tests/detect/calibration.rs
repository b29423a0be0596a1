//! Calibration from known views: the camera within its standard deviations, gross errors rejected.

use nalgebra::{Rotation3, Vector2, Vector3};
use rand::{Rng, SeedableRng, rngs::StdRng};
use wingd::measure::calibrate::{
    BoardPoint, BoardView, CalibrateError, CalibrationOptions, ImageRejection, Verdict, calibrate,
    calibrate_with_options, judge_calibration,
};
use wingd::measure::geometry::Lens;

const SIGMA_PX: f64 = 0.05;

fn lens() -> Lens {
    let pinhole = Lens::pinhole(4000, 3000, 7800.0, 1986.0, 1513.0);
    Lens {
        fy: 7795.0,
        k1: -0.05,
        k2: 0.09,
        k3: -0.02,
        p1: -3e-4,
        p2: 2e-4,
        ..pinhole
    }
}

fn gauss(random: &mut StdRng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Views of a board of 9 x 7 corners, 60 mm apart, about 3 m away, tilted up to 40 degrees.
fn views(random: &mut StdRng, count: usize) -> Vec<BoardView> {
    bowed_views(random, count, [0.0, 0.0])
}

/// Views with the board's middle this far above the chords between its sides, m.
fn bowed_views(random: &mut StdRng, count: usize, bow_m: [f64; 2]) -> Vec<BoardView> {
    let lens = lens();
    (0..count)
        .map(|_| {
            let mut angle = |most: f64| random.random_range(-most..most);
            let turn = Rotation3::from_euler_angles(angle(0.7), angle(0.7), angle(0.5));
            let centre = Vector3::new(angle(0.45), angle(0.3), 3.0 + angle(0.6));
            let corners = (0..63)
                .map(|k| Vector2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 3.0) * 0.06);
            corners
                .filter_map(|board_m| {
                    let (u, v) = (board_m.x / 0.24, board_m.y / 0.18);
                    let z = bow_m[0] * (1.0 - u * u) + bow_m[1] * (1.0 - v * v);
                    let pixel =
                        lens.project(&(turn * Vector3::new(board_m.x, board_m.y, z) + centre))?;
                    let noise = Vector2::new(gauss(random), gauss(random)) * SIGMA_PX;
                    lens.contains(&pixel).then_some(BoardPoint::new(
                        board_m,
                        pixel + noise,
                        SIGMA_PX,
                    ))
                })
                .collect()
        })
        .collect()
}

fn errors(found: &Lens) -> [f64; 9] {
    let t = lens();
    [
        found.fx - t.fx,
        found.fy - t.fy,
        found.cx - t.cx,
        found.cy - t.cy,
        found.k1 - t.k1,
        found.k2 - t.k2,
        found.k3 - t.k3,
        found.p1 - t.p1,
        found.p2 - t.p2,
    ]
}

/// Mean squared normalised errors over simulated sets: nine interior parameters, two bows.
fn mean_squares(seed: u64, bow_m: [f64; 2]) -> [f64; 11] {
    const RUNS: u32 = 200;
    let mut random = StdRng::seed_from_u64(seed);
    let mut squares = [0.0; 11];
    for _ in 0..RUNS {
        let found = calibrate(&bowed_views(&mut random, 15, bow_m), 4000, 3000).unwrap();
        // The rms length of a vector is the square root of two times that of a coordinate.
        assert!(
            (found.rms_px / (SIGMA_PX * 2f64.sqrt()) - 1.0).abs() < 0.1,
            "rms {}",
            found.rms_px
        );
        let interior = errors(&found.lens);
        for (k, square) in squares.iter_mut().enumerate() {
            let normalised = match k {
                0..9 => interior[k] / found.covariance[(k, k)].sqrt(),
                _ => (found.bow[k - 9].value_m - bow_m[k - 9]) / found.bow[k - 9].sigma_m,
            };
            *square += normalised * normalised / f64::from(RUNS);
        }
    }
    squares
}

/// 200 runs determine a mean square to 10 %: 0.6 to 1.5 is four times that about 1.
fn assert_consistent(squares: &[f64; 11]) {
    for (k, square) in squares.iter().enumerate() {
        assert!(
            (0.6..1.5).contains(square),
            "parameter {k}: mean square {square}; all {squares:?}"
        );
    }
}

#[test]
fn the_camera_is_recovered_within_its_standard_deviations() {
    assert_consistent(&mean_squares(11, [0.0, 0.0]));
}

#[test]
fn a_bowed_board_gives_the_same_camera_and_its_bow() {
    // 1.5 mm per metre along, as cardboard and foam sheets bow, and a twist of the other sign across.
    assert_consistent(&mean_squares(14, [0.48 * 1.5e-3, -0.36 * 1.0e-3]));
}

#[test]
fn a_bow_is_significant_where_there_is_one() {
    let mut random = StdRng::seed_from_u64(15);
    let found = calibrate(&bowed_views(&mut random, 15, [1e-3, 0.0]), 4000, 3000).unwrap();
    assert!(found.bow[0].is_significant(), "{:?}", found.bow);
    assert!(
        !found.bow[1].is_significant() || found.bow[1].value_m.abs() < 3.0 * found.bow[1].sigma_m
    );
}

#[test]
fn a_moved_corner_and_a_foreign_image_are_rejected() {
    let mut random = StdRng::seed_from_u64(12);
    let mut views = views(&mut random, 15);
    views[3][20].pixel.x += 4.0;
    for point in &mut views[7] {
        point.pixel += Vector2::new(gauss(&mut random), gauss(&mut random)) * 30.0;
    }
    let found = calibrate(&views, 4000, 3000).unwrap();
    assert_eq!(found.view_rms_px[7], None);
    assert!(
        (found.rms_px / (SIGMA_PX * 2f64.sqrt()) - 1.0).abs() < 0.1,
        "rms {}",
        found.rms_px
    );
    assert!((found.lens.fx - 7800.0).abs() < 5.0 * found.covariance[(0, 0)].sqrt());
}

#[test]
fn too_few_views_are_refused() {
    let mut random = StdRng::seed_from_u64(13);
    let few = views(&mut random, 2);
    assert!(matches!(
        calibrate(&few, 4000, 3000),
        Err(CalibrateError::TooFewViews { .. })
    ));
    assert!(matches!(
        calibrate(&[], 4000, 3000),
        Err(CalibrateError::TooFewViews { .. })
    ));
    // Repeated views determine nothing.
    let same = vec![few[0].clone(); 6];
    if let Ok(found) = calibrate(&same, 4000, 3000) {
        assert!(
            found.covariance[(0, 0)].sqrt() > 1.0,
            "sigma of fx {}",
            found.covariance[(0, 0)].sqrt()
        );
    }
}

/// Views of a board that fills half the image, moved over all of it; tilts up to `tilt`, rad.
fn board_views_at(
    random: &mut StdRng,
    f_factor: f64,
    tilt: f64,
    places: &[(f64, f64)],
) -> Vec<BoardView> {
    let lens = Lens {
        fx: lens().fx * f_factor,
        fy: lens().fy * f_factor,
        ..lens()
    };
    let one = |&(x, y): &(f64, f64)| {
        let mut angle = |most: f64| {
            if most > 0.0 {
                random.random_range(-most..most)
            } else {
                0.0
            }
        };
        let turn = Rotation3::from_euler_angles(angle(tilt), angle(tilt), angle(0.3));
        let centre = Vector3::new(x, y, 3.0 + angle(0.4));
        let mut view = BoardView::new();
        for k in 0..63 {
            let board_m = Vector2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 3.0) * 0.06;
            let at = turn * Vector3::new(board_m.x, board_m.y, 0.0) + centre;
            let Some(pixel) = lens.project(&at).filter(|p| lens.contains(p)) else {
                continue;
            };
            let noise = Vector2::new(gauss(random), gauss(random)) * SIGMA_PX;
            view.push(BoardPoint::new(board_m, pixel + noise, SIGMA_PX));
        }
        view
    };
    places.iter().map(one).collect()
}

fn positions_over_image() -> Vec<(f64, f64)> {
    (0..18)
        .map(|k| (f64::from(k % 3 - 1) * 0.5, f64::from(k / 3 % 3 - 1) * 0.36))
        .collect()
}

#[test]
fn tilted_boards_all_over_the_image_are_good() {
    // Boards at 3 m constrain the camera poorly for 40 m: eighteen images are not enough, three times as
    // many halve the uncertainty.
    let mut random = StdRng::seed_from_u64(21);
    let few = calibrate(
        &board_views_at(&mut random, 1.0, 0.6, &positions_over_image()),
        4000,
        3000,
    )
    .unwrap();
    let (verdict, reasons) = judge_calibration(&few, None);
    assert_eq!(verdict, Verdict::Poor);
    assert!(
        reasons.len() == 1 && reasons[0].contains("a point at 40 m"),
        "{reasons:?}"
    );
    let many = calibrate(
        &board_views_at(&mut random, 1.0, 0.6, &positions_over_image().repeat(3)),
        4000,
        3000,
    )
    .unwrap();
    assert_eq!(judge_calibration(&many, None), (Verdict::Good, vec![]));
}

#[test]
fn hardly_tilted_boards_are_refused_with_the_reason() {
    let mut random = StdRng::seed_from_u64(22);
    let found = calibrate(
        &board_views_at(&mut random, 1.0, 0.03, &positions_over_image()),
        4000,
        3000,
    )
    .unwrap();
    let (verdict, reasons) = judge_calibration(&found, None);
    assert_eq!(verdict, Verdict::Refused, "{reasons:?}");
    assert!(reasons[0].contains("tilt it by 20 to 40"), "{reasons:?}");
}

#[test]
fn boards_in_one_corner_alone_are_poor_and_the_reason_says_where_to_show_more() {
    let mut random = StdRng::seed_from_u64(23);
    let found = calibrate(
        &board_views_at(&mut random, 1.0, 0.6, &[(-0.5, -0.36); 12]),
        4000,
        3000,
    )
    .unwrap();
    let (verdict, reasons) = judge_calibration(&found, None);
    assert_ne!(verdict, Verdict::Good);
    assert!(
        reasons.iter().any(|r| r.contains("lower right")),
        "{reasons:?}"
    );
}

#[test]
fn an_image_with_another_zoom_or_given_twice_is_excluded_by_name() {
    let mut random = StdRng::seed_from_u64(24);
    let mut views = board_views_at(&mut random, 1.0, 0.6, &positions_over_image());
    views.extend(board_views_at(&mut random, 1.2, 0.7, &[(0.1, 0.05)]));
    views.push(views[2].clone());
    let found = calibrate(&views, 4000, 3000).unwrap();
    assert!(
        matches!(found.rejections[18], Some(ImageRejection::OtherZoom { .. })),
        "{:?}",
        found.rejections[18]
    );
    assert_eq!(
        found.rejections[19],
        Some(ImageRejection::Duplicate { earlier: 3 })
    );
    assert!(
        found.rejections[..18].iter().all(Option::is_none),
        "{:?}",
        found.rejections
    );
    assert!((found.lens.fx - lens().fx).abs() < 4.0 * found.covariance[(0, 0)].sqrt());
}

/// A board described without measuring it: longer across its rows than along them by this fraction.
fn stretched(mut views: Vec<BoardView>, share: f64) -> Vec<BoardView> {
    for p in views.iter_mut().flatten() {
        p.board_m = Vector2::new(
            p.board_m.x / (1.0 - 0.5 * share),
            p.board_m.y / (1.0 + 0.5 * share),
        );
    }
    views
}

#[test]
fn a_stretched_board_gives_the_same_camera_if_its_tolerance_is_configured() {
    const RUNS: u32 = 60;
    // 0.3 %: paper after a damp night.
    let (share, options) = (
        0.003,
        CalibrationOptions {
            scale_sigma: Some(0.003),
            ..CalibrationOptions::default()
        },
    );
    let mut random = StdRng::seed_from_u64(31);
    let mut squares = [0.0; 10];
    for _ in 0..RUNS {
        let views = stretched(bowed_views(&mut random, 15, [0.0; 2]), share);
        let found = calibrate_with_options(&views, 4000, 3000, &options).unwrap();
        let stretch = found.stretch.unwrap();
        assert!(
            stretch.is_significant() && stretch.prior_sigma.is_some(),
            "{stretch:?}"
        );
        let interior = errors(&found.lens);
        for (k, square) in squares.iter_mut().enumerate() {
            let normalised = match k {
                0..9 => interior[k] / found.covariance[(k, k)].sqrt(),
                _ => (stretch.value - share) / stretch.sigma,
            };
            *square += normalised * normalised / f64::from(RUNS);
        }
    }
    // 60 runs determine a mean square to 0.18.
    assert!(
        squares.iter().all(|s| (0.5..1.6).contains(s)),
        "{squares:?}"
    );
}

#[test]
fn an_undeclared_stretch_is_named_with_its_effect_on_the_camera() {
    let mut random = StdRng::seed_from_u64(32);
    let views = board_views_at(&mut random, 1.0, 0.6, &positions_over_image().repeat(3));
    let found = calibrate(&stretched(views.clone(), 0.003), 4000, 3000).unwrap();
    let stretch = found.stretch.unwrap();
    assert!(
        (stretch.value - 0.003).abs() < 4.0 * stretch.sigma && stretch.prior_sigma.is_none(),
        "{stretch:?}"
    );
    assert!(
        stretch.projection_change_px > 0.25,
        "it pulls the camera: {stretch:?}"
    );
    let (verdict, reasons) = judge_calibration(&found, None);
    assert_eq!(verdict, Verdict::Poor);
    assert!(
        reasons
            .iter()
            .any(|r| r.contains("+0.30 %") && r.contains("scale_sigma")),
        "{reasons:?}"
    );
    // A configured tolerance that is far too tight.
    let tight = CalibrationOptions {
        scale_sigma: Some(1e-4),
        ..CalibrationOptions::default()
    };
    let found = calibrate_with_options(&stretched(views, 0.003), 4000, 3000, &tight).unwrap();
    let (_, reasons) = judge_calibration(&found, None);
    assert!(
        reasons
            .iter()
            .any(|r| r.contains("more than its scale_sigma")),
        "{reasons:?}"
    );
}
