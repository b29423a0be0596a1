//! Scene for an existing installation: a wing whose skin passes through the surveyed markers.

use nalgebra::{Matrix4, Rotation3, Vector3, Vector4};

use super::beam::{CantileverBeam, LoadShape};
use super::clutter::SkinClutter;
use super::layout::{SceneOptions, aim_camera};
use super::markers::SceneMarker;
use super::random::SeededRandom;
use super::scene::Scene;
use super::wing::{DeformedWing, LinearTaper, SceneSide, SceneState, SceneWing};
use wingd_measure::setup::{Setup, Shape};

/// Reason why no scene can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitFault {
    /// Too few markers to fit the skin.
    #[error("{0} markers in the survey; at least 4 are needed to fit the skin")]
    TooFew(usize),
    /// Marker off the fitted skin.
    #[error(
        "no smooth wing passes through marker {id}: it is {off_mm:.0} mm off; check its survey coordinates \
         and span_direction"
    )]
    OffSkin { id: String, off_mm: f64 },
}

const LOAD: LoadShape = LoadShape {
    triangular: 0.35,
    relief: 0.15,
};
const MAX_OFFSET_M: f64 = 0.15;

impl Scene {
    /// Builds a scene from an installation, with the survey as truth, but points moved onto the smooth skin. Quantities not
    /// in the survey (load, twist, clutter) follow from the seed; so does the attitude if none is given.
    ///
    /// # Errors
    /// Returns an error if there are too few markers or no smooth skin passes through them.
    pub fn from_setup(
        setup: &Setup,
        camera_from_survey: Option<Rotation3<f64>>,
        seed: u64,
        tip_deflection_m: f64,
    ) -> Result<Self, FitFault> {
        let mut random = SeededRandom::new(seed, 12);
        let frame = setup.wing_frame();
        let (_, points): (Vec<usize>, Vec<_>) = setup.wing_markers().into_iter().unzip();
        if points.len() < 4 {
            return Err(FitFault::TooFew(points.len()));
        }
        let wing = fit_skin(initial_wing(setup, &points), &points);
        let pose = wing.deform(&SceneState::ground(LOAD));
        let mut markers: Vec<SceneMarker> = setup
            .markers
            .iter()
            .map(|surveyed| {
                let point = frame.wing_point(&surveyed.position_m);
                let marker = SceneMarker {
                    id: surveyed.id.clone(),
                    shape: surveyed.shape,
                    diameter_m: surveyed.diameter_m,
                    s_m: 0.0,
                    z_m: 0.0,
                    rotation_rad: random.uniform(0.0, std::f64::consts::FRAC_PI_2),
                    height_m: 0.0,
                    fixed_m: surveyed.fixed.then_some(point),
                };
                if surveyed.fixed {
                    marker
                } else {
                    place_marker(marker, &pose, &point)
                }
            })
            .collect();
        let off = |marker: &&SceneMarker| marker.height_m.abs() > MAX_OFFSET_M;
        if let Some(marker) = markers.iter().find(off) {
            return Err(FitFault::OffSkin {
                id: marker.id.clone(),
                off_mm: 1e3 * marker.height_m,
            });
        }
        let mut setup = setup.clone();
        for (marker, surveyed) in markers.iter_mut().zip(&mut setup.markers) {
            if surveyed.shape == Shape::Point && !surveyed.fixed {
                // A structure is painted on the skin: its surveyed position moves there.
                marker.height_m = 0.0;
                surveyed.position_m = frame.survey_point(&marker.disc_on_wing(&pose).centre_m);
            }
        }
        let options = SceneOptions {
            lens: setup.lens,
            tip_deflection_m,
            ..SceneOptions::random(seed, wing.side)
        };
        let attitude = camera_from_survey
            .unwrap_or_else(|| aim_camera(&mut random, &wing, &options) * frame.wing_from_survey);
        let mut clutter = SkinClutter::random(&mut random, &wing, 1.0);
        let points = markers
            .iter()
            .filter(|m| m.shape == Shape::Point && m.fixed_m.is_none());
        let mut structures = SeededRandom::new(seed, 13);
        points
            .enumerate()
            .for_each(|(k, m)| clutter.add_structure(&mut structures, k, m.s_m, m.z_m));
        Ok(Self {
            setup,
            clutter,
            wing,
            markers,
            frame,
            camera_from_survey: attitude,
            load: LoadShape {
                triangular: random.uniform(0.15, 0.6),
                relief: random.uniform(0.05, 0.3),
            },
            twist_rad_per_m: random.uniform(0.2, 1.0).to_radians(),
        })
    }
}

/// Returns the wing as far as the survey gives it directly, with start values of root height, slopes and crown.
fn initial_wing(setup: &Setup, points: &[Vector3<f64>]) -> SceneWing {
    let n = points.len() as f64;
    let furthest = points.iter().map(|p| p.x).fold(0.0, f64::max);
    let length_m = setup.skin_height.map_or(0.0, |skin| skin.tip_span_m);
    let length_m = length_m.max(1.02 * (furthest - setup.root_offset_m));
    let axis_z_m = setup
        .axis_chord_offset_m
        .unwrap_or(points.iter().map(|p| p.z).sum::<f64>() / n);
    let eta = |p: &Vector3<f64>| (p.x - setup.root_offset_m) / length_m;
    // Wide enough for every marker, with a typical taper.
    let taper = 0.3;
    let half = points
        .iter()
        .map(|p| (p.z - axis_z_m).abs() * 1.25 / (1.0 - (1.0 - taper) * eta(p)))
        .fold(0.1 * length_m, f64::max);
    let leading = |pair: &wingd_measure::setup::TorsionPair| {
        let z = |i: usize| {
            setup
                .markers
                .get(i)
                .map_or(0.0, |m| setup.wing_frame().wing_point(&m.position_m).z)
        };
        z(pair.leading) < z(pair.trailing)
    };
    let side = if setup.torsion.first().is_none_or(leading) {
        SceneSide::Right
    } else {
        SceneSide::Left
    };
    let skin = setup.skin_height.map_or(
        LinearTaper {
            root: 0.0,
            tip: 0.0,
        },
        |skin| LinearTaper {
            root: skin.root_m,
            tip: skin.root_m + (skin.tip_m - skin.root_m) * length_m / skin.tip_span_m,
        },
    );
    SceneWing {
        side,
        root_x_m: setup.root_offset_m,
        root_y_m: points.iter().map(|p| p.y - 0.08 * p.x).sum::<f64>() / n - skin.root,
        axis_z_m,
        slope_rad: LinearTaper {
            root: 0.08,
            tip: 0.08,
        },
        edge_low_m: LinearTaper {
            root: -half,
            tip: -half * taper,
        },
        edge_high_m: LinearTaper {
            root: half,
            tip: half * taper,
        },
        skin_m: skin,
        crown: 0.04,
        wave_m: 0.0,
        beam: CantileverBeam {
            length_m,
            taper,
            stiffness_power: 3.5,
        },
    }
}

fn change_wing_surface(wing: &SceneWing, change: &Vector4<f64>) -> SceneWing {
    SceneWing {
        root_y_m: wing.root_y_m + change[0],
        slope_rad: LinearTaper {
            root: wing.slope_rad.root + change[1],
            tip: wing.slope_rad.tip + change[2],
        },
        crown: wing.crown + change[3],
        ..*wing
    }
}

/// Fits root height, slopes and crown to the markers' heights by least squares, with weak priors at typical values.
fn fit_skin(mut wing: SceneWing, points: &[Vector3<f64>]) -> SceneWing {
    const STEP: [f64; 4] = [1e-4, 1e-5, 1e-5, 1e-4];
    for _ in 0..6 {
        let base = skin_heights(&wing, points);
        let columns: Vec<Vec<f64>> = (0..4)
            .map(|k| {
                let moved = skin_heights(
                    &change_wing_surface(&wing, &(Vector4::ith(k, STEP[k]))),
                    points,
                );
                moved
                    .iter()
                    .zip(&base)
                    .map(|(m, b)| (m - b) / STEP[k])
                    .collect()
            })
            .collect();
        let mut normal = Matrix4::zeros();
        let mut right = Vector4::zeros();
        for (i, residual) in base.iter().enumerate() {
            let row = Vector4::from_fn(|k, _| columns[k][i]);
            normal += row * row.transpose() / 1e-6;
            right -= row * *residual / 1e-6;
        }
        // Crown 0.04 +- 0.03; change of slope 0 +- 0.05.
        normal[(3, 3)] += 1.0 / 9e-4;
        right[3] -= (wing.crown - 0.04) / 9e-4;
        let bow = Vector4::new(0.0, 1.0, -1.0, 0.0);
        normal += bow * bow.transpose() / 2.5e-3;
        right -= bow * (wing.slope_rad.root - wing.slope_rad.tip) / 2.5e-3;
        let Some(change) = normal.lu().solve(&right) else {
            break;
        };
        wing = change_wing_surface(&wing, &change);
    }
    wing
}

/// Returns the height of the skin above each point, m.
fn skin_heights(wing: &SceneWing, points: &[Vector3<f64>]) -> Vec<f64> {
    let pose = wing.deform(&SceneState::ground(LOAD));
    let height = |point: &Vector3<f64>| {
        let mut s = point.x - wing.root_x_m;
        for _ in 0..8 {
            s += point.x - pose.skin_point(s, point.z - wing.axis_z_m).x;
        }
        pose.skin_point(s, point.z - wing.axis_z_m).y - point.y
    };
    points.iter().map(height).collect()
}

/// Moves a marker so that its centre on ground is the given point.
fn place_marker(mut marker: SceneMarker, pose: &DeformedWing, point: &Vector3<f64>) -> SceneMarker {
    marker.s_m = point.x - pose.wing.root_x_m;
    marker.z_m = point.z - pose.wing.axis_z_m;
    for _ in 0..25 {
        let miss = point - marker.disc_on_wing(pose).centre_m;
        marker.s_m += miss.x;
        marker.height_m += miss.y;
        marker.z_m += miss.z;
    }
    marker
}
