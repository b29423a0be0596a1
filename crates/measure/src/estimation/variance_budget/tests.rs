use super::*;
use crate::estimation::{EstimationResult, GroupPoint, Linearised, SolveOptions, solve_groups};

/// Creates a problem of three global parameters, a local one per group, and two observations per block, the second from a
/// survey.
fn problem() -> Problem {
    let block = |k: usize| Block {
        observed: DVector::from_vec(vec![0.1 * k as f64, 0.2]),
        covariance: DMatrix::from_row_slice(2, 2, &[0.01, 0.0, 0.0, 0.04]),
    };
    let group = |g: usize| Group {
        local: DVector::zeros(1),
        priors: vec![Prior::scalar("drift", 0, 0.0, 0.3)],
        blocks: (0..4).map(|k| block(g + k)).collect(),
    };
    Problem {
        start: DVector::zeros(3),
        missing: vec!["a"; 3],
        priors: vec![
            Prior::scalar("root", 0, 0.0, 0.5),
            Prior::centred(
                "lens",
                1,
                DMatrix::from_row_slice(2, 2, &[0.09, 0.02, 0.02, 0.04]),
            ),
        ],
        known: None,
        groups: (0..3).map(group).collect(),
    }
}

fn linearise(at: &GroupPoint, blocks: &mut Vec<Linearised>) -> EstimationResult<()> {
    blocks.clear();
    for (k, observed) in at.observed.iter().enumerate() {
        let (g, t) = (at.group as f64, k as f64);
        let global = DMatrix::from_row_slice(1, 3, &[1.0 + 0.2 * g, t, 0.3 - 0.1 * t * g]);
        let local = DMatrix::from_row_slice(1, 1, &[0.7 + 0.2 * t]);
        let observations = DMatrix::from_row_slice(1, 2, &[-1.0, 0.5]);
        let misclosure = &global * at.global + &local * at.local + &observations * observed;
        blocks.push(Linearised {
            misclosure,
            columns: vec![0, 1, 2],
            global,
            local,
            observations,
        });
    }
    Ok(())
}

fn observation_names(_: usize, _: usize) -> Vec<NamedObservations> {
    vec![("image", 0..1), ("survey", 1..2)]
}

/// Derivatives of a function of all unknowns of group 1.
fn gradient() -> Gradient {
    Gradient {
        columns: vec![2, 0],
        global: DMatrix::from_column_slice(2, 1, &[0.4, 1.0]),
        local: DMatrix::from_element(1, 1, 0.6),
        observed: vec![(2, DMatrix::from_column_slice(2, 1, &[0.3, -0.8]))],
    }
}

fn value(problem: &Problem) -> f64 {
    let fit = solve_groups(problem, &SolveOptions::default(), linearise).unwrap();
    let seen = &problem.groups[1].blocks[2].observed + &fit.groups[1].blocks[2].residuals;
    0.4 * fit.global[2] + fit.global[0] + 0.6 * fit.groups[1].local[0] + 0.3 * seen[0]
        - 0.8 * seen[1]
}

/// Compares each contribution with the effect of changing its source by one standard deviation.
#[test]
fn each_contribution_matches_the_effect_of_its_errors() {
    let problem = problem();
    let fit = solve_groups(&problem, &SolveOptions::default(), linearise).unwrap();
    let naming = SourceNames {
        observations: &observation_names,
        known: "earlier",
        rest: "image",
    };
    let parts = VarianceSources::new(&problem, &fit, naming, None).contributions(1, &gradient());
    let nominal = value(&problem);
    let done = |change: &dyn Fn(&mut Problem, f64), covariance: f64| {
        let mut other = problem.clone();
        change(&mut other, 1e-3);
        ((value(&other) - nominal) / 1e-3).powi(2) * covariance
    };
    let mut expected = [
        ("image", 0.0),
        ("survey", 0.0),
        ("drift", 0.0),
        ("root", 0.0),
    ];
    for g in 0..3 {
        for k in 0..4 {
            expected[0].1 += done(&|p, by| p.groups[g].blocks[k].observed[0] += by, 0.01);
            expected[1].1 += done(&|p, by| p.groups[g].blocks[k].observed[1] += by, 0.04);
        }
        expected[2].1 += done(&|p, by| p.groups[g].priors[0].mean[0] += by, 0.09);
    }
    expected[3].1 = done(&|p, by| p.priors[0].mean[0] += by, 0.25);
    for (source, variance) in expected {
        let part = parts.iter().find(|part| part.source == source).unwrap();
        assert!(
            (part.variance / variance - 1.0).abs() < 1e-6,
            "{source}: {} {variance}",
            part.variance
        );
    }
    let sum: f64 = parts.iter().map(|part| part.variance).sum();
    let all = fit.function_variances(1, &gradient())[0];
    assert!((sum / all - 1.0).abs() < 1e-9, "{sum} {all}");
}

#[test]
fn variance_if_known_equals_that_of_a_narrow_prior() {
    let mut problem = problem();
    let fit = solve_groups(&problem, &SolveOptions::default(), linearise).unwrap();
    let naming = SourceNames {
        observations: &observation_names,
        known: "earlier",
        rest: "image",
    };
    let parts = VarianceSources::new(&problem, &fit, naming, None).contributions(1, &gradient());
    let of = |source| {
        parts
            .iter()
            .find(|part| part.source == source)
            .unwrap()
            .if_known
    };
    let known = of("root").unwrap();
    assert_eq!(of("image"), None);
    problem.priors[0].covariance[(0, 0)] = 1e-14;
    let narrow = solve_groups(&problem, &SolveOptions::default(), linearise)
        .unwrap()
        .function_variances(1, &gradient())[0];
    assert!((known / narrow - 1.0).abs() < 1e-6, "{known} {narrow}");
}

#[test]
fn information_priors_keep_the_names_of_their_sources() {
    let problem = problem();
    let fit = solve_groups(&problem, &SolveOptions::default(), linearise).unwrap();
    let naming = SourceNames {
        observations: &observation_names,
        known: "earlier",
        rest: "image",
    };
    let attributed =
        AttributedInformation::from_solution(&problem, &fit, |column| column == 0, 0, &naming);
    let next = Problem {
        priors: vec![],
        known: Some(fit.information_prior()),
        groups: vec![problem.groups[1].clone()],
        ..problem.clone()
    };
    let at = |at: &GroupPoint, blocks: &mut Vec<Linearised>| {
        linearise(&GroupPoint { group: 1, ..*at }, blocks)
    };
    let solved = solve_groups(&next, &SolveOptions::default(), at).unwrap();
    let parts = VarianceSources::new(&next, &solved, naming, Some(&attributed))
        .contributions(0, &gradient());
    let sum: f64 = parts.iter().map(|part| part.variance).sum();
    let all = solved.function_variances(0, &gradient())[0];
    assert!((sum / all - 1.0).abs() < 1e-9, "{sum} {all}");
    assert!(
        parts
            .iter()
            .any(|p| p.source == "root" && p.if_known.is_some())
    );
    assert!(
        parts
            .iter()
            .any(|p| p.source == "earlier" && p.variance > 0.0)
    );
    assert!(parts.iter().all(|p| p.source != "lens"));
}
