//! Patches around points, from the ground frame into a frame of the bent wing.
//!
//! A patch is mapped by nine nodes of the skin, which the beam carries into flight: the map from ground frame to frame is a
//! quadratic polynomial, because a patch seen at grazing incidence is a metre long.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2, Vector3};

use super::Identities;
use super::beam::{CoarseBeam, WingState, facing_attitude};
use super::fit::{MatchedPair, squared_distance};
use super::scene::{Matrix8, PredictedImage, WingView};
use crate::detect::{Detection, MarkerPrediction};
use crate::setup::Shape;

/// Half side of the patch that is matched, px of the ground frame: some 14 cm at 35 m, which holds a structure and leaves
/// 900 pixels to average noise.
pub const PATCH_REACH_PX: usize = 15;
/// Standard deviation of the skin's slope about either axis, rad, as for discs: deviation of the smooth skin and of the
/// fitted bending and twist.
const SLOPE_SIGMA_RAD: f64 = 0.015;
/// Smallest ratio of a patch's area in the frame to that in the ground frame: it is seen too flat beyond.
const MIN_AREA_RATIO: f64 = 0.05;
/// Largest distance of a node from the point, m: a longer patch is seen edge-on in the ground frame.
const MAX_NODE_M: f64 = 3.0;
/// Largest test value of a point's residual: chi-square of two degrees of freedom, 0.1 %; the noise of the predictions is
/// generous.
const RESIDUAL_GATE: f64 = 13.8;
/// Smallest search radius, px: the reach of the adjustment.
const MIN_SEARCH_PX: f64 = 3.0;
/// Number of nodes of a patch.
const NODES: usize = 9;
/// Terms of the map: x, y, x^2, xy, y^2.
const TERMS: usize = 5;

type NodePixels = SMatrix<f64, 2, NODES>;
type PatchMap = SMatrix<f64, 2, TERMS>;

/// Predicted image of a template's patch.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchPrediction {
    /// Index of the point in the survey.
    pub marker: usize,
    /// Index of the template in [`Orientation::templates`](crate::setup::Orientation::templates).
    pub template: usize,
    /// Image of the point, px.
    pub centre_px: Vector2<f64>,
    /// Covariance of the image, px^2.
    pub covariance_px2: Matrix2<f64>,
    /// Largest deviation of the image to both sides along u and v, px.
    pub search_px: Vector2<f64>,
    /// Changes of [`Self::map_jacobian`] by one standard deviation of the skin's slope along the span and across it.
    pub by_slope: [Matrix2<f64>; 2],
    map: PatchMap,
}

fn map_terms(offset: &Vector2<f64>) -> SVector<f64, TERMS> {
    let (x, y) = (offset.x, offset.y);
    SVector::from([x, y, x * x, x * y, y * y])
}

impl PatchPrediction {
    /// Returns the image of the skin that the ground frame shows at an offset from the point, px.
    pub fn frame_point(&self, offset_px: &Vector2<f64>) -> Vector2<f64> {
        self.centre_px + self.map * map_terms(offset_px)
    }

    /// Returns the coefficients of [`Self::frame_point`] as polynomials of the offset along u, for an offset along v, px.
    pub fn row_path(&self, v_px: f64) -> [[f64; 3]; 2] {
        let [by_u, by_v, uu, uv, vv] = [0, 1, 2, 3, 4].map(|k| self.map.column(k));
        let constant = self.centre_px + (by_v + vv * v_px) * v_px;
        let linear = by_u + uv * v_px;
        [0, 1].map(|k| [constant[k], linear[k], uu[k]])
    }

    /// Returns the derivative of [`Self::frame_point`] at an offset.
    pub fn map_jacobian(&self, offset_px: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (offset_px.x, offset_px.y);
        let by_x = self.map * SVector::from([1.0, 0.0, 2.0 * x, y, 0.0]);
        let by_y = self.map * SVector::from([0.0, 1.0, 0.0, x, 2.0 * y]);
        Matrix2::from_columns(&[by_x, by_y])
    }

    /// Returns the area of the frame that a search for the patch reads, as the prediction of an outline.
    pub fn search_area(&self) -> MarkerPrediction {
        let sides = self.map_jacobian(&Vector2::zeros()).map(f64::abs)
            * Vector2::repeat(PATCH_REACH_PX as f64 + 4.0);
        MarkerPrediction {
            shape: Shape::Circle,
            centre_px: self.centre_px,
            semi_major_px: sides.amax().max(1.0),
            semi_minor_px: sides.amax().max(1.0),
            angle_rad: 0.0,
            search_px: self.search_px,
            seen: true,
        }
    }
}

/// Nodes of the patches of all templates.
pub struct PatchNodes {
    /// Beam that carries the nodes, [`NODES`] per patch, for each slope.
    beam: CoarseBeam,
    /// Template, marker and the inverse of the map's design matrix for the nominal slope and its two changes.
    patches: Vec<(usize, usize, [SMatrix<f64, NODES, TERMS>; 3])>,
}

impl<'a> WingView<'a> {
    /// Returns the nodes of the patches; of a template that is seen edge-on in the ground frame there are none.
    pub fn patch_nodes(&self) -> PatchNodes {
        let ground = WingView::with_beam(self.setup, self.orientation, false, self.beam.clone());
        let mut nodes = PatchNodes {
            beam: self.beam.clone(),
            patches: Vec::new(),
        };
        let mut points = Vec::new();
        for (k, template) in self.orientation.templates.iter().enumerate() {
            if let Some((own, inverses)) = ground.nodes_of_patch(template.marker) {
                points.extend(own);
                nodes.patches.push((k, template.marker, inverses));
            }
        }
        nodes.beam = self.beam.with_points(&points);
        nodes
    }

    /// Returns the nodes of a point's patch on the skin as surveyed, wing frame, m, and the inverses of the design matrices
    /// of their offsets in the ground frame.
    #[allow(clippy::type_complexity)]
    fn nodes_of_patch(
        &self,
        marker: usize,
    ) -> Option<(Vec<(Vector3<f64>, bool)>, [SMatrix<f64, NODES, TERMS>; 3])> {
        let fixed = self.setup.markers.get(marker)?.fixed;
        let point = *self.beam.ground_m.get(marker)?;
        let facing = facing_attitude(&point).filter(|_| fixed);
        let slopes = [
            Vector2::zeros(),
            Vector2::x() * SLOPE_SIGMA_RAD,
            Vector2::y() * SLOPE_SIGMA_RAD,
        ];
        let place = |at: &Vector2<f64>, slope: &Vector2<f64>| match &facing {
            Some((normal, across)) => {
                point + across * at.x + normal.cross(across) * at.y + normal * slope.dot(at)
            }
            None => {
                let skin = &self.beam.skin;
                let rise =
                    skin.height(point.x + at.x, point.z + at.y) - skin.height(point.x, point.z);
                point + Vector3::new(at.x, rise + slope.dot(at), at.y)
            }
        };
        let project = |points: &[Vector3<f64>]| -> Option<Vec<Vector2<f64>>> {
            points.iter().map(|p| self.project_on_ground(p)).collect()
        };
        /// Step of the differences for the size of a pixel on the skin, m.
        const STEP_M: f64 = 0.01;
        let steps = [
            Vector2::zeros(),
            Vector2::x() * STEP_M,
            Vector2::y() * STEP_M,
        ]
        .map(|at| place(&at, &slopes[0]));
        let images = project(&steps)?;
        let skin_from_px = Matrix2::from_columns(&[images[1] - images[0], images[2] - images[0]])
            .try_inverse()?
            * STEP_M;
        let reach = PATCH_REACH_PX as f64;
        let offsets: [Vector2<f64>; NODES] = std::array::from_fn(|i| {
            skin_from_px * Vector2::new((i % 3) as f64 - 1.0, (i / 3) as f64 - 1.0) * reach
        });
        if !offsets.iter().all(|at| at.norm() < MAX_NODE_M) {
            return None;
        }
        let mut points = Vec::with_capacity(3 * NODES);
        let mut inverses = [SMatrix::zeros(); 3];
        for (slope, inverse) in slopes.iter().zip(&mut inverses) {
            let own = offsets.map(|at| place(&at, slope));
            let pixels = project(&own)?;
            let mut design = SMatrix::<f64, TERMS, NODES>::zeros();
            for (i, pixel) in pixels.iter().enumerate() {
                design.set_column(i, &map_terms(&(pixel - images[0])));
            }
            *inverse = design.transpose() * (design * design.transpose()).try_inverse()?;
            points.extend(own.map(|p| (p, fixed)));
        }
        Some((points, inverses))
    }

    /// Predicts the patches of the templates, grouped by marker, for a state with a covariance; the search area is `sigmas`
    /// standard deviations to each side.
    pub(super) fn predict_patches_by_marker(
        &self,
        nodes: &PatchNodes,
        state: &WingState,
        covariance: &Matrix8,
        sigmas: f64,
    ) -> Vec<Option<Vec<PatchPrediction>>> {
        let images = self.linearise(state);
        let pixels = self.project_points(&nodes.beam, state);
        let mut all: Vec<Option<Vec<PatchPrediction>>> = vec![None; images.len()];
        for ((template, marker, inverses), own) in
            nodes.patches.iter().zip(pixels.chunks_exact(3 * NODES))
        {
            let Some(Some(image)) = images.get(*marker) else {
                continue;
            };
            let key = (*template, *marker);
            let spread = image.spread_px2(covariance);
            if let Some(mut patch) = predict_patch(key, image, inverses, own, spread) {
                patch.search_px = image.sigma_px(covariance) * sigmas;
                patch.search_px.add_scalar_mut(MIN_SEARCH_PX);
                all[*marker].get_or_insert_default().push(patch);
            }
        }
        all
    }

    /// Predicts the patches of all templates in another frame of the wing as surveyed, within `sigmas` standard deviations of
    /// the survey.
    pub fn predict_patches_on_ground(&self, sigmas: f64) -> Vec<PatchPrediction> {
        let nodes = self.patch_nodes();
        let by_marker =
            self.predict_patches_by_marker(&nodes, &WingState::zeros(), &Matrix8::zeros(), sigmas);
        by_marker.into_iter().flatten().flatten().collect()
    }

    /// Predicts the patches of all templates from identified detections, within `sigmas` standard deviations; `None` if the
    /// detections do not determine the wing's state.
    pub fn predict_patches(
        &self,
        nodes: &PatchNodes,
        detections: &[Detection],
        identities: &Identities,
        sigmas: f64,
    ) -> Option<Vec<PatchPrediction>> {
        let fitted = self.fit_state(detections, identities)?;
        let by_marker =
            self.predict_patches_by_marker(nodes, &fitted.state, &fitted.covariance, sigmas);
        Some(by_marker.into_iter().flatten().flatten().collect())
    }
}

impl WingView<'_> {
    /// Returns the index of the detection of a point that contradicts the other markers most; `None` if all agree.
    pub fn find_displaced_point(
        &self,
        detections: &[Detection],
        identities: &Identities,
    ) -> Option<usize> {
        let fitted = self.fit_state(detections, identities)?;
        let is_point =
            |(i, _): &MatchedPair| detections.get(*i).is_some_and(|d| d.shape == Shape::Point);
        let points = identities.pairs().into_iter().filter(is_point);
        let off = |pair| {
            (
                squared_distance(pair, &fitted.images, detections, &fitted.covariance, true),
                pair.0,
            )
        };
        let worst = points
            .map(off)
            .filter(|(off, _)| *off > RESIDUAL_GATE)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        worst.map(|(_, detection)| detection)
    }
}

/// Fits the map of one patch to its nodes; `None` if it is out of the frame or seen too flat.
fn predict_patch(
    (template, marker): (usize, usize),
    image: &PredictedImage,
    inverses: &[SMatrix<f64, NODES, TERMS>; 3],
    pixels: &[Option<Vector2<f64>>],
    covariance_px2: Matrix2<f64>,
) -> Option<PatchPrediction> {
    let mut maps = [PatchMap::zeros(); 3];
    for ((map, own), inverse) in maps
        .iter_mut()
        .zip(pixels.chunks_exact(NODES))
        .zip(inverses)
    {
        let centre = own[NODES / 2]?;
        let mut moved = NodePixels::zeros();
        for (i, pixel) in own.iter().enumerate() {
            moved.set_column(i, &((*pixel)? - centre));
        }
        *map = moved * inverse;
    }
    let linear = |map: &PatchMap| map.fixed_columns::<2>(0).into_owned();
    let by_slope = [1, 2].map(|k| linear(&maps[k]) - linear(&maps[0]));
    let is_seen = linear(&maps[0]).determinant() > MIN_AREA_RATIO;
    is_seen.then(|| PatchPrediction {
        marker,
        template,
        centre_px: image.pixel,
        covariance_px2,
        search_px: Vector2::zeros(),
        by_slope,
        map: maps[0],
    })
}
