//! Joint shape of a flight: errors that last beyond the flight, that its frames share, and that each has on its own.

use nalgebra::{DMatrix, DVector};

use super::flight_information::add_frame_normals;
use super::joint::JointSolution;
use crate::adjust::flight_prior::{InvariantParameter, RepeatingParameters};
use crate::adjust::joint_shape::{
    FrameShape, JointShape, ShapeFunctions, StationChoice, empty_shape, reduce_factors,
};
use crate::adjust::{AdjustError, AdjustResult};
use crate::estimation::{Prior, symmetric_root};

impl JointSolution<'_> {
    /// Shape of the flight, without the frames' results.
    pub fn joint_shape(&self, stations: &StationChoice) -> AdjustResult<JointShape> {
        let fit = &self.solved.fit;
        let mut shape = empty_shape(&self.outcome(0), stations);
        let functions: Vec<ShapeFunctions> = (0..self.flight.frames.len())
            .map(|frame| self.outcome(frame).shape_functions(&shape))
            .collect();
        let singular = || AdjustError::Input("the flight's normal equations are singular".into());
        let (columns, common) = self.lasting_information().ok_or_else(singular)?;
        let mut rest = fit.information.clone();
        for (i, row) in columns.iter().enumerate() {
            columns
                .iter()
                .enumerate()
                .for_each(|(j, column)| rest[(*row, *column)] -= common[(i, j)]);
        }
        // Error of the parameters: covariance times the errors of the right side of the normal equations.
        let by_lasting = fit.covariance.select_columns(&columns) * symmetric_root(&common);
        let by_shared = &fit.covariance * symmetric_root(&rest);
        let shared = functions.iter().map(|f| &f.by_global * &by_shared);
        let shared = reduce_factors(shared.collect());
        let frames = functions.into_iter().zip(shared).map(|(f, shared)| {
            let none = DMatrix::zeros(f.values.len(), 0);
            let own = reduce_factors(vec![f.own]).pop().unwrap_or(none);
            FrameShape {
                values: f.values,
                factors: [f.by_global * &by_lasting, shared, own],
            }
        });
        shape.frames = frames.collect();
        Ok(shape)
    }

    /// Information that every flight of the installation has, from survey, ground frames, earlier flights and priors of the
    /// invariant parameters, with these parameters' columns. Of a prior whose parameter differs from flight to flight, the
    /// part that repeats counts.
    fn lasting_information(&self) -> Option<(Vec<usize>, DMatrix<f64>)> {
        let (problem, fit) = (&self.solved.flight_problem, &self.solved.fit);
        let p = fit.global.len();
        let (mut normal, mut gradient) = (DMatrix::zeros(p, p), DVector::zeros(p));
        let ground = problem
            .problem
            .groups
            .iter()
            .zip(&fit.groups)
            .skip(problem.layouts.len());
        for (group, solved) in ground {
            add_frame_normals(group, solved, &mut normal, &mut gradient)?;
        }
        let (unknowns, columns): (Vec<InvariantParameter>, Vec<usize>) =
            problem.invariant.iter().copied().unzip();
        let repeating = RepeatingParameters::new(&unknowns, self.flight.input.setup).ok()?;
        for Prior {
            columns: own,
            covariance,
            ..
        } in &problem.problem.priors
        {
            let at: Option<Vec<usize>> = own
                .iter()
                .map(|c| columns.iter().position(|column| column == c))
                .collect();
            let Some(at) = at else { continue };
            let weight = covariance.clone().cholesky()?.inverse();
            let repeated = &weight - &weight * repeating.flight_covariance(&at) * &weight;
            let root = symmetric_root(&((&repeated + repeated.transpose()) * 0.5));
            let repeated = &root * &root;
            for (i, row) in own.iter().enumerate() {
                own.iter()
                    .enumerate()
                    .for_each(|(j, column)| normal[(*row, *column)] += repeated[(i, j)]);
            }
        }
        if let Some(known) = &problem.problem.known {
            normal += &known.information;
        }
        let common = normal.select_columns(&columns).select_rows(&columns);
        Some((columns, common))
    }
}
