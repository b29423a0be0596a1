//! What detection answers and is asked: detections, rejections, predictions.

pub mod covariance;

use std::ops::Range;

use nalgebra::Vector2;

use self::covariance::{Covariance, CovarianceSource};
use crate::detect::image::ellipse::Ellipse;
use crate::setup::Shape;

/// A marker found in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Quadrant or circle.
    pub shape: Shape,
    /// Quadrant: the saddle. Circle: the ellipse's own centre, perspective bias **not** removed. px.
    pub centre_px: Vector2<f64>,
    /// Covariance of `centre_px`, px^2, with what it is the sum of: the fit's residuals and Jacobian, and what they do not show.
    pub covariance_px2: Covariance,
    /// Outline's semi-major axis, px.
    pub semi_major_px: f64,
    /// Outline's semi-minor axis, px.
    pub semi_minor_px: f64,
    /// Direction of the major axis, from u towards v, rad, in (-pi/2, pi/2].
    pub angle_rad: f64,
    /// Root mean square of the fit's residuals, grey levels.
    pub fit_rms: f64,
    /// Grey levels between white (or skin) and black.
    pub contrast: f64,
}

impl Detection {
    pub(super) fn ellipse(&self) -> Ellipse {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        Ellipse { centre: self.centre_px, major, minor, angle: self.angle_rad }
    }

    /// Sum of the place's variances, px^2, without what is for things beside it, before it and in its own light.
    pub(super) fn variance(&self) -> f64 {
        let foreign = [CovarianceSource::Beside, CovarianceSource::LostContrast, CovarianceSource::Misfit]
            .map(|source| self.covariance_px2.of(source).trace());
        self.covariance_px2.trace() - foreign.iter().sum::<f64>()
    }
}

/// A hypothesis that was looked at and turned down.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Where, px.
    pub centre_px: Vector2<f64>,
    /// Rough size, px.
    pub semi_major_px: f64,
    /// Rough size, px.
    pub semi_minor_px: f64,
    /// Rough direction, rad.
    pub angle_rad: f64,
    /// Why.
    pub reason: RejectReason,
}

impl Rejected {
    /// Of something with an outline.
    pub(super) fn of(ellipse: &Ellipse, reason: RejectReason) -> Self {
        let Ellipse { centre, major, minor, angle } = *ellipse;
        Self { centre_px: centre, semi_major_px: major, semi_minor_px: minor, angle_rad: angle, reason }
    }
}

/// Why a hypothesis is not a marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RejectReason {
    /// The outline touches the frame's edge.
    TouchesEdge,
    /// Too small to be measured.
    TooSmall,
    /// Flatter than 1:40 (a disc) or 1:26 (quadrants), or not an ellipse at all.
    NotAnEllipse,
    /// Too little contrast against the noise.
    LowContrast,
    /// The inside is not uniformly dark (circle) nor four quadrants.
    Pattern,
    /// The model's fit leaves residuals that are too large.
    PoorFit,
    /// The fit did not converge.
    NoConvergence,
    /// Another detection already explains it.
    Duplicate,
    /// A marker, but its place is told too badly.
    Uncertain,
    /// Glare leaves too little of it.
    GlareOccluded,
    /// Its edge is far softer than those of the frame's markers.
    BlurOutlier,
    /// Far smaller than all the frame's markers, which are of about one size at like distances.
    SizeOutlier,
    /// A thin disc that lies across the frame's other markers.
    OrientationOutlier,
}

impl RejectReason {
    /// A few words for a person.
    pub fn text(self) -> &'static str {
        match self {
            Self::TouchesEdge => "touches the frame's edge",
            Self::TooSmall => "too small to measure",
            Self::NotAnEllipse => "outline is not an ellipse",
            Self::LowContrast => "too little contrast",
            Self::Pattern => "inside is neither uniform nor four quadrants",
            Self::PoorFit => "image model does not fit",
            Self::NoConvergence => "fit did not converge",
            Self::Duplicate => "another detection explains it",
            Self::Uncertain => "place too uncertain",
            Self::GlareOccluded => "glare leaves too little of it",
            Self::BlurOutlier => "edge softer than the other markers'",
            Self::SizeOutlier => "far smaller than the other markers",
            Self::OrientationOutlier => "lies across the other markers",
        }
    }
}

/// All that one frame yields.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Detections {
    /// In stable order: by v, then u.
    pub markers: Vec<Detection>,
    /// In stable order: by v, then u.
    pub rejected: Vec<Rejected>,
    /// Standard deviation of the frame's point spread function, px; `None` without markers.
    pub psf_sigma_px: Option<f64>,
    /// Standard deviation of the grey values' noise, grey levels.
    pub noise: f64,
    /// By how much the markers' variances were raised because residuals hang together, as JPEG leaves them; at least 1.
    pub inflation: f64,
    /// By how much any place is doubted because several quadrants have lost contrast, px.
    pub lost_contrast_px: f64,
    /// How the frame was sharpened, where its markers show that.
    pub overshoot: Option<Overshoot>,
}

impl Detections {
    /// Takes up more markers; they stay in order.
    pub fn add(&mut self, more: Vec<Detection>) {
        self.markers.extend(more);
        self.markers.sort_by(|a, b| by_place(&a.centre_px, &b.centre_px));
    }
}

/// How a picture was sharpened: an amplitude times its difference from a blurred copy was added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overshoot {
    /// The amplitude, a ratio.
    pub amplitude: f64,
    /// By how much that differs from marker to marker, standard deviation.
    pub amplitude_sigma: f64,
    /// Blur of the copy beside the frame's own, px.
    pub halo_px: f64,
}

/// Where a marker is expected: the outline predicted from an earlier frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerPrediction {
    /// Kind of target.
    pub shape: Shape,
    /// Expected centre, px.
    pub centre_px: Vector2<f64>,
    /// Expected semi-major axis, px.
    pub semi_major_px: f64,
    /// Expected semi-minor axis, px.
    pub semi_minor_px: f64,
    /// Expected direction, rad.
    pub angle_rad: f64,
    /// How far the centre may be off to both sides along u and v, px.
    pub search_px: Vector2<f64>,
    /// Whether the earlier frame showed it; what is hidden for long need not be there.
    pub seen: bool,
}

impl MarkerPrediction {
    /// The expected outline; `None` where a number is none of a marker's.
    pub(super) fn ellipse(&self) -> Option<Ellipse> {
        let (major, minor) = (self.semi_major_px, self.semi_minor_px);
        let [far_u, far_v] = self.search_px.into();
        let numbers = [self.centre_px.x, self.centre_px.y, self.angle_rad, far_u, far_v];
        /// Semi-axes that a prediction may have, px: major, minor.
        const AXES_PX: [Range<f64>; 2] = [1.0..2000.0, 0.5..2000.0];
        let sound = numbers.iter().all(|v| v.is_finite())
            && AXES_PX[0].contains(&major)
            && AXES_PX[1].contains(&minor);
        sound.then_some(Ellipse { centre: self.centre_px, major, minor, angle: self.angle_rad })
    }
}

pub fn by_place(a: &Vector2<f64>, b: &Vector2<f64>) -> std::cmp::Ordering {
    a.y.total_cmp(&b.y).then(a.x.total_cmp(&b.x))
}
