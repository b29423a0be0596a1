//! What may be a marker, with what is known of it before it is measured.

pub mod neighbours;
pub mod prior;

use nalgebra::Vector2;

use crate::measure::detect::appearance::parameters::Pattern;
use crate::measure::detect::detection::{RejectReason, Rejected};
use crate::measure::detect::hypothesis::prior::{EdgePrior, SizePrior};
use crate::measure::detect::image::ellipse::Ellipse;
use crate::measure::detect::occlusion::decal::Decal;
use crate::measure::detect::occlusion::region::Band;
use crate::measure::raster::Raster;

/// What stage 4 starts from.
#[derive(Clone, Debug, PartialEq)]
pub struct Hypothesis {
    /// Disc or quadrants.
    pub pattern: Pattern,
    /// The marker's outline.
    pub ellipse: Ellipse,
    /// The blur, px, where that is of quadrants' black and white together.
    pub against_skin: Option<f64>,
    /// Quadrants: direction of s, and tangent of half the angle between the edges.
    pub edges: Option<(f64, f64)>,
    /// Blobs that it is made of.
    pub blobs: Vec<usize>,
    /// Decals that may lie over it.
    pub hidden: Vec<Decal>,
    /// Bands in which glare hides the marker.
    pub bands: Vec<Band>,
    /// Bands in which a seam of the skin meets the marker.
    pub seams: Vec<Band>,
    /// Whether size, direction and thickness are those of a disc beside it.
    pub alike: bool,
    /// How well the outline's size is known, where that is predicted.
    pub foretold: Option<SizePrior>,
    /// What the frame's other markers tell of its edges, where it is too thin to tell them itself.
    pub like: Option<EdgePrior>,
}

impl Hypothesis {
    /// With this outline, of which nothing more is known.
    pub fn of(pattern: Pattern, ellipse: Ellipse, blobs: Vec<usize>) -> Self {
        Self {
            pattern,
            ellipse,
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
        self.hidden.iter().any(|decal| decal.holds(at))
            || self.bands.iter().chain(&self.seams).any(|b| b.holds(at))
    }

    /// Whether no part of the marker is thought to be hidden.
    pub fn is_whole(&self) -> bool {
        self.hidden.is_empty() && self.bands.is_empty()
    }

    /// Whether all of its size is predicted.
    pub fn is_foretold(&self) -> bool {
        self.foretold.is_some_and(|foretold| foretold.slope.is_some())
    }

    /// Product of the semi-axes, px^2.
    pub fn size(&self) -> f64 {
        self.ellipse.major * self.ellipse.minor
    }

    /// By how much the darker of its white quadrants is lighter than the lighter of its black ones, half way out in the middle
    /// of each, grey levels; 0 for discs.
    pub fn white_over_black(&self, image: &Raster) -> i32 {
        let Some((direction, _)) = self.edges else { return 0 };
        let (sin, cos) = direction.sin_cos();
        let (along, across) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
        let ends = |direction: Vector2<f64>| {
            let half = direction * (0.5 * self.ellipse.radius(direction));
            [half, -half].map(|off| self.ellipse.centre + off).map(|at| i32::from(image.nearest(at.x, at.y)))
        };
        let (along, across) = (ends(along), ends(across));
        let (black, white) =
            if self.pattern == Pattern::BlackAlong { (along, across) } else { (across, along) };
        white[0].min(white[1]) - black[0].max(black[1])
    }

    /// What is said of it when it is turned down.
    pub fn rejected(&self, reason: RejectReason) -> Rejected {
        Rejected {
            centre_px: self.ellipse.centre,
            semi_major_px: self.ellipse.major,
            semi_minor_px: self.ellipse.minor,
            angle_rad: self.ellipse.angle,
            reason,
        }
    }
}
