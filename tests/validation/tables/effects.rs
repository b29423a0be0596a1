//! In-flight effects: all figures of a kind, and all kinds at the sizes that must be covered or detected.

use crate::aircraft::{SET_UPS, SampledErrors, SetUp, sample_errors};
use crate::builds::BUILDS;
use crate::common::beam_truth::{median, rms};
use crate::effect_kinds::{CLAIMS, KINDS, Kind, figures};
use crate::live::{CHECKED, sample_live_errors};

/// Table options from the environment: `WINGS=100 FRAMES=1,5,20 SET_UP=Stayed KIND=torque|gull SEED=7000
/// TIMES=1`.
struct TableOptions {
    wings: usize,
    frames: Vec<usize>,
    times: f64,
    seed: u64,
}

fn word(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

impl TableOptions {
    fn new() -> Self {
        let number = |name: &str, usual: f64| word(name).parse().unwrap_or(usual);
        let frames = Some(word("FRAMES"))
            .filter(|f| !f.is_empty())
            .unwrap_or("1,5".into());
        Self {
            wings: number("WINGS", 8.0) as usize,
            frames: frames
                .split(',')
                .map(|f| f.parse().expect("a number of frames"))
                .collect(),
            times: number("TIMES", 1.0),
            seed: number("SEED", 4000.0) as u64,
        }
    }

    fn set_ups(&self) -> Vec<SetUp> {
        let names = word("SET_UP");
        let is_selected =
            |s: &SetUp| names.is_empty() || names.split(',').any(|w| w == format!("{s:?}"));
        SET_UPS.into_iter().filter(is_selected).collect()
    }

    /// Frames, set-up and kind of each row, with its seed.
    fn rows(&self) -> impl Iterator<Item = (usize, SetUp, &'static Kind, u64)> + '_ {
        let (set_ups, kinds) = (self.set_ups(), word("KIND"));
        let all = move |set_up| {
            KINDS
                .iter()
                .chain(&BUILDS)
                .chain(&CLAIMS)
                .enumerate()
                .map(move |(k, kind)| (set_up, k, kind))
        };
        let of = move |frames: usize| {
            let rows = set_ups.clone().into_iter().flat_map(all);
            rows.map(move |(set_up, k, kind)| (frames, set_up, kind, self.seed + k as u64))
        };
        let applies = |set_up: SetUp, kind: &Kind| match kind.name {
            name if name.starts_with("fixed targets") => set_up == SetUp::Fixed,
            name if name.starts_with("stayed") => set_up == SetUp::Stayed,
            name if name.starts_with("1 px stated") || name.starts_with("remounted") => {
                set_up != SetUp::Stayed
            }
            _ => true,
        };
        self.frames
            .iter()
            .flat_map(move |frames| of(*frames))
            .filter(move |(_, set_up, kind, _)| {
                kinds.split('|').any(|k| kind.name.contains(k)) && applies(*set_up, kind)
            })
    }
}

/// Prints each kind with all its figures, for example with `WINGS=40 FRAMES=20 KIND=torque SET_UP=Stayed`.
pub fn print_effects() {
    let asked = TableOptions::new();
    for (frames, set_up, kind, seed) in asked.rows() {
        let shown = sample_errors(seed, set_up, frames, asked.wings, |rng| {
            (kind.draw)(rng, asked.times)
        })
        .all;
        println!(
            "{frames:3} {set_up:?}: {}: deflections {:.2?}, twist {:.2}, moment {:.2}, sigmas of the tip {:.1?} mm, errors {:.1?} mm, passed {:.0} %; {}",
            kind.name,
            shown
                .deflections
                .each_ref()
                .map(|deflections| rms(deflections)),
            rms(&shown.twist),
            rms(&shown.moments),
            shown
                .tip_sigmas_m
                .each_ref()
                .map(|sigmas| 1e3 * median(sigmas)),
            shown
                .tip_errors_m
                .each_ref()
                .map(|errors| 1e3 * rms(errors)),
            100.0 * shown.passed.iter().sum::<f64>() / shown.passed.len() as f64,
            shown.budget()
        );
    }
}

/// Prints the table of docs/validation/data, one line per number of frames, set-up and kind: first the sizes that sigma must cover, then those
/// that must be detected. Failures are marked. `WINGS=100 FRAMES=1,5 SEED=9500`, and `WINGS=40 FRAMES=20`.
pub fn print_kinds() {
    let asked = TableOptions::new();
    let mark = |fails: bool| if fails { " !" } else { "" };
    for (frames, set_up, kind, seed) in asked.rows() {
        let at = |times: f64| {
            sample_errors(seed, set_up, frames, asked.wings, |rng| {
                (kind.draw)(rng, times)
            })
        };
        let holds = (kind.holds > 0.0).then(|| {
            let SampledErrors {
                all,
                reported_fraction,
                ..
            } = at(kind.holds);
            let [deflection, twist, moment] = figures(&all);
            let fails = deflection > 1.3 || twist > 1.5 || moment > 1.5;
            let reported_fraction = 100.0 * reported_fraction;
            format!(
                "{deflection:.2} | {twist:.2} | {moment:.2} | {reported_fraction:.0} %{}",
                mark(fails)
            )
        });
        let named = (kind.named > 0.0).then(|| {
            let SampledErrors {
                unreported,
                reported_fraction,
                ..
            } = at(kind.named);
            let [deflection, twist, moment] = figures(&unreported);
            let fails = [deflection, twist, moment].iter().any(|f| *f > 2.0);
            let reported_fraction = 100.0 * reported_fraction;
            format!(
                "{deflection:.2} | {twist:.2} | {moment:.2} | {reported_fraction:.0} %{}",
                mark(fails)
            )
        });
        let none = || " | | | ".to_string();
        println!(
            "| {} | {frames} | {set_up:?} | {} | {} |",
            kind.name,
            holds.unwrap_or_else(none),
            named.unwrap_or_else(none)
        );
    }
}

/// Prints deflection, twist and moment of live frames over their standard deviations, for example with `WINGS=100
/// SET_UP=Stayed SEED=308`.
pub fn print_live() {
    let asked = TableOptions::new();
    for set_up in asked.set_ups() {
        for (frame, errors) in
            CHECKED
                .iter()
                .zip(&sample_live_errors(asked.seed, set_up, asked.wings))
        {
            let [deflection, twist, moment] = figures(errors);
            println!(
                "| {} | {set_up:?} | {deflection:.2} | {twist:.2} | {moment:.2} |",
                frame + 1
            );
        }
    }
}
