//! Precision of a single frame with the prior from none to five flights.

use wingd::measure::adjust::Solution;

use crate::aircraft::{EffectErrors, SET_UPS};
use crate::common::beam_truth::{median, rng};
use crate::learning::{
    FRAMES, SampledAircraft, SampledFlight, bound_m, combine_flights, print_errors,
};

fn budgets(all: &[Solution]) -> Vec<(String, f64)> {
    let mut sum: Vec<(String, f64)> = vec![];
    for share in all
        .iter()
        .filter_map(|s| s.budget.as_ref())
        .flat_map(|b| &b.shares)
    {
        match sum.iter_mut().find(|(source, _)| *source == share.source) {
            Some((_, total)) => *total += share.share / all.len() as f64,
            None => sum.push((share.source.to_string(), share.share / all.len() as f64)),
        }
    }
    sum.sort_by(|a, b| b.1.total_cmp(&a.1));
    sum.into_iter()
        .map(|(source, share)| (source, (100.0 * share).round()))
        .filter(|s| s.1 > 0.0)
        .collect()
}

/// Prints the table of docs/adjustment/learning.md; options: `WINGS=40 SEED=1 SET_UP=Default`.
pub fn print_flight_priors() {
    let word = |name: &str| std::env::var(name).unwrap_or_default();
    let number = |name: &str, usual: usize| word(name).parse().unwrap_or(usual);
    let wanted = word("SET_UP");
    for set_up in SET_UPS
        .into_iter()
        .filter(|s| wanted.is_empty() || format!("{s:?}") == wanted)
    {
        let mut rng = rng(number("SEED", 8100) as u64);
        let mut shown: [EffectErrors; 5] = Default::default();
        let mut solved: [Vec<Solution>; 5] = Default::default();
        let mut bounds_m: [Vec<f64>; 3] = Default::default();
        let mut refused = 0;
        for _ in 0..number("WINGS", 40) {
            let mut drawn = SampledAircraft::new(&mut rng, set_up);
            let flights: Vec<SampledFlight> = (0..5)
                .map(|_| drawn.sample_flight(&mut rng, FRAMES))
                .collect();
            let normals_of_flights = drawn.flight_normals(&flights);
            refused += 5 - normals_of_flights.len();
            let last = drawn.sample_flight(&mut rng, 1);
            let of = |n: usize| {
                combine_flights(
                    &normals_of_flights[..n.min(normals_of_flights.len())],
                    &drawn.setup,
                )
            };
            let prior = [None, of(1), of(2), of(3), of(5)];
            let bound = bound_m(&drawn, &normals_of_flights[0], &last.seen[0]);
            bounds_m
                .iter_mut()
                .zip(bound)
                .for_each(|(all, one)| all.push(one));
            for (k, prior) in prior.into_iter().enumerate() {
                let solution = drawn.solve_single_frame(&last.seen[0], prior);
                shown[k].add(&drawn.aircraft, drawn.now, &solution, &drawn.setup);
                solved[k].push(solution);
            }
        }
        println!("{set_up:?}, {refused} flights contributed nothing");
        for (k, name) in ["alone", "1 flight", "2", "3", "5"].iter().enumerate() {
            print_errors(name, &shown[k]);
            let inconsistent = solved[k]
                .iter()
                .filter(|s| s.remarks.iter().any(|r| r.contains("is inconsistent")))
                .count();
            let out = solved[k]
                .iter()
                .filter(|s| s.remarks.iter().any(|r| r.contains("was removed")))
                .count();
            println!(
                "    {:?}, contradicted {inconsistent}, with markers excluded {out}",
                budgets(&solved[k])
            );
        }
        println!("bound: {:.1?} mm", bounds_m.map(|all| 1e3 * median(&all)));
    }
}
