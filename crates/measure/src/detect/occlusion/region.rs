//! Regions of the image that may show other objects than the marker.

use nalgebra::Vector2;

use super::decal::Decal;

/// Region that a fit excludes, by type of occlusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// Decal that lies over the marker.
    Decal(Decal),
    /// Glare that hides the marker.
    Glare(OcclusionBand),
    /// Seam of the skin that meets the marker.
    Seam(OcclusionBand),
    /// End of the marker that dark paint touches.
    Paint(OcclusionBand),
}

impl Region {
    /// Returns true if the point lies in the region.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        match self {
            Self::Decal(decal) => decal.contains(at),
            Self::Glare(band) | Self::Seam(band) | Self::Paint(band) => band.contains(at),
        }
    }

    /// Returns the decal of a decal region.
    pub fn decal(&self) -> Option<&Decal> {
        if let Self::Decal(decal) = self {
            Some(decal)
        } else {
            None
        }
    }

    /// Returns the band of a glare region.
    pub fn glare(&self) -> Option<&OcclusionBand> {
        if let Self::Glare(band) = self {
            Some(band)
        } else {
            None
        }
    }
}

/// Strip of the image across a direction, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OcclusionBand {
    /// Unit vector along which `from` and `to` are measured.
    pub axis: Vector2<f64>,
    /// First position along the axis, from the origin of the image.
    pub from: f64,
    /// Last position along the axis.
    pub to: f64,
}

impl OcclusionBand {
    /// Returns true if the point lies in the band.
    pub fn contains(&self, at: &Vector2<f64>) -> bool {
        (self.from..=self.to).contains(&self.axis.dot(at))
    }
}
