//! A board in front of the window is seen through its panes: how much of their effect a calibration absorbs, and
//! what remains at the wing. Table of docs/validation/calibration.md:
//! `cargo test --release --test detect -- --ignored --nocapture board_pane`.

use nalgebra::{Matrix6, Rotation3, Vector2, Vector3, Vector6};
use rayon::prelude::*;
use wingd::measure::calibrate::{Board, BoardView, calibrate};
use wingd::measure::environment::Plate;
use wingd::measure::geometry::Lens;
use wingd::measure::setup::Pane;
use wingd_simulate::render::{RenderedBoard, SeededRandom};

const BOARD: Board = Board::Checkerboard {
    columns: 12,
    rows: 9,
    square_m: 0.075,
};
/// Board positions, m.
const BOARDS_M: f64 = 5.0;

fn lens() -> Lens {
    Lens {
        k1: -0.08,
        k2: 0.06,
        ..Lens::pinhole(1280, 960, 2500.0, 640.0, 478.0)
    }
}

fn plate(tilt_deg: f64, bow_radius_m: Option<f64>) -> Plate {
    let pane = Pane {
        thickness_m: 0.0145,
        thickness_sigma_m: 0.0,
        index: 1.49,
        index_sigma: 0.0,
        normal_sigma_rad: 0.0,
        bow_radius_m,
        bow_sigma: 0.0,
        distance_m: 0.1,
        same_on_ground: true,
    };
    Plate {
        normal: Rotation3::from_euler_angles(0.0, tilt_deg.to_radians(), 0.0) * Vector3::z(),
        pane,
    }
}

fn views(pane: Option<Plate>) -> Vec<BoardView> {
    let one = |k: u64| {
        let mut random = SeededRandom::new(k, 9);
        let turn =
            Rotation3::from_euler_angles(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), 0.1);
        let place = [(k % 4) as f64 * 0.5 - 0.75, (k / 4) as f64 * 0.36 - 0.54];
        let middle = Vector3::new(place[0], place[1], BOARDS_M + random.uniform(-0.7, 0.7));
        let origin_m = middle - turn * Vector3::new(11.0, 8.0, 0.0) * 0.0375;
        let picture = RenderedBoard {
            lens: lens(),
            corners: (12, 9),
            square_m: 0.075,
            bow_m: [0.0; 2],
            camera_from_board: turn,
            origin_m,
            blur_px: 0.7,
            noise: 1.0,
            pane,
        };
        BOARD
            .find(&picture.render(&mut random).unwrap())
            .map(|s| s.view)
            .unwrap_or_default()
    };
    (0..16).into_par_iter().map(one).collect()
}

/// Remaining image error of points at a distance, px rms: after the best rotation, as `orient` finds it, or
/// also after a shift, as a survey of the projection centre with the same camera would find it.
fn left_px(found: &Lens, pane: Option<Plate>, distance_m: f64, shifts: bool) -> f64 {
    let truth = lens();
    let points: Vec<(Vector3<f64>, Vector2<f64>)> = (0..=10)
        .flat_map(|i| {
            (0..=8).map(move |j| Vector2::new(f64::from(i) * 127.9, f64::from(j) * 119.8))
        })
        .map(|pixel| {
            let point = truth.ray(&pixel).unwrap() * distance_m;
            (
                point,
                truth
                    .project(&pane.map_or(point, |p| p.apparent_point(&point)))
                    .unwrap(),
            )
        })
        .collect();
    let (mut turn, mut shift) = (Rotation3::identity(), Vector3::zeros());
    let mut rms = 0.0;
    for _ in 0..5 {
        let (mut normal, mut right, mut sum) = (Matrix6::zeros(), Vector6::zeros(), 0.0);
        for (point, seen) in &points {
            let moved = turn * point + shift;
            let (pixel, by_point) = found.project_with_jacobian(&moved).unwrap();
            let mut by = nalgebra::SMatrix::<f64, 2, 6>::zeros();
            by.fixed_columns_mut::<3>(0)
                .copy_from(&(-by_point * moved.cross_matrix()));
            by.fixed_columns_mut::<3>(3).copy_from(&by_point);
            normal += by.transpose() * by;
            right += by.transpose() * (seen - pixel);
            sum += (seen - pixel).norm_squared();
        }
        rms = (sum / points.len() as f64).sqrt();
        if !shifts {
            for k in 3..6 {
                normal.row_mut(k).fill(0.0);
                normal.column_mut(k).fill(0.0);
                (normal[(k, k)], right[k]) = (1.0, 0.0);
            }
        }
        let step = normal.cholesky().unwrap().solve(&right);
        let by = Rotation3::new(step.fixed_rows::<3>(0).into_owned());
        turn = by * turn;
        shift = by * shift + step.fixed_rows::<3>(3);
    }
    rms
}

/// Slow tier.
#[test]
#[ignore = "slow tier: five sets of images, a minute"]
fn table_of_pane_effects_absorbed_by_a_calibration() {
    let kinds = [
        ("none", None),
        ("14.5 mm, square to the axis", Some(plate(0.0, None))),
        ("14.5 mm, 20 degrees", Some(plate(20.0, None))),
        ("14.5 mm, 40 degrees", Some(plate(40.0, None))),
        (
            "14.5 mm, 20 degrees, bowed, 10 m",
            Some(plate(20.0, Some(10.0))),
        ),
    ];
    println!(
        "| panes | rms of the boards / px | 5 m | 10 m | 20 m | 40 m | the lens alone at 10 m |"
    );
    for (name, pane) in kinds {
        let found = calibrate(&views(pane), 1280, 960).unwrap();
        let left = [5.0, 10.0, 20.0, 40.0].map(|d| left_px(&found.lens, pane, d, false));
        let alone = left_px(&lens(), pane, 10.0, false);
        let cells: Vec<String> = left.iter().map(|l| format!("{l:.3}")).collect();
        println!(
            "| {name} | {:.4} | {} | {alone:.3} |",
            found.rms_px,
            cells.join(" | ")
        );
        // The boards themselves do not show the panes.
        assert!(found.rms_px < 0.02, "{name}: {} px", found.rms_px);
        // Plane panes leave only a shift of the projection centre by millimetres.
        let shifted = left_px(&found.lens, pane, 10.0, true);
        assert!(shifted < 0.15, "{name}: {shifted} px after a shift");
    }
}
