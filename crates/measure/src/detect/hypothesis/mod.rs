//! Hypotheses: possible markers with their priors, before they are measured.

pub mod neighbours;
pub mod options;
pub mod prior;

use nalgebra::Vector2;

use crate::detect::appearance::parameters::MarkerPattern;
use crate::detect::hypothesis::prior::MarkerPrior;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::occlusion::decal::Decal;
use crate::detect::occlusion::region::{OcclusionBand, Region};
use crate::raster::Raster;

/// Possible marker, from which a measurement starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis {
    pub pattern: MarkerPattern,
    /// Outline of the marker.
    pub ellipse: Ellipse,
    /// Edges of quadrants.
    pub edges: Option<EdgePair>,
    /// Indices of the blobs that form it.
    pub blobs: Vec<usize>,
    /// Regions of the image that may show something else.
    pub excluded: Vec<Region>,
    /// Size and edges that are known a priori.
    pub prior: MarkerPrior,
}

/// Two crossing edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePair {
    /// Direction of s, which bisects the angle between them.
    pub along_rad: f64,
    /// Tangent of half that angle.
    pub tangent: f64,
}

impl Hypothesis {
    /// Creates a hypothesis with an outline and no prior.
    pub fn new(pattern: MarkerPattern, ellipse: Ellipse, blobs: Vec<usize>) -> Self {
        Self {
            pattern,
            ellipse,
            edges: None,
            blobs,
            excluded: Vec::new(),
            prior: MarkerPrior::default(),
        }
    }

    /// Returns whether a point of the image, px, may show something else than the marker.
    pub fn excludes(&self, at: &Vector2<f64>) -> bool {
        self.excluded.iter().any(|region| region.contains(at))
    }

    /// Returns whether no part of the marker is assumed to be hidden.
    pub fn is_whole(&self) -> bool {
        !self.is_under_decal() && !self.is_in_glare()
    }

    /// Returns whether dark paint touches an end of the marker.
    pub fn is_painted(&self) -> bool {
        self.excluded
            .iter()
            .any(|region| matches!(region, Region::Paint(_)))
    }

    /// Returns the decals that may lie over the marker.
    pub fn decals(&self) -> impl Iterator<Item = &Decal> {
        self.excluded.iter().filter_map(Region::decal)
    }

    /// Returns whether a decal may lie over the marker.
    pub fn is_under_decal(&self) -> bool {
        self.decals().next().is_some()
    }

    /// Returns the bands in which glare hides the marker.
    pub fn glare(&self) -> impl Iterator<Item = &OcclusionBand> {
        self.excluded.iter().filter_map(Region::glare)
    }

    /// Returns whether glare hides a part of the marker.
    pub fn is_in_glare(&self) -> bool {
        self.glare().next().is_some()
    }

    /// Replaces the bands of glare.
    pub fn with_glare(mut self, bands: Vec<OcclusionBand>) -> Self {
        self.excluded.retain(|region| region.glare().is_none());
        self.excluded.extend(bands.into_iter().map(Region::Glare));
        self
    }

    /// Replaces the decals.
    pub fn with_decals(mut self, decals: Vec<Decal>) -> Self {
        self.excluded.retain(|region| region.decal().is_none());
        self.excluded.extend(decals.into_iter().map(Region::Decal));
        self
    }

    /// Returns the product of the semi-axes, px^2.
    pub fn size(&self) -> f64 {
        self.ellipse.major * self.ellipse.minor
    }

    /// Returns the difference between the darker white quadrant and the lighter black one, each averaged along its middle,
    /// grey levels; 0 for discs.
    pub fn white_over_black(&self, image: &Raster) -> f64 {
        /// Sampled positions from the centre (0) to the outline (1), both of which are blurred.
        const POSITIONS: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];
        let Some(edges) = self.edges else { return 0.0 };
        let (sin, cos) = edges.along_rad.sin_cos();
        let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let mean = |direction: Vector2<f64>| {
            let outline = direction * self.ellipse.radius_along(direction);
            let greys = POSITIONS
                .map(|position| self.ellipse.centre + outline * position)
                .map(|at| image.nearest_value(at.x, at.y));
            greys.iter().map(|&grey| f64::from(grey)).sum::<f64>() / POSITIONS.len() as f64
        };
        let (along, across) = ([mean(along), mean(-along)], [mean(across), mean(-across)]);
        let (black, white) = if self.pattern == MarkerPattern::BlackAlong {
            (along, across)
        } else {
            (across, along)
        };
        white[0].min(white[1]) - black[0].max(black[1])
    }
}
