//! Points of a frame: matched to their templates after the decals, or without any decal from the camera outwards.

use super::{FrameMarkers, Picture, StepEnd, ViewFault, Work};
use crate::detect::{Detection, MarkerPrediction};
use crate::identify::{IdentifyError, Identities, PatchNodes, PatchPrediction, WingView};
use crate::points::{PointMatch, PointRejection, find_places, match_point};
use crate::raster::Raster;
use crate::setup::{PointTemplate, Shape};

/// Number of standard deviations of a prediction within which a point is searched for: 1 in 15,000 is outside.
const SEARCH_SIGMAS: f64 = 4.0;
/// Share of the points that ends the search for the wing's deflection if they are found.
const LOCATED_SHARE: f64 = 0.5;
/// Number of passes: points found in the first narrow the search for the others.
const PASSES: usize = 2;

/// Reason why a point without a template is missing.
const WITHOUT_TEMPLATE: &str =
    "the ground frames have no template of it: mark it there, and run `wingd orient` again";

/// Search for the points of a frame.
struct PointFinder<'a, P> {
    wing: &'a WingView<'a>,
    picture: &'a mut P,
    nodes: PatchNodes,
}

/// Finds the points of a frame in addition to the markers `found`. A frame whose decals could not be identified, or that has
/// none, is identified by its points.
pub(super) fn add_points(
    wing: &WingView,
    picture: &mut impl Picture,
    mut found: FrameMarkers,
    ended: StepEnd,
) -> FrameMarkers {
    let has_points = wing.setup.markers.iter().any(|m| m.shape == Shape::Point);
    if !has_points
        || found
            .fault
            .as_ref()
            .is_some_and(|fault| !fault.is_unnamed())
    {
        return found;
    }
    let mut finder = PointFinder {
        wing,
        picture,
        nodes: wing.patch_nodes(),
    };
    if found.identities.is_none() && !wing.orientation.templates.is_empty() {
        match finder.locate(&found) {
            Ok(located) => found = located,
            Err(Some(error)) if found.detections.markers.is_empty() => {
                found.fault = Some(ViewFault::Unidentified(error));
            }
            Err(_) => {}
        }
    }
    if let Some(mut identities) = found.identities.take() {
        let has_template = |marker: usize| {
            wing.orientation
                .templates
                .iter()
                .any(|t| t.marker == marker)
        };
        for (marker, reason) in &mut identities.missing {
            if wing.setup.is_point(*marker) && !has_template(*marker) {
                WITHOUT_TEMPLATE.clone_into(reason);
            }
        }
        let (markers, identities) = finder.match_points(found.detections.markers, identities);
        found.observations = identities.observations(&markers);
        found.detections.markers = markers;
        found.identities = Some(identities);
    }
    ended(Work::Identify);
    found
}

impl<P: Picture> PointFinder<'_, P> {
    /// Identifies a frame by its points and the detections, which have no names yet: the deflection that names most, until
    /// one names half of the points.
    fn locate(&mut self, found: &FrameMarkers) -> Result<FrameMarkers, Option<IdentifyError>> {
        let points = self
            .wing
            .orientation
            .templates
            .chunk_by(|a, b| a.marker == b.marker)
            .count();
        let enough = LOCATED_SHARE * points as f64;
        let mut best = Err(None);
        let mut most = 0;
        for deflection in WingView::patch_deflections() {
            match self.locate_at(deflection, found) {
                Ok(located) => {
                    let named = located
                        .identities
                        .as_ref()
                        .map_or(0, Identities::count_named);
                    if named > most {
                        (best, most) = (Ok(located), named);
                    }
                }
                Err(error) if best.is_err() => best = Err(error),
                Err(_) => {}
            }
            if most as f64 >= enough {
                break;
            }
        }
        best
    }

    /// Identifies a frame by its points if the tip is deflected by about `deflection` spans.
    fn locate_at(
        &mut self,
        deflection: f64,
        found: &FrameMarkers,
    ) -> Result<FrameMarkers, Option<IdentifyError>> {
        let templates = &self.wing.orientation.templates;
        let places = |targets: &[Vec<PatchPrediction>]| {
            let raster = decode_patches(self.picture, targets.iter().flatten());
            let of_patch = |patch: &PatchPrediction| {
                let template = templates.get(patch.template);
                let places =
                    template.map_or(vec![], |template| find_places(raster, template, patch));
                let one = |(place_px, covariance_px2)| {
                    let found = PointMatch {
                        place_px,
                        covariance_px2,
                        explained: 0.0,
                    };
                    build_detection(patch, &found)
                };
                places.into_iter().map(one).collect::<Vec<_>>()
            };
            targets.iter().flatten().flat_map(of_patch).collect()
        };
        let decals = found.detections.markers.clone();
        let patches = self
            .wing
            .locate_points(&self.nodes, deflection, decals, places)
            .ok_or(None)?;
        let raster = decode_patches(self.picture, patches.iter());
        let (matched, _) = match_best(raster, templates, &patches);
        let mut markers = found.detections.markers.clone();
        markers.extend(matched);
        let identities = self.wing.identify_markers(&markers)?;
        let mut located = FrameMarkers {
            fault: None,
            first_identities: Some(identities.clone()),
            ..found.clone()
        };
        (located.detections.markers, located.identities) =
            remove_rejected_points(markers, identities);
        Ok(located)
    }

    /// Matches the points of an identified frame and adds them to its markers.
    fn match_points(
        &mut self,
        mut markers: Vec<Detection>,
        mut identities: Identities,
    ) -> (Vec<Detection>, Identities) {
        for _ in 0..PASSES {
            let is_named =
                |template: &PointTemplate| identities.marker_of.contains(&Some(template.marker));
            if self.wing.orientation.templates.iter().all(is_named) {
                break;
            }
            let patches =
                self.wing
                    .predict_patches(&self.nodes, &markers, &identities, SEARCH_SIGMAS);
            let is_open =
                |patch: &PatchPrediction| !identities.marker_of.contains(&Some(patch.marker));
            let open: Vec<PatchPrediction> = patches
                .unwrap_or_default()
                .into_iter()
                .filter(is_open)
                .collect();
            let raster = decode_patches(self.picture, open.iter());
            let (matched, rejected) = match_best(raster, &self.wing.orientation.templates, &open);
            for (marker, rejection) in rejected {
                let reason = rejection.text().to_owned();
                identities.missing.retain(|(other, _)| *other != marker);
                identities.missing.push((marker, reason));
            }
            if matched.is_empty() {
                break;
            }
            for point in matched {
                identities
                    .missing
                    .retain(|(other, _)| Some(*other) != point.marker);
                identities.marker_of.push(point.marker);
                markers.push(point);
            }
            while let Some(displaced) = self.wing.find_displaced_point(&markers, &identities) {
                markers.remove(displaced);
                let marker = identities.marker_of.remove(displaced);
                let reason = PointRejection::Displaced.text().to_owned();
                identities
                    .missing
                    .extend(marker.map(|marker| (marker, reason)));
            }
        }
        (markers, identities)
    }
}

/// Removes points that identification rejected.
fn remove_rejected_points(
    markers: Vec<Detection>,
    mut identities: Identities,
) -> (Vec<Detection>, Option<Identities>) {
    let named = markers.into_iter().zip(identities.marker_of.drain(..));
    let (markers, names) = named
        .filter(|(m, name)| m.marker.is_none() || name.is_some())
        .unzip();
    identities.marker_of = names;
    (markers, Some(identities))
}

/// Decodes the areas of patches.
fn decode_patches<'a>(
    picture: &'a mut impl Picture,
    patches: impl Iterator<Item = &'a PatchPrediction>,
) -> &'a Raster {
    let areas: Vec<MarkerPrediction> = patches.map(PatchPrediction::search_area).collect();
    picture.decode_around(&areas)
}

/// Matches patches; of several templates of a point the one that explains most is used. Returns the points found, and the
/// others with the reason.
fn match_best(
    raster: &Raster,
    templates: &[PointTemplate],
    patches: &[PatchPrediction],
) -> (Vec<Detection>, Vec<(usize, PointRejection)>) {
    let (mut found, mut rejected) = (Vec::new(), Vec::new());
    for own in patches.chunk_by(|a, b| a.marker == b.marker) {
        let mut best: Option<(&PatchPrediction, PointMatch)> = None;
        let mut reason = PointRejection::Grazing;
        for patch in own {
            let Some(template) = templates.get(patch.template) else {
                continue;
            };
            match match_point(raster, template, patch) {
                Ok(next)
                    if best
                        .as_ref()
                        .is_none_or(|(_, known)| known.explained < next.explained) =>
                {
                    best = Some((patch, next));
                }
                Ok(_) => {}
                Err(other) => reason = other,
            }
        }
        match best {
            Some((patch, place)) => found.push(build_detection(patch, &place)),
            None => rejected.extend(own.first().map(|patch| (patch.marker, reason))),
        }
    }
    (found, rejected)
}

/// Builds the detection of a point; its outline only stands for the neighbourhood.
fn build_detection(patch: &PatchPrediction, place: &PointMatch) -> Detection {
    let area = patch.search_area();
    Detection {
        shape: Shape::Point,
        centre_px: place.place_px,
        covariance_px2: place.covariance_px2.into(),
        semi_major_px: area.semi_major_px,
        semi_minor_px: area.semi_minor_px,
        angle_rad: 0.0,
        fit_rms: 0.0,
        contrast: 0.0,
        marker: Some(patch.marker),
    }
}
