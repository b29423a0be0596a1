//! What a camera's file says, and the lens that it makes where it is one of ours.

use nalgebra::Vector2;

use crate::installation::keyed::{Node, Trouble};
use crate::measure::geometry::Lens;

/// An interior orientation as a file states it.
pub(super) struct Interior {
    /// Width and height, px.
    pub size: [f64; 2],
    /// fx, fy, cx, cy, px.
    pub core: [f64; 4],
    /// Distortion in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6, then thin prism (4) and tilt (2).
    pub terms: Vec<f64>,
    /// The model as the file declares it.
    pub model: String,
    /// The keys of size, core and terms, for faults.
    pub keys: [&'static str; 3],
    /// What somebody should know.
    pub remarks: Vec<String>,
    /// Keys that are no part of an interior orientation.
    pub left: Vec<String>,
}

/// A camera constant of this many sides of the image, at least and at most: a field of view of 136 degrees, beyond which
/// no polynomial of ours goes, and of half a degree.
const CONSTANT_SIDES: [f64; 2] = [0.2, 100.0];
/// Outside of these, 103 and 11 degrees, a unit may have been mistaken.
const USUAL_SIDES: [f64; 2] = [0.4, 5.0];
/// Pixels that are not square to this share are rare: fx and fy of one lens differ by some thousandths.
const SQUARE: f64 = 0.02;
/// Principal points lie some per cent of the side from the image's centre, but in images that were cut out.
const CENTRAL: f64 = 0.15;
/// Tangential terms of lenses are at most some thousandths; larger ones tell of terms in another order.
const TANGENTIAL: f64 = 0.005;
/// Largest side of an image, px.
const MAX_SIDE: f64 = 100_000.0;
/// Names of the terms in OpenCV's order.
const TERMS: [&str; 14] =
    ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"];
/// Terms that a lens of ours has.
const OURS: usize = 8;

impl Interior {
    /// The lens, with what is unusual about it as remarks.
    pub fn lens(&mut self, map: &Node) -> Result<Lens, Trouble> {
        self.check_size(map)?;
        self.check_core(map)?;
        self.check_terms(map)?;
        let d = |k: usize| self.terms.get(k).copied().unwrap_or(0.0);
        let [fx, fy, cx, cy] = self.core;
        let pinhole = Lens::pinhole(self.size[0] as u32, self.size[1] as u32, fx, cx, cy);
        let denominator = [d(5), d(6), d(7)];
        let lens = Lens { fy, k1: d(0), k2: d(1), p1: d(2), p2: d(3), k3: d(4), denominator, ..pinhole };
        self.check_inverse(map, &lens)?;
        self.unusual(&lens);
        Ok(lens)
    }

    fn trouble<T>(&self, map: &Node, key: usize, problem: String, mend: &str) -> Result<T, Trouble> {
        let key = self.keys[key];
        let line = map.get(key)?.map_or(map.line, |node| node.line);
        Err(Trouble::new(line, key, problem, mend))
    }

    fn check_size(&self, map: &Node) -> Result<(), Trouble> {
        let [width, height] = self.size;
        let whole = |side: f64| side.fract() == 0.0 && (1.0..=MAX_SIDE).contains(&side);
        if whole(width) && whole(height) {
            return Ok(());
        }
        let problem = format!("is {width} x {height} px");
        self.trouble(map, 0, problem, "give the size of the pictures in whole pixels")
    }

    fn check_core(&self, map: &Node) -> Result<(), Trouble> {
        let ([fx, fy, cx, cy], [width, height]) = (self.core, self.size);
        if fx == 0.0 && fy == 0.0 {
            let problem = "holds zeros: this camera was never calibrated".to_owned();
            return self.trouble(
                map,
                1,
                problem,
                "calibrate it, or take the file that its calibration wrote",
            );
        }
        let sides = [fx, fy].map(|f| f / width.max(height));
        if sides.iter().any(|s| !(CONSTANT_SIDES[0]..=CONSTANT_SIDES[1]).contains(s)) {
            let problem = format!("gives camera constants of {fx} and {fy} px in pictures {width} px wide");
            return self.trouble(map, 1, problem, "give fx and fy in pixels, in their places");
        }
        if !(0.0..=width).contains(&cx) || !(0.0..=height).contains(&cy) {
            let problem =
                format!("puts the principal point at ({cx}, {cy}) px, outside {width} x {height} px");
            return self.trouble(map, 1, problem, "give cx and cy in pixels, in their places");
        }
        Ok(())
    }

    /// Thin prism and tilt are models that are not ours, but where they are 0.
    fn check_terms(&self, map: &Node) -> Result<(), Trouble> {
        let other = self.terms.iter().enumerate().skip(OURS).find(|(_, value)| **value != 0.0);
        let Some((k, value)) = other else { return Ok(()) };
        let model = if k < 12 { "thin prism" } else { "tilt" };
        let problem = format!("has {} = {value}, a term of the {model} model", TERMS[k]);
        self.trouble(map, 2, problem, CALIBRATE)
    }

    /// The distortion must be invertible over the whole image.
    fn check_inverse(&self, map: &Node, lens: &Lens) -> Result<(), Trouble> {
        let [w, h] = self.size;
        let steps = (0..=20).map(|k| f64::from(k) / 20.0);
        let edge = steps.flat_map(|t| [(t * w, 0.0), (t * w, h), (0.0, t * h), (w, t * h)]);
        for (u, v) in edge {
            if lens.ray(&Vector2::new(u - 0.5, v - 0.5)).is_err() {
                let problem = format!("folds: no ray belongs to the pixel ({u:.0}, {v:.0})");
                return self.trouble(map, 2, problem, "calibrate again with boards up to the corners");
            }
        }
        Ok(())
    }

    /// What is possible and rare: a unit, an order or a size may have been mistaken.
    fn unusual(&mut self, lens: &Lens) {
        let ([fx, fy, cx, cy], [width, height]) = (self.core, self.size);
        let sides = fx / width.max(height);
        if !(USUAL_SIDES[0]..=USUAL_SIDES[1]).contains(&sides) {
            self.remarks
                .push(format!("the camera constant is {sides:.2} widths of the image; are all lengths px?"));
        }
        if (fx / fy - 1.0).abs() > SQUARE {
            self.remarks.push(format!("fx and fy differ by {:.0} %", 100.0 * (fx / fy - 1.0).abs()));
        }
        if (cx / width - 0.5).abs() > CENTRAL || (cy / height - 0.5).abs() > CENTRAL {
            self.remarks.push(format!(
                "the principal point ({cx}, {cy}) is far from the centre of {width} x {height} px; is it of this size?"
            ));
        }
        if lens.p1.abs().max(lens.p2.abs()) > TANGENTIAL {
            self.remarks.push(format!(
                "p1 = {} and p2 = {} are large: is the order k1 k2 p1 p2 k3?",
                lens.p1, lens.p2
            ));
        }
    }
}

/// Mend of every model that is not ours.
pub(super) const CALIBRATE: &str = "calibrate with Brown's model or the rational one: OPENCV4, OPENCV5, OPENCV8, radtan, plumb_bob, rational_polynomial";
