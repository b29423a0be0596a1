//! Recognition of blobs that are whole discs, by fits of the image model.

use super::strategies::Measurer;
use super::whole::looks_cut;
use crate::detect::accept::verdict::MeasurementResult;
use crate::detect::attempt::options::WHOLE;
use crate::detect::detection::Detection;
use crate::detect::image::ellipse::Ellipse;
use crate::detect::propose::moments;

impl Measurer<'_> {
    /// Measures a blob that looks like a whole disc; `None` for others.
    fn measure_round(&self, index: usize) -> Option<MeasurementResult> {
        let round = self.blobs.get(index).filter(|b| !looks_cut(b)).and_then(|b| moments::disc_from_blob(index, b));
        round.map(|disc| self.measure_whole(index, &disc))
    }

    /// Returns whether a blob is a whole disc with a precise position.
    pub fn is_sure_disc(&self, index: usize) -> bool {
        matches!(self.measure_round(index), Some(Ok(disc)) if disc.is_sure())
    }

    /// Returns whether two or more discs lie in measured quadrants, each with less than half of their residuals.
    pub fn contain_discs(&self, quadrants: &Detection) -> bool {
        let whole = quadrants.ellipse();
        let mut found: Vec<Ellipse> = Vec::new();
        for (i, _) in self.blobs.iter().enumerate().filter(|(_, b)| whole.contains(b.centroid)) {
            let Some(Ok(disc)) = self.measure_round(i) else { continue };
            let ellipse = disc.detection.ellipse();
            let better = disc.is_sure() && disc.detection.fit_rms < WHOLE.max_disc_residuals * quadrants.fit_rms;
            if better && !found.iter().any(|other| other.contains(ellipse.centre)) {
                found.push(ellipse);
            }
        }
        found.len() > 1
    }
}
