//! Interior orientation of a camera file, and its conversion into a supported lens.

use super::keyed::Node;
use crate::installation::KeyFault;
use crate::measure::geometry::{Lens, LensError};

/// Interior orientation in a file.
pub(super) struct Interior {
    /// Width and height, px.
    pub size: [f64; 2],
    /// Parameters fx, fy, cx, cy, px.
    pub core: [f64; 4],
    /// Distortion in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6, then thin prism (4) and tilt (2).
    pub terms: Vec<f64>,
    /// Model as the file declares it.
    pub model: String,
    /// Keys of size, core and terms, for messages.
    pub keys: [&'static str; 3],
    /// Remarks for the user.
    pub remarks: Vec<String>,
    /// Keys that are not part of an interior orientation.
    pub left: Vec<String>,
}

/// Smallest and largest camera constant in lengths of the image's longer side: a field of view of 136 degrees, the limit of
/// the supported polynomials, and of 0.5 degrees.
const CONSTANT_SIDES: [f64; 2] = [0.2, 100.0];
/// Typical range of the camera constant, 103 and 11 degrees; outside it a unit may be wrong.
const TYPICAL_SIDES: [f64; 2] = [0.4, 5.0];
/// Largest typical relative difference of fx and fy: those of one lens differ by some thousandths.
const MAX_ASPECT_DEFECT: f64 = 0.02;
/// Largest typical offset of the principal point, as a fraction of the side: it is within a few per cent of the image's
/// centre, except in cropped images.
const MAX_CENTRE_OFFSET: f64 = 0.15;
/// Largest typical tangential term: those of lenses are some thousandths; larger ones indicate another order of terms.
const TYPICAL_TANGENTIAL: f64 = 0.005;
/// Largest side of an image, px.
const MAX_SIDE: f64 = 100_000.0;
/// Names of the terms in OpenCV's order.
const TERMS: [&str; 14] = [
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y",
];
/// Number of terms of a supported lens.
const OWN_TERMS: usize = 8;

impl Interior {
    /// Checks the values and returns the lens; unusual values are added to the remarks.
    pub fn check_lens(&mut self, map: &Node) -> Result<Lens, KeyFault> {
        self.check_size(map)?;
        self.check_core(map)?;
        self.check_terms(map)?;
        let d = |k: usize| self.terms.get(k).copied().unwrap_or(0.0);
        let [fx, fy, cx, cy] = self.core;
        let pinhole = Lens::pinhole(self.size[0] as u32, self.size[1] as u32, fx, cx, cy);
        let denominator = [d(5), d(6), d(7)];
        let lens = Lens {
            fy,
            k1: d(0),
            k2: d(1),
            p1: d(2),
            p2: d(3),
            k3: d(4),
            denominator,
            ..pinhole
        };
        self.check_inverse(map, &lens)?;
        self.remark_unusual_values(&lens);
        Ok(lens)
    }

    /// Returns the error of a key, with its line in the file.
    fn key_fault<T>(
        &self,
        map: &Node,
        key: usize,
        problem: String,
        remedy: &str,
    ) -> Result<T, KeyFault> {
        let key = self.keys[key];
        let line = map.get(key)?.map_or(map.line, |node| node.line);
        Err(KeyFault::on_line(line, key, problem, remedy))
    }

    fn check_size(&self, map: &Node) -> Result<(), KeyFault> {
        let [width, height] = self.size;
        let whole = |side: f64| side.fract() == 0.0 && (1.0..=MAX_SIDE).contains(&side);
        if whole(width) && whole(height) {
            return Ok(());
        }
        let problem = format!("is {width} x {height} px");
        self.key_fault(
            map,
            0,
            problem,
            "give the size of the images in whole pixels",
        )
    }

    fn check_core(&self, map: &Node) -> Result<(), KeyFault> {
        let ([fx, fy, cx, cy], [width, height]) = (self.core, self.size);
        if fx == 0.0 && fy == 0.0 {
            let problem = "is zero: this camera was never calibrated".to_owned();
            return self.key_fault(
                map,
                1,
                problem,
                "calibrate it, or use the file that its calibration wrote",
            );
        }
        let side = width.max(height);
        let sides = [fx, fy].map(|f| f / side);
        if sides
            .iter()
            .any(|s| !(CONSTANT_SIDES[0]..=CONSTANT_SIDES[1]).contains(s))
        {
            let problem = format!(
                "gives camera constants of {fx} and {fy} px, not {} to {} times the longer side of the image ({side} px)",
                CONSTANT_SIDES[0], CONSTANT_SIDES[1]
            );
            return self.key_fault(
                map,
                1,
                problem,
                "give fx and fy in pixels, in the right order",
            );
        }
        if !(0.0..=width).contains(&cx) || !(0.0..=height).contains(&cy) {
            let problem = format!(
                "puts the principal point at ({cx}, {cy}) px, outside {width} x {height} px"
            );
            return self.key_fault(
                map,
                1,
                problem,
                "give cx and cy in pixels, in the right order",
            );
        }
        Ok(())
    }

    /// Rejects thin prism and tilt terms other than 0, whose models are not supported.
    fn check_terms(&self, map: &Node) -> Result<(), KeyFault> {
        let other = self
            .terms
            .iter()
            .enumerate()
            .skip(OWN_TERMS)
            .find(|(_, value)| **value != 0.0);
        let Some((k, value)) = other else {
            return Ok(());
        };
        let model = if k < 12 { "thin prism" } else { "tilt" };
        let problem = format!("has {} = {value}, a term of the {model} model", TERMS[k]);
        self.key_fault(map, 2, problem, MODEL_REMEDY)
    }

    /// Checks that the distortion is invertible over the full image.
    fn check_inverse(&self, map: &Node, lens: &Lens) -> Result<(), KeyFault> {
        let Err(LensError::NoInverse { u_px, v_px }) = lens.check_edge() else {
            return Ok(());
        };
        // Messages count pixels from the edge of the image.
        let (u, v) = (u_px + 0.5, v_px + 0.5);
        let problem = format!("is not invertible: no ray belongs to the pixel ({u:.0}, {v:.0})");
        self.key_fault(
            map,
            2,
            problem,
            "calibrate again with the board up to the corners",
        )
    }

    /// Adds remarks on possible but rare values: a unit, an order or a size may be wrong.
    fn remark_unusual_values(&mut self, lens: &Lens) {
        let ([fx, fy, cx, cy], [width, height]) = (self.core, self.size);
        let sides = fx / width.max(height);
        if !(TYPICAL_SIDES[0]..=TYPICAL_SIDES[1]).contains(&sides) {
            self.remarks.push(format!(
                "the camera constant is {sides:.2} times the image's longer side; are all lengths in px?"
            ));
        }
        if (fx / fy - 1.0).abs() > MAX_ASPECT_DEFECT {
            self.remarks.push(format!(
                "fx and fy differ by {:.0} %",
                100.0 * (fx / fy - 1.0).abs()
            ));
        }
        if (cx / width - 0.5).abs() > MAX_CENTRE_OFFSET
            || (cy / height - 0.5).abs() > MAX_CENTRE_OFFSET
        {
            self.remarks.push(format!(
                "the principal point ({cx}, {cy}) is far from the centre of {width} x {height} px; does it belong to this size?"
            ));
        }
        if lens.p1.abs().max(lens.p2.abs()) > TYPICAL_TANGENTIAL {
            self.remarks.push(format!(
                "p1 = {} and p2 = {} are large; is the order k1 k2 p1 p2 k3?",
                lens.p1, lens.p2
            ));
        }
    }
}

/// Remedy for every unsupported model.
pub(super) const MODEL_REMEDY: &str = "calibrate with Brown's model or the rational model: OPENCV4, OPENCV5, OPENCV8, radtan, plumb_bob, rational_polynomial";
