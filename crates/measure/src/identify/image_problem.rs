//! Least squares of images with names: of the ground frames for the orientation, and of a frame or installation for its
//! diagnosis, which frees one unknown at a time.
//!
//! Everything that a setup leaves uncertain is an unknown with a prior. Errors of survey and projection centre are therefore
//! common to all images, and more frames do not reduce them. An unknown that is not uncertain is [`FIXED`].

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Rotation3, Vector2, Vector3};

use super::fit::{ANY_DEFLECTION, StatePrior};
use super::outline::{DiscOutline, SkinDisc};
use super::scene::{MODEL_SIGMA_M, PIXEL_FLOOR_PX, WingView, skin_disc};
use super::wing::{CURVATURE_TERMS, StateWing, WING_TERMS, WingState};
use crate::adjust::marker_arm::CarriedMarker;
use crate::environment::Plate;
use crate::estimation::{
    Block, EstimationError, EstimationResult, Fit, Group, GroupPoint, Linearised, Prior, Problem,
    SolveOptions, solve_groups,
};
use crate::geometry::{BROWN, Lens, cross_matrix, left_jacobian};
use crate::observation::Observation;
use crate::setup::{Orientation, Setup, Shape, Width};

/// Kind and, if measured, semi-major axis of an outline, px.
pub type SizedShape = (Shape, Option<f64>);

/// Image of a marker with its name; its centre is free of the perspective bias.
#[derive(Clone, Copy, Debug)]
pub(super) struct NamedImage {
    pub(super) marker: usize,
    pub(super) pixel: Vector2<f64>,
    pub(super) covariance_px2: Matrix2<f64>,
    /// Outline; `None` for a manual mark.
    pub(super) outline: Option<SizedShape>,
}

impl NamedImage {
    /// Creates the image of an observation.
    pub(super) fn new(seen: &Observation, outline: Option<SizedShape>) -> Self {
        Self {
            marker: seen.marker,
            pixel: seen.pixel,
            covariance_px2: seen.covariance_px2,
            outline,
        }
    }

    /// Returns kind and semi-major axis, px, if it was measured.
    pub(super) fn size(&self) -> Option<(Shape, f64)> {
        self.outline
            .and_then(|(shape, major)| Some((shape, major?)))
    }
}

/// First columns of the unknowns. Small rotation of the camera, camera frame, rad.
pub(super) const TURN: usize = 0;
/// Terms of curvature, 1/m, and twist, rad.
pub(super) const WING: usize = TURN + 3;
/// Correction of the projection centre, survey frame, m.
pub(super) const CENTRE: usize = WING + WING_TERMS;
/// Corrections of the interior orientation, in the order of [`Lens::PARAMETERS`].
pub(super) const LENS: usize = CENTRE + 3;
/// Logarithm of the scale of the image.
pub(super) const SCALE: usize = LENS + BROWN;
/// Logarithm of the scale of the survey's coordinates.
pub(super) const POINT_SCALE: usize = SCALE + 1;
/// Logarithm of the markers' sizes over those of the survey.
pub(super) const PRINT: usize = POINT_SCALE + 1;
/// Displacement of all edges and of those of quadrants, px.
const EDGES: usize = PRINT + 1;
/// Correction of the image of [`ImageProblem::wrong_mark`], px.
pub(super) const MARK: usize = EDGES + 2;
/// Corrections of the surveyed positions, survey frame, m.
pub(super) const MARKERS: usize = MARK + 2;

/// Standard deviation of an unknown that is not uncertain, in its unit: negligible, and regular.
const FIXED: f64 = 1e-9;
/// Standard deviation of an unknown that is free, in its unit: more than any error.
pub(super) const FREE: f64 = 1e5;
/// Smallest standard deviation of a surveyed point and of the projection centre, m.
const MIN_SIGMA_M: f64 = 1e-5;
/// Standard deviations of a semi-major axis, px, of a circle and of a quadrant, whose white fields end without contrast:
/// measured in rendered frames of three programs in seven lights (docs/identification.md).
const SIZE_SIGMAS_PX: (f64, f64) = (0.2, 1.7);
/// Standard deviation of a semi-major axis over that of the centre of a marker partly hidden by glare or dirt, measured
/// likewise.
const SIZE_OVER_CENTRE: f64 = 2.0;
/// Standard deviations of the displacement of all edges: blur, tone curve and glare, and of the edges of all quadrants:
/// contrast of the white fields, px, measured likewise.
const EDGE_SIGMAS_PX: [f64; 2] = [0.3, 2.0];
/// Relative standard deviation of a printed diameter, of each marker and common to all: 1 mm of 0.3 m, an assumption.
const PRINT_SIGMA: f64 = 0.003;
const MISSING: &str = "the identified markers do not determine the rotation";

/// Returns the variance of the logarithm of a marker's semi-major axis from its own image and print. `centre_px2`: covariance
/// of its centre.
pub(super) fn size_variance((shape, major_px): (Shape, f64), centre_px2: &Matrix2<f64>) -> f64 {
    let own_px = match shape {
        Shape::Circle => SIZE_SIGMAS_PX.0,
        _ => SIZE_SIGMAS_PX.1,
    };
    (own_px.powi(2) + SIZE_OVER_CENTRE.powi(2) * centre_px2.trace()) / major_px.powi(2)
        + PRINT_SIGMA.powi(2)
}

/// Returns the derivatives of the logarithm of a semi-major axis with respect to print and edges.
pub(super) fn size_derivatives((shape, major_px): (Shape, f64)) -> [f64; 3] {
    let quadrant = f64::from(u8::from(shape == Shape::Quadrant));
    [1.0, 1.0 / major_px, quadrant / major_px]
}

/// Standard deviations of [`size_derivatives`]' unknowns.
pub(super) const SIZE_SIGMAS: [f64; 3] = [PRINT_SIGMA, EDGE_SIGMAS_PX[0], EDGE_SIGMAS_PX[1]];

/// What is uncertain besides rotation, survey and projection centre.
#[derive(Clone, Copy)]
pub(super) enum ImageContext<'a> {
    /// Nothing: the orientation is estimated for a known lens and wing.
    Orientation,
    /// Lens, and bend since the survey.
    Ground,
    /// Lens, scale, wing and mounting, relative to this attitude of the ground frames.
    Flight(&'a Orientation),
}

/// Least squares of images with names.
pub(super) struct ImageProblem<'a> {
    setup: &'a Setup,
    images: Vec<NamedImage>,
    wing: StateWing,
    /// Rotation to which the small one is added.
    camera_from_survey: Rotation3<f64>,
    in_flight: bool,
    scale: f64,
    /// Marker whose manual mark may be displaced.
    pub(super) wrong_mark: Option<usize>,
    problem: Problem,
}

/// Camera at a point of the iteration.
struct PosedLens {
    lens: Lens,
    turn: Vector3<f64>,
    camera_from_wing: Rotation3<f64>,
    /// Projection centre, wing frame, m.
    centre_m: Vector3<f64>,
    pane: Option<Plate>,
}

impl<'a> ImageProblem<'a> {
    /// Creates the problem. `bend_m`: bend of the wing since the survey, at the tip.
    pub(super) fn new(
        setup: &'a Setup,
        images: Vec<NamedImage>,
        camera_from_survey: Rotation3<f64>,
        context: ImageContext,
        bend_m: f64,
    ) -> Self {
        let markers = setup.markers.len();
        let shaping = match context {
            ImageContext::Flight(orientation) => orientation.shaping_markers(markers),
            _ => vec![true; markers],
        };
        let in_flight = matches!(context, ImageContext::Flight(_));
        let mut built = Self {
            setup,
            wing: StateWing::new(setup, &shaping),
            camera_from_survey,
            in_flight,
            scale: setup
                .thermal
                .filter(|_| in_flight)
                .map_or(1.0, |t| t.scale()),
            wrong_mark: None,
            problem: Problem {
                start: DVector::zeros(MARKERS + 3 * markers),
                missing: vec![MISSING; MARKERS + 3 * markers],
                priors: vec![],
                known: None,
                groups: vec![Group {
                    local: DVector::zeros(0),
                    priors: vec![],
                    blocks: images
                        .iter()
                        .map(|image| image_block(image, in_flight))
                        .collect(),
                }],
            },
            images,
        };
        built.problem.priors = built.list_priors(context);
        let bend = built.wing.curvature_per_m(bend_m);
        built.problem.start[WING] = bend;
        let of_bend = built
            .problem
            .priors
            .iter_mut()
            .filter(|prior| prior.columns[0] == WING);
        of_bend.for_each(|prior| prior.mean[0] = bend);
        built
    }

    fn list_priors(&self, context: ImageContext) -> Vec<Prior> {
        let uncertainty = &self.setup.uncertainty;
        let equal = |name, first, count: usize, sigma: f64| {
            Prior::centred(name, first, DMatrix::identity(count, count) * sigma.powi(2))
        };
        let centre_m = self.setup.projection_centre_sigma_m;
        let (mut lens, mut model_m, mut shift_m) = (None, 0.0, 0.0);
        if !matches!(context, ImageContext::Orientation) {
            lens = uncertainty.lens.as_ref();
        }
        let mut wing = DMatrix::identity(WING_TERMS, WING_TERMS) * FIXED.powi(2);
        let (mut scale, mut turn) = (FIXED, vec![]);
        match context {
            ImageContext::Orientation => {}
            ImageContext::Ground => {
                let bend = self.wing.curvature_per_m(uncertainty[Width::GroundBend]);
                wing[(0, 0)] += bend.powi(2);
            }
            ImageContext::Flight(orientation) => {
                let view = WingView::with_wing(self.setup, orientation, true, self.wing.clone());
                let known = StatePrior::new(&view, 0.0, ANY_DEFLECTION).covariance_matrix();
                let part = |first: usize, count: usize| {
                    DMatrix::from_fn(count, count, |i, j| known[(first + i, first + j)])
                };
                (wing, scale) = (
                    part(0, WING_TERMS),
                    uncertainty[Width::FlightScale].max(FIXED),
                );
                (model_m, shift_m) = (MODEL_SIGMA_M, uncertainty[Width::MountShift]);
                turn.push(Prior::centred("rotation", TURN, part(WING_TERMS, 3)));
            }
        }
        let mut interior = lens.map_or_else(
            || DMatrix::zeros(BROWN, BROWN),
            |lens| DMatrix::from_column_slice(BROWN, BROWN, lens.as_slice()),
        );
        (0..BROWN)
            .for_each(|k| interior[(k, k)] = (interior[(k, k)] * (1.0 + FIXED)).max(FIXED.powi(2)));
        let sizes = SIZE_SIGMAS.iter().enumerate();
        let sizes = sizes.map(|(k, sigma)| Prior::scalar("size", PRINT + k, 0.0, *sigma));
        let survey = self.setup.markers.iter().enumerate().map(|(j, marker)| {
            let sigma_m = marker.sigma_m.hypot(model_m).max(MIN_SIGMA_M);
            equal("survey", MARKERS + 3 * j, 3, sigma_m)
        });
        let others = [
            Prior::centred("wing", WING, wing),
            equal(
                "projection centre",
                CENTRE,
                3,
                centre_m.hypot(shift_m).max(MIN_SIGMA_M),
            ),
            Prior::centred("lens", LENS, interior),
            equal("scale", SCALE, 1, scale),
            equal("scale of the survey", POINT_SCALE, 1, FIXED),
            equal("mark", MARK, 2, FIXED),
        ];
        others
            .into_iter()
            .chain(sizes)
            .chain(survey)
            .chain(turn)
            .collect()
    }

    /// Returns the prior variance of an unknown; 0 without a prior.
    pub(super) fn prior_variance(&self, column: usize) -> f64 {
        let of_prior = |prior: &Prior| {
            let k = prior.columns.iter().position(|own| *own == column)?;
            Some(prior.covariance[(k, k)])
        };
        let mut known = self.problem.priors.iter().filter_map(of_prior);
        known.next().unwrap_or(0.0)
    }

    /// Returns the length, m, by which a unit of the first term of the curvature bends the tip.
    pub(super) fn tip_by_curvature(&self) -> f64 {
        1.0 / self.wing.curvature_per_m(1.0)
    }

    /// Returns the problem with more uncertainty of some unknowns: column and standard deviation of each.
    pub(super) fn with_freed(&self, freed: &[(usize, f64)]) -> Problem {
        let mut problem = self.problem.clone();
        for prior in &mut problem.priors {
            for (k, column) in prior.columns.iter().enumerate() {
                let added = freed.iter().find(|(freed, _)| freed == column);
                prior.covariance[(k, k)] += added.map_or(0.0, |(_, sigma)| sigma.powi(2));
            }
        }
        problem
    }

    /// Solves a problem of [`Self::with_freed`]. `rough`: within a hundredth of the standard deviations.
    pub(super) fn solve(&self, problem: &Problem, rough: bool) -> Option<Fit> {
        let options = SolveOptions {
            rough,
            ..SolveOptions::default()
        };
        solve_groups(problem, &options, |at, blocks| self.linearise(at, blocks)).ok()
    }

    /// Returns the rotation from survey to camera at a solution.
    pub(super) fn camera_from_survey(&self, x: &DVector<f64>) -> Rotation3<f64> {
        let mut rotation = Rotation3::new(x.fixed_rows::<3>(TURN)) * self.camera_from_survey;
        rotation.renormalize();
        rotation
    }

    /// Returns the outlines of all markers at a solution; `None` behind the camera.
    pub(super) fn outlines(&self, x: &DVector<f64>) -> Vec<Option<DiscOutline>> {
        let camera = self.pose(x);
        let carried = self.wing.carry(&state_at(x), self.scale);
        let outline = |(marker, at): (usize, &CarriedMarker)| {
            self.disc(x, &camera, marker, at)?.outline(&camera.lens)
        };
        carried.iter().enumerate().map(outline).collect()
    }

    fn pose(&self, x: &DVector<f64>) -> PosedLens {
        let camera_from_survey = self.camera_from_survey(x);
        let wing_from_survey = self.wing.frame.wing_from_survey;
        PosedLens {
            lens: self
                .setup
                .lens
                .with_changes(&x.fixed_rows::<BROWN>(LENS).into_owned())
                .with_flight_change(&Vector2::repeat(x[SCALE].exp()), &Vector2::zeros()),
            turn: x.fixed_rows::<3>(TURN).into_owned(),
            camera_from_wing: camera_from_survey * wing_from_survey.inverse(),
            centre_m: wing_from_survey * x.fixed_rows::<3>(CENTRE),
            pane: Plate::from_window(
                self.setup.window.as_ref(),
                &camera_from_survey,
                self.in_flight,
            ),
        }
    }

    /// Returns the disc of a carried marker with the corrections of its survey, camera frame.
    fn disc(
        &self,
        x: &DVector<f64>,
        camera: &PosedLens,
        marker: usize,
        at: &CarriedMarker,
    ) -> Option<SkinDisc> {
        let surveyed = self.setup.markers.get(marker)?;
        let moved_m =
            surveyed.position_m * x[POINT_SCALE].exp_m1() + x.fixed_rows::<3>(MARKERS + 3 * marker);
        let place_m = at.position_m + at.by_ground * (self.wing.frame.wing_from_survey * moved_m);
        let from_camera_m = camera.camera_from_wing * (place_m - camera.centre_m);
        let seen_m = camera
            .pane
            .map_or(from_camera_m, |pane| pane.apparent_point(&from_camera_m));
        let diameter_m = surveyed.diameter_m * x[PRINT].exp();
        let rotation = &camera.camera_from_wing;
        skin_disc(&self.wing, marker, at, rotation, seen_m, diameter_m)
    }

    fn linearise(&self, at: &GroupPoint, blocks: &mut Vec<Linearised>) -> EstimationResult<()> {
        let (x, camera) = (at.global, self.pose(at.global));
        let states = self.wing.carry_with_derivatives(&state_at(x), self.scale);
        blocks.clear();
        for (image, observed) in self.images.iter().zip(at.observed) {
            let behind = || EstimationError::Input("a marker is behind the camera".into());
            let state = states.get(image.marker).ok_or_else(behind)?;
            let disc = self.disc(x, &camera, image.marker, &state.carried);
            let disc = disc.ok_or_else(behind)?;
            let seen = disc.centre_m;
            let (pixel, by_seen) = camera
                .lens
                .project_with_jacobian(&seen)
                .ok_or_else(behind)?;
            let first = MARKERS + 3 * image.marker;
            let (n, columns) = (observed.len(), (0..MARKERS).chain(first..first + 3));
            let mut out = Linearised::empty(n, columns.collect(), 0, n);
            // Rows: pixel and logarithm of the size, which decreases with the distance.
            let mut by_camera = Matrix3::zeros();
            by_camera.fixed_rows_mut::<2>(0).copy_from(&by_seen);
            by_camera
                .row_mut(2)
                .copy_from(&(-seen / seen.norm_squared()).transpose());
            let by_wing = by_camera * camera.camera_from_wing;
            let wing_from_survey = self.wing.frame.wing_from_survey.matrix();
            let by_survey = by_wing * state.carried.by_ground * wing_from_survey;
            let mut put = |column: usize, by: Vector3<f64>| {
                out.global.column_mut(column).copy_from(&by.rows(0, n));
            };
            let mut by_turn = -by_camera * cross_matrix(&seen) * left_jacobian(&camera.turn);
            by_turn.row_mut(2).fill(0.0);
            let by_centre = -by_wing * wing_from_survey;
            for k in 0..3 {
                put(TURN + k, by_turn.column(k).into_owned());
                put(CENTRE + k, by_centre.column(k).into_owned());
                put(MARKERS + k, by_survey.column(k).into_owned());
            }
            let motions = state.by_bending[..CURVATURE_TERMS]
                .iter()
                .chain(&state.by_twist);
            for (k, motion) in motions.take(WING_TERMS).enumerate() {
                put(WING + k, by_wing * motion);
            }
            let mut by_lens = camera.lens.parameter_jacobian(&seen);
            (0..2).for_each(|k| by_lens[(k, k)] *= x[SCALE].exp());
            for (k, by) in by_lens.column_iter().enumerate() {
                put(LENS + k, Vector3::new(by[0], by[1], 0.0));
            }
            let off_px = pixel - Vector2::new(camera.lens.cx, camera.lens.cy);
            put(SCALE, Vector3::new(off_px.x, off_px.y, 1.0));
            let surveyed_m = self.setup.markers[image.marker].position_m;
            put(POINT_SCALE, by_survey * surveyed_m * x[POINT_SCALE].exp());
            let mut predicted = vec![pixel.x, pixel.y];
            if image.outline.is_none() && self.wrong_mark == Some(image.marker) {
                for k in 0..2 {
                    put(MARK + k, -Vector3::ith(k, 1.0));
                    predicted[k] -= x[MARK + k];
                }
            }
            if let Some(size) = image.size() {
                let outline = disc.outline(&camera.lens).ok_or_else(behind)?;
                predicted.push(outline.semi_major_px.ln());
                for (k, by) in size_derivatives(size).into_iter().enumerate() {
                    put(PRINT + k, Vector3::z() * by);
                    // The outline has the size by print.
                    predicted[2] += if k > 0 { by * x[PRINT + k] } else { 0.0 };
                }
            }
            out.misclosure
                .copy_from(&(DVector::from_vec(predicted) - observed));
            out.observations.fill_diagonal(-1.0);
            blocks.push(out);
        }
        Ok(())
    }
}

/// Returns the state of the wing at a point of the iteration.
fn state_at(x: &DVector<f64>) -> WingState {
    WingState::from_fn(|k, _| if k < WING_TERMS { x[WING + k] } else { 0.0 })
}

/// Returns pixel and, if it was measured, logarithm of the size of an image.
fn image_block(image: &NamedImage, in_flight: bool) -> Block {
    let floor_px = if in_flight { PIXEL_FLOOR_PX } else { 0.0 };
    let size = image.size();
    let n = 2 + usize::from(size.is_some());
    let mut covariance = DMatrix::zeros(n, n);
    let own = image.covariance_px2 + Matrix2::identity() * floor_px.powi(2);
    covariance.view_mut((0, 0), (2, 2)).copy_from(&own);
    let mut observed = vec![image.pixel.x, image.pixel.y];
    if let Some(size) = size {
        covariance[(2, 2)] = size_variance(size, &image.covariance_px2);
        observed.push(size.1.ln());
    }
    Block {
        observed: observed.into(),
        covariance,
    }
}
