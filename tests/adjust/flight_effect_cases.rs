//! Kinds of what an aircraft does, one by one: at the sizes that must hold, and at those that must be noticed.

use nalgebra::{Vector2, Vector3};
use rand::Rng;
use rand::rngs::StdRng;

use crate::aircraft::{Drawn, SET_UPS, SetUp, Shown, all_together, draw};
use crate::common::beam_truth::{Effects, median, rms};

/// A kind of effect.
struct Kind {
    name: &'static str,
    /// Times the size in the name that the standard deviations must cover; 0: none.
    holds: f64,
    /// Times it that must be rejected, remarked on, or covered to 2; 0: none.
    named: f64,
    /// Drawn at so many times the size in the name.
    draw: fn(&mut StdRng, f64) -> Effects,
}

const fn kind(name: &'static str, named: f64, draw: fn(&mut StdRng, f64) -> Effects) -> Kind {
    Kind { name, holds: 1.0, named, draw }
}

fn sign(rng: &mut StdRng) -> f64 {
    if rng.random::<bool>() { 1.0 } else { -1.0 }
}

const KINDS: [Kind; 24] = [
    kind("all together", 0.0, |r, _| all_together(r)),
    kind("nothing", 0.0, |_, _| Effects::default()),
    kind("bent on ground, 10 mm", 2.0, |r, by| Effects {
        ground_bend_m: 0.010 * by * sign(r),
        ..Effects::default()
    }),
    kind("root turns, 0.2 mrad", 5.0, |r, by| Effects {
        root_rotation_rad: Vector3::z() * (2e-4 * by * sign(r)),
        ..Effects::default()
    }),
    kind("root rises, 1 mm", 3.0, |r, by| Effects {
        root_translation_m: Vector3::y() * (0.001 * by * sign(r)),
        ..Effects::default()
    }),
    kind("root moves out, 1 mm", 3.0, |r, by| Effects {
        root_translation_m: Vector3::x() * (0.001 * by * sign(r)),
        ..Effects::default()
    }),
    kind("skin bulges at the root, 0.5 mm", 6.0, |r, by| Effects {
        bulge_m: 5e-4 * by * sign(r),
        ..Effects::default()
    }),
    kind("skin at each marker, 0.3 mm", 10.0 / 3.0, |_, by| Effects {
        skin_m: 3e-4 * by,
        ..Effects::default()
    }),
    kind("fixed marks rise, 0.5 mm", 4.0, |r, by| Effects {
        fixed_m: Vector3::y() * (5e-4 * by * sign(r)),
        ..Effects::default()
    }),
    kind("fixed marks move each, 0.5 mm", 4.0, |_, by| Effects {
        fixed_each_m: 5e-4 * by,
        ..Effects::default()
    }),
    kind("flight scale, 2e-4", 5.0, |r, by| Effects {
        flight_scale: 2e-4 * by * sign(r),
        ..Effects::default()
    }),
    kind("principal point, 0.3 px", 10.0 / 3.0, |r, by| Effects {
        principal_px: Vector2::new(sign(r), sign(r)) * (0.3 * by),
        ..Effects::default()
    }),
    kind("refraction, 2e-4", 0.0, |_, by| Effects { refraction: 2e-4 * by, ..Effects::default() }),
    kind("bow, 30 m", 3.0, |_, by| Effects { bow_per_m: by / 30.0, ..Effects::default() }),
    kind("in the plane, 20 mm", 0.0, |r, by| Effects {
        in_plane_m: 0.020 * by * sign(r),
        ..Effects::default()
    }),
    Kind {
        holds: 0.0,
        ..kind("aileron, 1 degree", 1.0, |r, by| Effects {
            aileron_rad: 0.0175 * by * sign(r),
            ..Effects::default()
        })
    },
    kind("vibration, 1 cm at 3 Hz, 30 ms", 3.0, |_, by| Effects {
        vibration: (0.01 * by, 3.0),
        readout_s: 0.03,
        ..Effects::default()
    }),
    kind("shake, 0.03 mrad at 15 Hz, 30 ms", 0.0, |_, by| Effects {
        shake: (3e-5 * by, 15.0),
        readout_s: 0.03,
        ..Effects::default()
    }),
    kind("entrance pupil, 10 mm", 2.0, |r, by| Effects {
        pupil_m: 0.010 * by * sign(r),
        ..Effects::default()
    }),
    kind("survey's vertical, 0.1 degree", 5.0, |r, by| Effects {
        tilt_rad: Vector2::new(sign(r), sign(r)) * (0.1f64.to_radians() * by / 2f64.sqrt()),
        ..Effects::default()
    }),
    kind("torque, 1 degree", 2.0, |r, by| Effects {
        torque_rad: 0.0175 * by * sign(r),
        ..Effects::default()
    }),
    kind("step of stiffness, 20 %", 0.0, |r, by| Effects { step: 0.2 * by * sign(r), ..Effects::default() }),
    kind("kink, 1 mrad", 0.0, |r, by| Effects { kink_rad: 1e-3 * by * sign(r), ..Effects::default() }),
    kind("engine, 10 %", 0.0, |_, by| Effects { engine: 0.1 * by, ..Effects::default() }),
];

/// What to draw, as the environment says: `WINGS=100 FRAMES=1,5,20 SET_UP=Stayed KIND=torque SEED=7000 TIMES=1` to taste.
struct Asked {
    wings: usize,
    frames: Vec<usize>,
    times: f64,
    seed: u64,
}

fn word(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

impl Asked {
    fn new() -> Self {
        let number = |name: &str, usual: f64| word(name).parse().unwrap_or(usual);
        let frames = Some(word("FRAMES")).filter(|f| !f.is_empty()).unwrap_or("1,5".into());
        Self {
            wings: number("WINGS", 8.0) as usize,
            frames: frames.split(',').map(|f| f.parse().expect("a number of frames")).collect(),
            times: number("TIMES", 1.0),
            seed: number("SEED", 4000.0) as u64,
        }
    }

    /// Frames, set-up and kind of each row, with its seed.
    fn rows(&self) -> impl Iterator<Item = (usize, SetUp, &'static Kind, u64)> + '_ {
        let (set_ups, kinds) = (word("SET_UP"), word("KIND"));
        let wanted = move |s: &SetUp| set_ups.is_empty() || set_ups.split(',').any(|w| w == format!("{s:?}"));
        let set_ups: Vec<_> = SET_UPS.into_iter().filter(wanted).collect();
        let all = move |set_up| KINDS.iter().enumerate().map(move |(k, kind)| (set_up, k, kind));
        let of = move |frames: usize| {
            let rows = set_ups.clone().into_iter().flat_map(all);
            rows.map(move |(set_up, k, kind)| (frames, set_up, kind, self.seed + k as u64))
        };
        let moves_marks = |kind: &Kind| kind.name.starts_with("fixed marks");
        self.frames.iter().flat_map(move |frames| of(*frames)).filter(move |(_, set_up, kind, _)| {
            kind.name.contains(&kinds) && (*set_up == SetUp::Fixed || !moves_marks(kind))
        })
    }
}

/// Of one kind with all that holds its standard deviations: `WINGS=40 FRAMES=20 KIND=torque SET_UP=Stayed cargo test --release
/// --test adjust -- --ignored table_of_what --nocapture`.
#[test]
#[ignore = "minutes; a table for docs/model.md"]
fn table_of_what_an_aircraft_does() {
    let asked = Asked::new();
    for (frames, set_up, kind, seed) in asked.rows() {
        let shown = draw(seed, set_up, frames, asked.wings, |rng| (kind.draw)(rng, asked.times)).all;
        println!(
            "{frames:3} {set_up:?}: {}: deflections {:.2?}, twist {:.2}, moment {:.2}, sigmas of the tip {:.1?} mm, errors {:.1?} mm, passed {:.0} %; {}",
            kind.name,
            shown.deflections.each_ref().map(|deflections| rms(deflections)),
            rms(&shown.twist),
            rms(&shown.moments),
            shown.tip_sigmas_m.each_ref().map(|sigmas| 1e3 * median(sigmas)),
            shown.tip_errors_m.each_ref().map(|errors| 1e3 * rms(errors)),
            100.0 * shown.passed.iter().sum::<f64>() / shown.passed.len() as f64,
            shown.budget()
        );
    }
}

/// The largest of the three deflections, twist and moment, errors over standard deviations.
fn figures(shown: &Shown) -> [f64; 3] {
    let deflection = shown.deflections.iter().map(|deflections| rms(deflections)).fold(0.0, f64::max);
    [deflection, rms(&shown.twist), rms(&shown.moments)]
}

/// The table of docs/validation, a line for each number of frames, set-up and kind: the sizes that must hold, then those that
/// must be noticed. What does not hold is marked. `WINGS=100 FRAMES=1,5 SEED=9500`, and `WINGS=40 FRAMES=20`.
#[test]
#[ignore = "an hour; the table of docs/validation"]
fn table_of_kinds() {
    let asked = Asked::new();
    let mark = |fails: bool| if fails { " !" } else { "" };
    for (frames, set_up, kind, seed) in asked.rows() {
        let at = |times: f64| draw(seed, set_up, frames, asked.wings, |rng| (kind.draw)(rng, times));
        let holds = (kind.holds > 0.0).then(|| {
            let Drawn { all, said, .. } = at(kind.holds);
            let [deflection, twist, moment] = figures(&all);
            let fails = deflection > 1.3 || twist > 1.5 || moment > 1.5;
            let said = 100.0 * said;
            format!("{deflection:.2} | {twist:.2} | {moment:.2} | {said:.0} %{}", mark(fails))
        });
        let named = (kind.named > 0.0).then(|| {
            let Drawn { unsaid, said, .. } = at(kind.named);
            let [deflection, twist, moment] = figures(&unsaid);
            let fails = [deflection, twist, moment].iter().any(|f| *f > 2.0);
            let said = 100.0 * said;
            format!("{deflection:.2} | {twist:.2} | {moment:.2} | {said:.0} %{}", mark(fails))
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

/// Deflections alone: what passes for pitch, for bending, or for a root that turns, only widths hold.
#[test]
fn what_no_picture_tells_is_as_wide_as_it_may_be() {
    let kinds = [
        ("kink", SetUp::Default, 1.0, 1.3),
        ("root turns", SetUp::Stayed, 5.0, 2.0),
        ("skin bulges", SetUp::Stayed, 6.0, 2.0),
    ];
    for (name, set_up, times, most) in kinds {
        let kind = KINDS.iter().find(|kind| kind.name.starts_with(name)).unwrap();
        let shown = draw(9700, set_up, 5, 24, |rng| (kind.draw)(rng, times)).all;
        let [deflection, ..] = figures(&shown);
        println!("{} times {times}, {set_up:?}: {deflection:.2}", kind.name);
        assert!(deflection < most, "{} times {times}, {set_up:?}: {deflection:.2}", kind.name);
    }
}
