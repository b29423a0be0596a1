use nalgebra::{DMatrix, DVector};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::*;

/// Creates the textbook Gauss-Helmert problem: a straight line y = m x + b with errors in x and y.
fn line(points: &[(f64, f64)], sx: f64, sy: f64) -> Problem {
    let block = |&(x, y): &(f64, f64)| Group {
        local: DVector::zeros(0),
        priors: vec![],
        blocks: vec![Block {
            observed: DVector::from_vec(vec![x, y]),
            covariance: DMatrix::from_diagonal(&DVector::from_vec(vec![sx * sx, sy * sy])),
        }],
    };
    Problem {
        start: DVector::from_vec(vec![0.0, 0.0]),
        missing: vec!["slope", "offset"],
        priors: vec![],
        known: None,
        groups: points.iter().map(block).collect(),
    }
}

fn line_block(p: &BlockPoint) -> EstimationResult<Linearised> {
    let (m, b, x, y) = (p.global[0], p.global[1], p.observed[0], p.observed[1]);
    Ok(Linearised {
        misclosure: DVector::from_element(1, m * x + b - y),
        columns: vec![0, 1],
        global: DMatrix::from_row_slice(1, 2, &[x, 1.0]),
        local: DMatrix::zeros(1, 0),
        observations: DMatrix::from_row_slice(1, 2, &[m, -1.0]),
    })
}

const POINTS: [(f64, f64); 6] = [
    (0.0, 1.1),
    (1.0, 2.9),
    (2.1, 5.2),
    (2.9, 7.1),
    (4.2, 9.0),
    (5.0, 11.2),
];

#[test]
fn total_least_squares_line_is_the_principal_axis() {
    let fit = solve(&line(&POINTS, 0.1, 0.1), line_block).unwrap();
    // Equal variances: the orthogonal regression, in closed form.
    let n = POINTS.len() as f64;
    let (mx, my) = POINTS
        .iter()
        .fold((0.0, 0.0), |(a, b), p| (a + p.0 / n, b + p.1 / n));
    let (sxx, sxy, syy) = POINTS.iter().fold((0.0, 0.0, 0.0), |(a, b, c), p| {
        let (dx, dy) = (p.0 - mx, p.1 - my);
        (a + dx * dx, b + dx * dy, c + dy * dy)
    });
    let slope = (syy - sxx + ((syy - sxx).powi(2) + 4.0 * sxy * sxy).sqrt()) / (2.0 * sxy);
    assert!((fit.global[0] - slope).abs() < 1e-8);
    assert!((fit.global[1] - (my - slope * mx)).abs() < 1e-7);
    assert_eq!(fit.redundancy, 4);
    let norm: f64 = fit
        .groups
        .iter()
        .map(|g| g.blocks[0].residuals.norm_squared() / 0.01)
        .sum();
    assert!((norm - fit.omega).abs() < 1e-9);
}

#[test]
fn residual_cofactors_sum_to_the_redundancy() {
    let problem = line(&POINTS, 0.1, 0.3);
    let fit = solve(&problem, line_block).unwrap();
    let total: f64 = (0..POINTS.len())
        .map(|g| {
            let q = &problem.groups[g].blocks[0].covariance;
            let cofactor = q - fit.adjusted_covariance(g, 0);
            (0..2).map(|k| cofactor[(k, k)] / q[(k, k)]).sum::<f64>()
        })
        .sum();
    assert!((total - 4.0).abs() < 1e-9, "{total}");
}

/// The line of the other tests with the adjusted x of every point as a local parameter, and x and y observed.
#[test]
fn local_parameters_give_the_same_answer_as_conditions() {
    let mut problem = line(&POINTS, 0.1, 0.3);
    for (group, p) in problem.groups.iter_mut().zip(POINTS) {
        group.local = DVector::from_element(1, p.0);
    }
    let with_local = |p: &BlockPoint| {
        let (m, b, x) = (p.global[0], p.global[1], p.local[0]);
        Ok(Linearised {
            misclosure: DVector::from_vec(vec![x - p.observed[0], m * x + b - p.observed[1]]),
            columns: vec![0, 1],
            global: DMatrix::from_row_slice(2, 2, &[0.0, 0.0, x, 1.0]),
            local: DMatrix::from_column_slice(2, 1, &[1.0, m]),
            observations: -DMatrix::identity(2, 2),
        })
    };
    let a = solve(&problem, with_local).unwrap();
    let b = solve(&line(&POINTS, 0.1, 0.3), line_block).unwrap();
    // The conditions' iteration ends 6e-9 from its limit: the step before was within 1e-5 standard deviations.
    assert!((&a.global - &b.global).norm() < 1e-8);
    assert!((a.omega - b.omega).abs() < 1e-8 && a.redundancy == b.redundancy);
    // Covariances agree to first order in the residuals.
    assert!((&a.covariance - &b.covariance).norm() < 1e-2 * b.covariance.norm());
    let ca = a.adjusted_covariance(2, 0);
    let cb = b.adjusted_covariance(2, 0);
    assert!((&ca - &cb).norm() < 2e-2 * cb.norm());
}

#[test]
fn a_prior_counts_as_an_observation() {
    let mut problem = line(&POINTS, 0.1, 0.1);
    problem.priors.push(Prior::scalar("offset", 1, 1.0, 1e-9));
    let fit = solve(&problem, line_block).unwrap();
    assert!((fit.global[1] - 1.0).abs() < 1e-9 && fit.redundancy == 5);
    assert!((fit.covariance[(1, 1)].sqrt() - 1e-9).abs() < 1e-12);
}

/// A sequence of points, each solved with the information of the points before it, is equivalent to one solution of all.
#[test]
fn an_information_prior_replaces_the_observations_before_it() {
    let at_once = solve(&line(&POINTS, 1e-4, 0.3), line_block).unwrap();
    let mut before = solve(&line(&POINTS[..2], 1e-4, 0.3), line_block).unwrap();
    let mut omega = before.omega;
    for point in &POINTS[2..] {
        let known = before.information_prior();
        let next = Problem {
            known: Some(known),
            start: before.global,
            ..line(&[*point], 1e-4, 0.3)
        };
        before = solve(&next, line_block).unwrap();
        assert_eq!(before.redundancy, 1);
        omega += before.omega;
    }
    assert!((&before.global - &at_once.global).norm() < 1e-6);
    assert!((&before.covariance - &at_once.covariance).norm() < 1e-5 * at_once.covariance.norm());
    assert!(
        (omega - at_once.omega).abs() < 1e-5 * at_once.omega,
        "{omega} {}",
        at_once.omega
    );
}

/// Model y = m x, both observed with equal noise, with an x per group that scatters by half the noise: the normal matrix
/// counts the noise of x as signal, three times too much (Fuller 1987, 1.3).
#[test]
fn covariance_is_unbiased_with_noisy_amplitudes() {
    // As in a long flight: the bias of the normal matrix adds up over the groups.
    const GROUPS: usize = 400;
    let mut errors = vec![];
    for seed in 0..60 {
        let mut rng = StdRng::seed_from_u64(seed);
        // Variance 1, near enough to normal.
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let group = |_| {
            let (x, noise) = (0.5 * normal(), [normal(), normal()]);
            let observed = DVector::from_vec(vec![x + noise[0], x + noise[1]]);
            let start = DVector::from_element(1, observed[0]);
            let block = Block {
                observed,
                covariance: DMatrix::identity(2, 2),
            };
            Group {
                local: start,
                priors: vec![],
                blocks: vec![block],
            }
        };
        let problem = Problem {
            start: DVector::from_element(1, 0.5),
            missing: vec!["slope"],
            priors: vec![],
            known: None,
            groups: (0..GROUPS).map(group).collect(),
        };
        let fit = solve(&problem, |p| {
            let (m, x) = (p.global[0], p.local[0]);
            Ok(Linearised {
                misclosure: DVector::from_vec(vec![x - p.observed[0], m * x - p.observed[1]]),
                columns: vec![0],
                global: DMatrix::from_column_slice(2, 1, &[0.0, x]),
                local: DMatrix::from_column_slice(2, 1, &[1.0, m]),
                observations: -DMatrix::identity(2, 2),
            })
        });
        let fit = fit.unwrap();
        assert!(
            fit.iterations < 40,
            "seed {seed}: {} iterations",
            fit.iterations
        );
        errors.push((fit.global[0] - 1.0) / fit.covariance[(0, 0)].sqrt());
    }
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    // 60 draws determine it to 10 %. The inverse of the normal matrix gives 3.
    assert!((0.75..1.3).contains(&rms), "{rms}");
}

#[test]
fn the_missing_datum_is_named() {
    let one = line(&POINTS[..1], 0.1, 0.1);
    let error = solve(&one, line_block).unwrap_err();
    assert!(
        matches!(error, EstimationError::Singular { ref missing } if missing == "offset" || missing == "slope")
    );
}
