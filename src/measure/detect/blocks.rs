//! What residuals that lie together did to a fit's centre: a sandwich estimate of its covariance.

use nalgebra::{Cholesky, Matrix2, SymmetricEigen};

use super::model::{Parameters, Pixel, X, Y};
use super::uneven::REACH;

/// Side of the squares whose residuals may hang together, px: those of JPEG, and whole multiples of
/// them on a marker with a longer major axis than this many semi-axes.
const SQUARE_PX: f64 = 8.0;
const SQUARES: f64 = 11.0;
/// Up to this ratio the variance from blocks is not told from the fit's own: there are few blocks.
const CHANCE: f64 = 2.4;
/// Sectors along the marker, on each side of its axis, whose residuals may hang together.
const SECTORS: usize = 24;

/// What the residuals of pixels that lie together did to the centre, px: in squares, and in sectors
/// along the marker on each side of its axis.
pub struct Blocks {
    origin: [f64; 2],
    side: f64,
    width: usize,
    squares: Vec<[f64; 2]>,
    sectors: Vec<[f64; 2]>,
}

impl Blocks {
    /// None yet.
    pub fn new(pixels: &[Pixel], m: &Parameters) -> Self {
        // The pixels' own extent, for quadrants have no axes.
        let reach = pixels.iter().map(|p| (p.x - m[X]).abs().max((p.y - m[Y]).abs())).fold(1.0, f64::max);
        let side = SQUARE_PX * (reach / (SQUARE_PX * SQUARES)).ceil();
        let origin = [m[X], m[Y]].map(|c| ((c - reach) / side).floor() * side);
        let width = (2.0 * reach / side) as usize + 2;
        let none = |count: usize| vec![[0.0; 2]; count];
        Self { origin, side, width, squares: none(width * width), sectors: none(2 * SECTORS) }
    }

    /// Takes up what a pixel's residual did.
    pub fn add(&mut self, pixel: &Pixel, moved: [f64; 2]) {
        let place = |v: f64, k: usize| ((v - self.origin[k]) / self.side).max(0.0) as usize;
        let square =
            place(pixel.y, 1).min(self.width - 1) * self.width + place(pixel.x, 0).min(self.width - 1);
        let sector =
            ((pixel.p / REACH + 1.0) * 0.5 * SECTORS as f64).clamp(0.0, SECTORS as f64 - 1.0) as usize;
        let sector = 2 * sector + usize::from(pixel.q > 0.0);
        for (k, moved) in moved.into_iter().enumerate() {
            self.squares[square][k] += moved;
            self.sectors[sector][k] += moved;
        }
    }

    /// `white`, at least what the blocks show, and the greatest ratio of the two.
    pub fn raise(&self, white: &Matrix2<f64>, count: usize) -> Option<(Matrix2<f64>, f64)> {
        let (raised, one) = at_least(white, &scatter(&self.squares, count))?;
        let (raised, other) = at_least(&raised, &scatter(&self.sectors, count))?;
        Some((raised, one.max(other)))
    }
}

/// The centre's covariance from blocks that are independent of each other.
fn scatter(blocks: &[[f64; 2]], count: usize) -> Matrix2<f64> {
    let seen: Matrix2<f64> = blocks.iter().map(|&[x, y]| Matrix2::new(x * x, x * y, x * y, y * y)).sum();
    // The parameters take up part of what is common to a block.
    let number = blocks.iter().filter(|b| **b != [0.0; 2]).count() as f64;
    seen * (number / (number - count as f64).max(1.0)).min(2.5)
}

/// `white` raised, in its own units, to `seen` in the directions in which that is clearly greater.
fn at_least(white: &Matrix2<f64>, seen: &Matrix2<f64>) -> Option<(Matrix2<f64>, f64)> {
    let root = Cholesky::new(*white)?.l();
    let inverse = root.try_inverse()?;
    let eigen = SymmetricEigen::new(inverse * seen * inverse.transpose());
    let raised = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| if v > CHANCE { v } else { 1.0 }));
    let back = root * eigen.eigenvectors;
    Some((back * raised * back.transpose(), eigen.eigenvalues.max()))
}
