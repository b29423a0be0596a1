//! What may be a marker, and what is known of it before it is measured.

use nalgebra::Vector2;

use super::prior::{Foretold, Like};
use crate::measure::detect::appearance::parameters::Pattern;
use crate::measure::detect::detection::{RejectReason, Rejected};
use crate::measure::detect::image::ellipse::Outline;
use crate::measure::detect::occlusion::decal::Sheet;
use crate::measure::detect::occlusion::region::Band;
use crate::measure::raster::Raster;

/// What stage 4 starts from.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Disc or quadrants.
    pub pattern: Pattern,
    /// The marker's outline.
    pub outline: Outline,
    /// The blur, px, where that is of quadrants' black and white together.
    pub against_skin: Option<f64>,
    /// Quadrants: direction of s, and tangent of half the angle between the edges.
    pub edges: Option<(f64, f64)>,
    /// Blobs that it is made of.
    pub blobs: Vec<usize>,
    /// Sheets that may lie over it.
    pub hidden: Vec<Sheet>,
    /// Bands in which glare hides the marker.
    pub bands: Vec<Band>,
    /// Bands in which a seam of the skin meets the marker.
    pub seams: Vec<Band>,
    /// Whether size, direction and thickness are those of a disc beside it.
    pub alike: bool,
    /// How well the outline's size is known, where that is foretold.
    pub foretold: Option<Foretold>,
    /// What the frame's other markers tell of its edges, where it is too thin to tell them itself.
    pub like: Option<Like>,
}

impl Candidate {
    /// With this outline, of which nothing more is known.
    pub fn of(pattern: Pattern, outline: Outline, blobs: Vec<usize>) -> Self {
        Self {
            pattern,
            outline,
            against_skin: None,
            edges: None,
            blobs,
            hidden: Vec::new(),
            bands: Vec::new(),
            seams: Vec::new(),
            alike: false,
            foretold: None,
            like: None,
        }
    }

    /// Whether a point of the picture may show something else than the marker.
    pub fn hides(&self, at: &Vector2<f64>) -> bool {
        self.hidden.iter().any(|sheet| sheet.holds(at))
            || self.bands.iter().chain(&self.seams).any(|b| b.holds(at))
    }

    /// Whether no part of the marker is thought to be hidden.
    pub fn is_whole(&self) -> bool {
        self.hidden.is_empty() && self.bands.is_empty()
    }

    /// Whether all of its size is foretold.
    pub fn is_foretold(&self) -> bool {
        self.foretold.is_some_and(|foretold| foretold.slope.is_some())
    }

    /// Product of the semi-axes, px^2.
    pub fn size(&self) -> f64 {
        self.outline.major * self.outline.minor
    }

    /// By how much the darker of its white quadrants is lighter than the lighter of its black ones, half way out in the middle
    /// of each, grey levels; 0 for discs.
    pub fn white_over_black(&self, image: &Raster) -> i32 {
        let Some((direction, _)) = self.edges else { return 0 };
        let (sin, cos) = direction.sin_cos();
        let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let ends = |direction: Vector2<f64>| {
            let half = direction * (0.5 * self.outline.radius(direction));
            [half, -half].map(|off| self.outline.centre + off).map(|at| i32::from(image.nearest(at.x, at.y)))
        };
        let (along, across) = (ends(along), ends(across));
        let (black, white) =
            if self.pattern == Pattern::BlackAlong { (along, across) } else { (across, along) };
        white[0].min(white[1]) - black[0].max(black[1])
    }

    /// What is said of it when it is turned down.
    pub fn rejected(&self, reason: RejectReason) -> Rejected {
        Rejected {
            centre_px: self.outline.centre,
            semi_major_px: self.outline.major,
            semi_minor_px: self.outline.minor,
            angle_rad: self.outline.angle,
            reason,
        }
    }
}
