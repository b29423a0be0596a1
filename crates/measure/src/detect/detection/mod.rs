//! Input and output of detection: predictions, detections, rejections.

pub mod covariance;

use std::ops::Range;

use nalgebra::Vector2;

use self::covariance::{Covariance, CovarianceSource};
use crate::detect::image::ellipse::Ellipse;
use crate::setup::Shape;

/// Marker found in an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    pub shape: Shape,
    /// Quadrants: the saddle point. Circle: the ellipse's own centre, perspective bias **not** removed.
    pub centre_px: Vector2<f64>,
    /// Covariance of `centre_px` with its contributions: residuals and Jacobian of the fit, and effects that leave no
    /// residuals.
    pub covariance_px2: Covariance,
    /// Semi-major axis of the outline.
    pub semi_major_px: f64,
    /// Semi-minor axis of the outline.
    pub semi_minor_px: f64,
    /// Direction of the major axis, from u towards v, in (-pi/2, pi/2].
    pub angle_rad: f64,
    /// Root mean square of the fit's residuals, grey levels.
    pub fit_rms: f64,
    /// Grey levels between white (or skin) and black; 0 if the outline was not measured.
    pub contrast: f64,
    /// Index of the marker in the survey if it is known without identification, as that of a point.
    pub marker: Option<usize>,
}

impl Detection {
    pub(super) fn ellipse(&self) -> Ellipse {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        Ellipse {
            centre: self.centre_px,
            major,
            minor,
            angle: self.angle_rad,
        }
    }

    /// Returns the sum of the position's variances, px^2, without the contributions of contamination, lost contrast and
    /// misfit.
    pub(super) fn variance(&self) -> f64 {
        let foreign = [
            CovarianceSource::Contamination,
            CovarianceSource::LostContrast,
            CovarianceSource::Misfit,
        ]
        .map(|source| self.covariance_px2.contribution(source).trace());
        self.covariance_px2.trace() - foreign.iter().sum::<f64>()
    }
}

/// Rejected hypothesis.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    pub centre_px: Vector2<f64>,
    /// Approximate size.
    pub semi_major_px: f64,
    /// Approximate size.
    pub semi_minor_px: f64,
    /// Approximate direction.
    pub angle_rad: f64,
    pub reason: RejectReason,
}

impl Rejected {
    /// Creates a rejection from an outline.
    pub(super) fn from_ellipse(ellipse: &Ellipse, reason: RejectReason) -> Self {
        let Ellipse {
            centre,
            major,
            minor,
            angle,
        } = *ellipse;
        Self {
            centre_px: centre,
            semi_major_px: major,
            semi_minor_px: minor,
            angle_rad: angle,
            reason,
        }
    }
}

/// Reason why a hypothesis is not a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RejectReason {
    TouchesEdge,
    TooSmall,
    /// Flatter than 1:40 (a disc) or 1:26 (quadrants), or not an ellipse at all.
    NotAnEllipse,
    /// Too little contrast for the noise.
    LowContrast,
    /// Inside neither uniformly dark (circle) nor four quadrants.
    Pattern,
    /// Residuals of the fit too large.
    PoorFit,
    NoConvergence,
    /// Explained by another detection.
    Duplicate,
    /// Possibly a marker, but with a position that is determined too poorly.
    Uncertain,
    /// Too little visible outside glare.
    GlareOccluded,
    /// Edge far softer than those of the frame's other markers.
    BlurOutlier,
    /// Far smaller than all of the frame's markers, which are of about one size at similar distances.
    SizeOutlier,
    /// Thin disc across the direction of the frame's other markers.
    OrientationOutlier,
}

impl RejectReason {
    /// Returns a short description for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::TouchesEdge => "touches the frame's edge",
            Self::TooSmall => "too small to measure",
            Self::NotAnEllipse => "outline is not an ellipse",
            Self::LowContrast => "too little contrast",
            Self::Pattern => "inside is neither uniform nor four quadrants",
            Self::PoorFit => "image model does not fit",
            Self::NoConvergence => "fit did not converge",
            Self::Duplicate => "explained by another detection",
            Self::Uncertain => "position too uncertain",
            Self::GlareOccluded => "glare hides too much of the marker",
            Self::BlurOutlier => "edge softer than those of the other markers",
            Self::SizeOutlier => "far smaller than the other markers",
            Self::OrientationOutlier => "lies across the other markers",
        }
    }
}

/// Result of detection in one frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Detections {
    /// Accepted markers in stable order: by v, then u.
    pub markers: Vec<Detection>,
    /// Rejected hypotheses in stable order: by v, then u.
    pub rejected: Vec<Rejected>,
    /// Standard deviation of the frame's point spread function; `None` without markers.
    pub psf_sigma_px: Option<f64>,
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
    /// Factor by which the markers' variances were raised because residuals are correlated, as JPEG leaves them; at least
    /// 1.
    pub inflation: f64,
    /// Standard deviation added to all positions because several quadrants have lost contrast.
    pub lost_contrast_px: f64,
    /// Sharpening of the frame, if its markers show it.
    pub overshoot: Option<Overshoot>,
}

/// Sharpening of an image: its difference from a blurred copy, times an amplitude, was added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overshoot {
    /// Amplitude, a ratio.
    pub amplitude: f64,
    /// Standard deviation of the amplitude between markers.
    pub amplitude_sigma: f64,
    /// Additional blur of the copy.
    pub halo_px: f64,
}

/// Predicted outline of a marker, from an earlier frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerPrediction {
    pub shape: Shape,
    pub centre_px: Vector2<f64>,
    pub semi_major_px: f64,
    pub semi_minor_px: f64,
    pub angle_rad: f64,
    /// Largest deviation of the centre to both sides along u and v.
    pub search_px: Vector2<f64>,
    /// True if it was visible in the earlier frame; a marker hidden for long need not be found.
    pub seen: bool,
}

impl MarkerPrediction {
    /// Returns the predicted outline; `None` if a number is outside the range of markers.
    pub(super) fn ellipse(&self) -> Option<Ellipse> {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        let [far_u, far_v] = self.search_px.into();
        let numbers = [
            self.centre_px.x,
            self.centre_px.y,
            self.angle_rad,
            far_u,
            far_v,
        ];
        /// Accepted semi-axes of a prediction, px: major, minor.
        const AXES_PX: [Range<f64>; 2] = [1.0..2000.0, 0.5..2000.0];
        let sound = numbers.iter().all(|v| v.is_finite())
            && AXES_PX[0].contains(&major)
            && AXES_PX[1].contains(&minor);
        sound.then_some(Ellipse {
            centre: self.centre_px,
            major,
            minor,
            angle: self.angle_rad,
        })
    }
}

/// Orders positions from top to bottom, then from left to right.
pub fn compare_positions(a: &Vector2<f64>, b: &Vector2<f64>) -> std::cmp::Ordering {
    a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x))
}
