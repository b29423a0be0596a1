//! Regions of the picture that may show something else than the marker.

use nalgebra::Vector2;

use super::decal::Decal;

/// A region that a fit leaves out, by what may lie in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// A decal that lies over the marker.
    Decal(Decal),
    /// Glare that hides the marker.
    Glare(OcclusionBand),
    /// A seam of the skin that meets the marker.
    Seam(OcclusionBand),
    /// An end of the marker that dark paint touches.
    Paint(OcclusionBand),
}

impl Region {
    /// Whether it holds a point.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        match self {
            Self::Decal(decal) => decal.contains(at),
            Self::Glare(band) | Self::Seam(band) | Self::Paint(band) => band.contains(at),
        }
    }

    /// The decal, if it is one.
    pub fn decal(&self) -> Option<&Decal> {
        if let Self::Decal(decal) = self { Some(decal) } else { None }
    }

    /// The band, if it is glare.
    pub fn glare(&self) -> Option<&OcclusionBand> {
        if let Self::Glare(band) = self { Some(band) } else { None }
    }
}

/// A strip of the picture across a marker's axis, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OcclusionBand {
    /// Unit vector of the axis.
    pub axis: Vector2<f64>,
    /// Where it begins along the axis, counted from the picture's origin.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
}

impl OcclusionBand {
    /// Whether it holds a point.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        (self.from..=self.to).contains(&self.axis.dot(at))
    }
}
