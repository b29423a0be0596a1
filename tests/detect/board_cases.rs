//! Boards that failed in practice: each gives a camera or the right reason.

use std::path::Path;

use nalgebra::{Rotation3, Vector2, Vector3};
use wingd::measure::calibrate::{
    Board, BoardMismatch, BoardPoint, BoardView, CalibrationOptions, ImageRejection, Verdict,
    calibrate, calibrate_with_options, description_mismatch, judge_calibration,
};
use wingd::measure::geometry::Lens;
use wingd::measure::raster::Raster;
use wingd::pipeline::decode;
use wingd_evaluation::boards::{ImageCorners, read_corners};
use wingd_simulate::render::{RenderedBoard, SeededRandom};

/// Corner precision of the fit in sharp images, px.
const SIGMA_PX: f64 = 0.01;

fn file(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/detect/boards")
        .join(name)
}

fn raster(name: &str) -> Raster {
    decode::decode_image(&std::fs::read(file(name)).unwrap(), None).unwrap()
}

fn lens() -> Lens {
    let pinhole = Lens::pinhole(1280, 960, 2487.0, 625.1, 458.6);
    Lens {
        fy: 2487.3,
        k1: -0.1107,
        k2: 0.0717,
        p1: -6e-5,
        p2: 3.9e-4,
        ..pinhole
    }
}

/// A board of 12 x 9 corners, 75 mm apart, with its middle at a given position; tilted about a vertical and a level axis.
fn view(lens: Lens, middle_m: [f64; 3], tilt: [f64; 2], random: &mut SeededRandom) -> BoardView {
    let camera_from_board = Rotation3::from_euler_angles(tilt[0], tilt[1], 0.1);
    let half = Vector3::new(11.0, 8.0, 0.0) * 0.0375;
    let board = RenderedBoard {
        lens,
        corners: (12, 9),
        square_m: 0.075,
        bow_m: [0.0; 2],
        camera_from_board,
        origin_m: Vector3::from(middle_m) - camera_from_board * half,
        blur_px: 0.7,
        noise: 1.0,
        pane: None,
    };
    let mut k = 0;
    let mut point = |pixel: Vector2<f64>| {
        let board_m = Vector2::new(f64::from(k % 12), f64::from(k / 12)) * 0.075;
        k += 1;
        let noise = Vector2::new(random.normal(), random.normal()) * SIGMA_PX;
        lens.contains(&pixel)
            .then(|| BoardPoint::new(board_m, pixel + noise, SIGMA_PX))
    };
    board
        .corner_pixels()
        .into_iter()
        .filter_map(&mut point)
        .collect()
}

/// Boards over the image at 4 to 6 m, tilted in every direction by up to this angle, rad.
fn set(count: usize, tilt: f64, random: &mut SeededRandom) -> Vec<BoardView> {
    (0..count)
        .map(|k| {
            let place = [(k % 3) as f64 * 0.8 - 0.8, (k / 3 % 3) as f64 * 0.6 - 0.6];
            let z = random.uniform(4.5, 6.0);
            let turn = [random.uniform(-tilt, tilt), random.uniform(-tilt, tilt)];
            view(lens(), [place[0], place[1], z], turn, random)
        })
        .collect()
}

#[test]
fn an_image_with_another_zoom_is_named_and_the_others_are_kept() {
    for (seed, factor) in [(1, 1.05), (2, 1.2), (3, 0.97)] {
        let mut random = SeededRandom::new(seed, 0);
        let mut views = set(12, 0.6, &mut random);
        let zoomed = Lens {
            fx: lens().fx * factor,
            fy: lens().fy * factor,
            ..lens()
        };
        views.push(view(zoomed, [0.1, 0.0, 5.0], [0.4, -0.3], &mut random));
        let found = calibrate(&views, 1280, 960).unwrap();
        assert!(
            matches!(found.rejections[12], Some(ImageRejection::OtherZoom { .. })),
            "{:?}",
            found.rejections[12]
        );
        assert!(
            found.rejections[..12].iter().all(Option::is_none),
            "{:?}",
            found.rejections
        );
        assert!((found.lens.fx - 2487.0).abs() < 4.0 * found.covariance[(0, 0)].sqrt());
    }
}

#[test]
fn a_blurred_picture_is_no_outlier_and_a_moving_board_is() {
    let mut random = SeededRandom::new(4, 0);
    let mut views = set(14, 0.6, &mut random);
    let shake = |view: &mut BoardView, px: f64, in_covariance: bool, random: &mut SeededRandom| {
        for p in view {
            p.pixel += Vector2::new(random.normal(), random.normal()) * px;
            if in_covariance {
                *p = BoardPoint::new(p.board_m, p.pixel, px);
            }
        }
    };
    shake(&mut views[3], 0.05, true, &mut random);
    shake(&mut views[5], 0.15, false, &mut random);
    let found = calibrate(&views, 1280, 960).unwrap();
    assert_eq!(
        found.rejections[3], None,
        "its covariance includes the blur"
    );
    assert!(
        matches!(
            found.rejections[5],
            Some(ImageRejection::LargeResiduals { .. } | ImageRejection::TooManyOutliers { .. })
        ),
        "{:?}",
        found.rejections
    );
}

#[test]
fn a_duplicate_image_is_named_even_if_recompressed() {
    let mut random = SeededRandom::new(5, 0);
    let mut views = set(9, 0.6, &mut random);
    let mut again = views[4].clone();
    for p in &mut again {
        p.pixel += Vector2::new(random.normal(), random.normal()) * SIGMA_PX;
    }
    views.push(again);
    let found = calibrate(&views, 1280, 960).unwrap();
    assert_eq!(
        found.rejections[9],
        Some(ImageRejection::Duplicate { earlier: 5 })
    );
}

#[test]
fn parallel_boards_are_refused_and_the_reason_is_the_tilt() {
    let mut random = SeededRandom::new(6, 0);
    let found = calibrate(&set(9, 0.002, &mut random), 1280, 960);
    match found {
        Ok(found) => {
            let (verdict, reasons) = judge_calibration(&found, None);
            assert_eq!(verdict, Verdict::Refused, "{reasons:?}");
            assert!(reasons[0].contains("tilt"), "{reasons:?}");
        }
        Err(error) => assert!(error.to_string().contains("tilt"), "{error}"),
    }
}

#[test]
fn boards_parallel_to_each_other_get_the_advice_to_tilt_to_different_sides() {
    let mut random = SeededRandom::new(15, 0);
    let views: Vec<BoardView> = (0..9)
        .map(|k| {
            let place = [
                (k % 3) as f64 * 0.8 - 0.8,
                (k / 3) as f64 * 0.6 - 0.6,
                random.uniform(4.5, 6.0),
            ];
            view(lens(), place, [0.3, 0.3], &mut random)
        })
        .collect();
    let (verdict, reasons) = judge_calibration(&calibrate(&views, 1280, 960).unwrap(), None);
    assert_ne!(verdict, Verdict::Good);
    assert!(
        reasons.iter().any(|r| r.contains("to different sides")),
        "{reasons:?}"
    );
}

#[test]
fn hardly_tilted_boards_are_refused_with_consistent_sigmas() {
    let mut random = SeededRandom::new(7, 0);
    let found = calibrate(&set(10, 0.03, &mut random), 1280, 960).unwrap();
    let (verdict, reasons) = judge_calibration(&found, None);
    assert_eq!(verdict, Verdict::Refused, "{reasons:?}");
    assert!(reasons[0].contains("tilt it by 20 to 40"), "{reasons:?}");
    assert!((found.lens.fx - 2487.0).abs() < 4.0 * found.covariance[(0, 0)].sqrt());
}

#[test]
fn boards_in_one_corner_are_poor_and_the_reason_says_where_to_show_more() {
    let mut random = SeededRandom::new(8, 0);
    let turn = |random: &mut SeededRandom| [random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6)];
    let views: Vec<BoardView> = (0..10)
        .map(|_| {
            let t = turn(&mut random);
            view(lens(), [-0.7, -0.5, 5.0], t, &mut random)
        })
        .collect();
    let (verdict, reasons) = judge_calibration(&calibrate(&views, 1280, 960).unwrap(), None);
    assert_eq!(verdict, Verdict::Poor, "{reasons:?}");
    assert!(
        reasons.iter().any(|r| r.contains("lower right")),
        "{reasons:?}"
    );
}

#[test]
fn four_poorly_constraining_photographs_converge() {
    let pictures: Vec<ImageCorners> = read_corners(&file("four.csv")).unwrap();
    let views: Vec<BoardView> = pictures.iter().map(|p| p.view.clone()).collect();
    let found = calibrate(&views, pictures[0].size.0, pictures[0].size.1).unwrap();
    assert!(
        found.view_rms_px.iter().all(Option::is_some),
        "{:?}",
        found.rejections
    );
    // OpenCV gives 0.388 px with its own corners and a flat board.
    assert!(found.rms_px < 0.388, "{} px", found.rms_px);
    for k in 0..4 {
        let three: Vec<BoardView> = (0..4)
            .filter(|i| *i != k)
            .map(|i| views[i].clone())
            .collect();
        calibrate(&three, pictures[0].size.0, pictures[0].size.1).unwrap();
    }
}

#[test]
fn a_wrong_board_description_is_the_first_reason() {
    let board = |columns, spacing| Board::AprilGrid {
        columns,
        rows: 6,
        tag_m: 0.12,
        spacing,
    };
    let seen = |board: &Board| -> Vec<Option<BoardMismatch>> {
        (0..4)
            .map(|k| {
                board
                    .find(&raster(&format!("tags{k}.jpg")))
                    .unwrap()
                    .mismatch
            })
            .collect()
    };
    for (board, words) in [
        (board(6, 0.25), "spacing = 0.25"),
        (board(6, 0.35), "spacing = 0.35"),
        (board(7, 0.3), "6 tags in a row"),
        (board(5, 0.3), "6 tags in a row"),
    ] {
        let reason = description_mismatch(&board, &seen(&board)).unwrap();
        assert!(reason.contains(words), "{reason}");
    }
    let right = board(6, 0.3);
    assert_eq!(description_mismatch(&right, &seen(&right)), None);
}

#[test]
fn a_checkerboard_with_more_corners_than_described_is_named() {
    let random = &mut SeededRandom::new(9, 0);
    let camera_from_board = Rotation3::from_euler_angles(0.3, 0.3, 0.0);
    let picture = RenderedBoard {
        lens: lens(),
        corners: (9, 6),
        square_m: 0.1,
        bow_m: [0.0; 2],
        camera_from_board,
        origin_m: Vector3::new(-0.4, -0.25, 5.0),
        blur_px: 0.7,
        noise: 1.0,
        pane: None,
    };
    let raster = picture.render(random).unwrap();
    let board = |columns, rows| Board::Checkerboard {
        columns,
        rows,
        square_m: 0.1,
    };
    for (columns, rows) in [(8, 6), (9, 5)] {
        let misfit = board(columns, rows).find(&raster).unwrap().mismatch;
        let reason = description_mismatch(&board(columns, rows), &[misfit]).unwrap();
        assert!(reason.contains("inner corners"), "{reason}");
    }
    assert_eq!(board(9, 6).find(&raster).unwrap().mismatch, None);
}

#[test]
fn tags_are_found_next_to_a_screen_full_of_text() {
    let board = Board::AprilGrid {
        columns: 6,
        rows: 6,
        tag_m: 0.088,
        spacing: 0.3,
    };
    let found = board.find(&raster("clutter.jpg")).unwrap();
    assert!(found.view.len() >= 4 * 30, "{} corners", found.view.len());
    assert_eq!(found.mismatch, None);
}

#[test]
fn unconstrained_lens_terms_are_dropped_on_demand() {
    let mut random = SeededRandom::new(10, 0);
    let views = set(18, 0.6, &mut random);
    let all = calibrate(&views, 1280, 960).unwrap();
    let some = calibrate_with_options(
        &views,
        1280,
        960,
        &CalibrationOptions {
            select: true,
            ..CalibrationOptions::default()
        },
    )
    .unwrap();
    assert!(
        some.fixed[6] && some.lens.k3 == 0.0,
        "k3 is 0 in truth: {:?} {}",
        some.fixed,
        some.lens.k3
    );
    assert!(!some.fixed[4], "k1 is not");
    assert_eq!(some.covariance[(6, 6)], 0.0);
    assert!(
        some.covariance[(5, 5)] < all.covariance[(5, 5)],
        "the remaining terms are more precise"
    );
    assert!((some.lens.fx - 2487.0).abs() < 4.0 * some.covariance[(0, 0)].sqrt());
}

#[test]
fn two_halves_agree_only_if_the_lens_model_is_right() {
    let mut random = SeededRandom::new(11, 0);
    let sound = calibrate(&set(18, 0.6, &mut random), 1280, 960).unwrap();
    let halves = sound.halves.unwrap();
    assert!(
        halves.difference_px < 3.0 * halves.predicted_px,
        "{halves:?}"
    );
    // The rings slip after half of the images; every second image has the later setting.
    let slipped = Lens {
        fx: 2487.0 * 1.002,
        fy: 2487.3 * 1.002,
        ..lens()
    };
    let views: Vec<BoardView> = (0..18)
        .map(|k| {
            let lens = if k % 2 == 0 { lens() } else { slipped };
            let place = [(k % 3) as f64 * 0.8 - 0.8, (k / 3 % 3) as f64 * 0.6 - 0.6];
            let turn = [random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6)];
            view(lens, [place[0], place[1], 5.0], turn, &mut random)
        })
        .collect();
    let (verdict, reasons) = judge_calibration(&calibrate(&views, 1280, 960).unwrap(), None);
    assert_ne!(verdict, Verdict::Good);
    assert!(
        reasons
            .iter()
            .any(|r| r.contains("halves") || r.contains("do not fit the others")),
        "{reasons:?}"
    );
}

/// Boards of 12 x 9 corners over the entire image of an equidistant lens, 0.02 px.
fn equidistant(c_px: f64, count: usize, random: &mut SeededRandom) -> Vec<BoardView> {
    let widest = 0.5 * 1280f64.hypot(960.0) / c_px;
    let mut one = |k: usize| {
        let camera_from_board = Rotation3::from_euler_angles(
            random.uniform(-0.5, 0.5),
            random.uniform(-0.5, 0.5),
            0.4 * (k % 4) as f64,
        );
        let place = Vector2::new((k % 4) as f64 / 1.5 - 1.0, (k / 4 % 4) as f64 / 1.5 - 1.0);
        let angle = 0.62 * widest * place.norm();
        let direction = Vector3::new(place.x, place.y, place.norm() / angle.tan()).normalize();
        let mut view = BoardView::new();
        for c in 0..108 {
            let board_m = Vector2::new(f64::from(c % 12), f64::from(c / 12)) * 0.075;
            let p = camera_from_board * Vector3::new(board_m.x - 0.41, board_m.y - 0.3, 0.0)
                + direction * 1.1;
            let off = p.xy().norm().atan2(p.z);
            let pixel = p.xy().normalize() * off * c_px + Vector2::new(640.0, 480.0);
            if lens().contains(&pixel) {
                let noise = Vector2::new(random.normal(), random.normal()) * 0.02;
                view.push(BoardPoint::new(board_m, pixel + noise, 0.02));
            }
        }
        view
    };
    (0..count).map(&mut one).collect()
}

#[test]
fn a_wide_lens_that_browns_model_does_not_follow_gets_the_rational_one() {
    let mut random = SeededRandom::new(13, 0);
    // 114 degrees over the diagonal.
    let found = calibrate(&equidistant(800.0, 24, &mut random), 1280, 960).unwrap();
    assert!(found.lens.denominator != [0.0; 3] && found.denominator_sigma.iter().all(|s| *s > 0.0));
    assert!(
        found.rms_px < 1.3 * 0.02 * 2f64.sqrt(),
        "{} px",
        found.rms_px
    );
    assert!(found.pattern.image_px < 0.02, "{:?}", found.pattern);
    assert!(
        judge_calibration(&found, None).0 != Verdict::Refused,
        "{:?}",
        judge_calibration(&found, None)
    );
    // Rays compared with the truth, in pixels at the image centre: a rotation absorbs nothing of the difference here.
    let mut worst: f64 = 0.0;
    for (u, v) in [
        (20.0, 20.0),
        (640.0, 10.0),
        (1260.0, 480.0),
        (900.0, 700.0),
        (1270.0, 950.0),
    ] {
        let off: Vector2<f64> = Vector2::new(u - 640.0, v - 480.0);
        let radius: f64 = off.norm();
        let truth = Vector3::new(off.x, off.y, radius / (radius / 800.0).tan()).normalize();
        worst = worst.max((found.lens.ray(&Vector2::new(u, v)).unwrap() - truth).norm() * 800.0);
    }
    assert!(worst < 1.0, "{worst} px");
}

#[test]
fn an_ordinary_lens_keeps_browns_model() {
    let mut random = SeededRandom::new(14, 0);
    let found = calibrate(&set(12, 0.6, &mut random), 1280, 960).unwrap();
    assert_eq!(found.lens.denominator, [0.0; 3]);
    assert_eq!(found.denominator_sigma, [0.0; 3]);
}

#[test]
fn a_fisheye_is_distinguished_from_a_wrong_board() {
    // An equidistant lens of 150 degrees, which no polynomial in the tangent fits.
    let mut random = SeededRandom::new(12, 0);
    let mut views = vec![];
    for k in 0..16 {
        let camera_from_board =
            Rotation3::from_euler_angles(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), 0.0);
        let middle = Vector3::new((k % 4) as f64 - 1.5, (k / 4) as f64 * 0.8 - 1.2, 0.0) * 0.8
            + Vector3::z() * 0.75;
        let mut view = BoardView::new();
        for c in 0..108 {
            let board_m = Vector2::new(f64::from(c % 12), f64::from(c / 12)) * 0.075;
            let p =
                camera_from_board * Vector3::new(board_m.x - 0.41, board_m.y - 0.3, 0.0) + middle;
            let off = p.xy().norm().atan2(p.z);
            let pixel = p.xy().normalize() * off * 450.0 + Vector2::new(640.0, 480.0);
            if off < 1.3 && lens().contains(&pixel) {
                view.push(BoardPoint::new(
                    board_m,
                    pixel + Vector2::new(random.normal(), random.normal()) * 0.02,
                    0.02,
                ));
            }
        }
        views.push(view);
    }
    match calibrate(&views, 1280, 960) {
        Ok(found) => {
            let (verdict, reasons) = judge_calibration(&found, None);
            assert_ne!(verdict, Verdict::Good, "{} px", found.rms_px);
            // The rational model fits it within the area of the boards, but does not extrapolate.
            let unsure = found.lens.denominator != [0.0; 3]
                && reasons.iter().any(|r| r.contains("a point at 40 m"));
            assert!(
                unsure || reasons.iter().any(|r| r.contains("Brown's model")),
                "{reasons:?}"
            );
        }
        Err(error) => assert!(error.to_string().contains("no camera fits"), "{error}"),
    }
}
