//! One kind of unknown of the spatial methods, and where its columns stand.

use std::fmt::Debug;
use std::sync::Arc;

use nalgebra::{DVector, Vector2, Vector3};

use super::beam::Section;
use super::curve::Curve;
use super::gauss_helmert::Prior;
use super::marker_state::MarkerState;
use super::scene::Predicted;
use super::values::Values;

/// A marker's image in flight with everything that it answers to.
pub struct Sight<'a> {
    /// The marker in flight.
    pub state: &'a MarkerState,
    /// Its pixel.
    pub predicted: &'a Predicted,
}

/// One kind of unknown: its columns, what is known of them beforehand, how the model takes them, and how all that is
/// measured or reported answers to them. `k` counts its columns.
pub trait Term: Debug + Send + Sync {
    /// Its name in a budget of variance.
    fn name(&self) -> &'static str;

    /// What is missing where it cannot be determined; ends the sentence "the adjustment has no unique solution: …".
    fn missing(&self) -> &'static str;

    /// Number of columns.
    fn size(&self) -> usize;

    /// What is known of it beforehand, its columns counted from 0.
    fn priors(&self) -> Vec<Prior> {
        vec![]
    }

    /// Adds its values to the model's.
    fn enter(&self, x: &[f64], values: &mut Values);

    /// d position of a marker in flight / d unknown, wing frame, m per its unit.
    fn position(&self, _k: usize, _state: &MarkerState) -> Vector3<f64> {
        Vector3::zeros()
    }

    /// d pixel in flight / d unknown, px per its unit.
    fn in_flight(&self, k: usize, sight: &Sight) -> Vector2<f64> {
        sight.predicted.by_point * self.position(k, sight.state)
    }

    /// d pixel in the ground frame / d unknown, px per its unit.
    fn on_ground(&self, _k: usize, _predicted: &Predicted) -> Vector2<f64> {
        Vector2::zeros()
    }

    /// d lift of the axis / d unknown along the curve, m per its unit; empty where it does not lift the axis.
    fn lifts(&self, _k: usize, _curve: &Curve) -> Vec<f64> {
        vec![]
    }

    /// d twist of a section / d unknown, rad per its unit.
    fn twist(&self, _k: usize, _section: &Section) -> f64 {
        0.0
    }
}

/// First column of a set of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Among the global parameters.
    Global(usize),
    /// Among the group's local parameters.
    Local(usize),
}

/// A term with its columns.
#[derive(Clone, Debug)]
pub struct Placed {
    /// What it is.
    pub term: Arc<dyn Term>,
    /// Where it stands.
    pub place: Place,
}

impl Placed {
    /// Adds its values to the model's.
    pub fn enter(&self, global: &DVector<f64>, local: &DVector<f64>, values: &mut Values) {
        let (vector, first) = match self.place {
            Place::Global(first) => (global, first),
            Place::Local(first) => (local, first),
        };
        self.term.enter(&vector.as_slice()[first..first + self.term.size()], values);
    }
}

/// Columns handed out one after the other, with what is known of them.
#[derive(Default)]
pub struct Columns {
    /// Per column: what is missing where it cannot be determined.
    pub missing: Vec<&'static str>,
    /// On the columns so far.
    pub priors: Vec<Prior>,
    is_local: bool,
}

impl Columns {
    /// For a group's own parameters.
    pub fn local() -> Self {
        Self { is_local: true, ..Self::default() }
    }

    /// Takes `n` columns that no term describes.
    pub fn take(&mut self, n: usize, missing: &'static str) -> usize {
        let first = self.missing.len();
        self.missing.extend(std::iter::repeat_n(missing, n));
        first
    }

    /// Takes a term's columns.
    pub fn place(&mut self, term: Arc<dyn Term>) -> Placed {
        let first = self.take(term.size(), term.missing());
        self.priors.extend(term.priors().into_iter().map(|prior| prior.moved(first)));
        let place = if self.is_local { Place::Local(first) } else { Place::Global(first) };
        Placed { term, place }
    }
}
