//! What may be a marker, with what is known of it before it is measured.

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

/// What an attempt starts from.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis {
    /// Disc or quadrants.
    pub pattern: MarkerPattern,
    /// The marker's outline.
    pub ellipse: Ellipse,
    /// Quadrants: their edges.
    pub edges: Option<EdgePair>,
    /// Blobs that it is made of.
    pub blobs: Vec<usize>,
    /// Regions of the picture that may show something else.
    pub excluded: Vec<Region>,
    /// What is known of it beforehand.
    pub prior: MarkerPrior,
}

/// Two edges that cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePair {
    /// Direction of s, which halves the angle between them, rad.
    pub along_rad: f64,
    /// Tangent of half that angle.
    pub tangent: f64,
}

impl Hypothesis {
    /// With this outline, of which nothing more is known.
    pub fn of(pattern: MarkerPattern, ellipse: Ellipse, blobs: Vec<usize>) -> Self {
        Self { pattern, ellipse, edges: None, blobs, excluded: Vec::new(), prior: MarkerPrior::default() }
    }

    /// Whether a point of the picture may show something else than the marker.
    pub fn hides(&self, at: &Vector2<f64>) -> bool {
        self.excluded.iter().any(|region| region.contains(at))
    }

    /// Whether no part of the marker is thought to be hidden.
    pub fn is_whole(&self) -> bool {
        !self.is_under_decal() && !self.is_in_glare()
    }

    /// Whether dark paint touches an end of it.
    pub fn is_painted(&self) -> bool {
        self.excluded.iter().any(|region| matches!(region, Region::Paint(_)))
    }

    /// The decals that may lie over it.
    pub fn decals(&self) -> impl Iterator<Item = &Decal> {
        self.excluded.iter().filter_map(Region::decal)
    }

    /// Whether there are some.
    pub fn is_under_decal(&self) -> bool {
        self.decals().next().is_some()
    }

    /// The bands in which glare hides it.
    pub fn glare(&self) -> impl Iterator<Item = &OcclusionBand> {
        self.excluded.iter().filter_map(Region::glare)
    }

    /// Whether there are some.
    pub fn is_in_glare(&self) -> bool {
        self.glare().next().is_some()
    }

    /// With these bands of glare instead of those that it has.
    pub fn with_glare(mut self, bands: Vec<OcclusionBand>) -> Self {
        self.excluded.retain(|region| region.glare().is_none());
        self.excluded.extend(bands.into_iter().map(Region::Glare));
        self
    }

    /// With these decals.
    pub fn with_decals(mut self, decals: Vec<Decal>) -> Self {
        self.excluded.retain(|region| region.decal().is_none());
        self.excluded.extend(decals.into_iter().map(Region::Decal));
        self
    }

    /// Product of the semi-axes, px^2.
    pub fn size(&self) -> f64 {
        self.ellipse.major * self.ellipse.minor
    }

    /// By how much the darker of its white quadrants is lighter than the lighter of its black ones, each in a mean along its
    /// middle, grey levels; 0 for discs.
    pub fn white_over_black(&self, image: &Raster) -> f64 {
        /// Where, from the centre (0) to the outline (1): both are blurred.
        const AT: [f64; 5] = [0.3, 0.4, 0.5, 0.6, 0.7];
        let Some(edges) = self.edges else { return 0.0 };
        let (sin, cos) = edges.along_rad.sin_cos();
        let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let mean = |direction: Vector2<f64>| {
            let outline = direction * self.ellipse.radius(direction);
            let greys =
                AT.map(|share| self.ellipse.centre + outline * share).map(|at| image.nearest(at.x, at.y));
            greys.iter().map(|&grey| f64::from(grey)).sum::<f64>() / AT.len() as f64
        };
        let (along, across) = ([mean(along), mean(-along)], [mean(across), mean(-across)]);
        let (black, white) =
            if self.pattern == MarkerPattern::BlackAlong { (along, across) } else { (across, along) };
        white[0].min(white[1]) - black[0].max(black[1])
    }
}
