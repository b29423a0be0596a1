//! Promise: for any mutation of an installation, a frame, a file of manual observations or a configuration, the commands
//! end within seconds, with a result or with a reason. Not part of the default run: `make test-mutations`.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use rand::prelude::*;
use rand::rngs::StdRng;
use wingd::measure::raster::Raster;
use wingd::pipeline::decode::decode_image;

/// Longest processor time of a command; wall-clock time depends on other load.
const LIMIT: Duration = Duration::from_secs(15);
/// Wall-clock time after which a command is ended: under load and `nice` a second may take a minute.
const GIVEN_UP: Duration = Duration::from_secs(600);
/// Number of mutations without `WINGD_MUTATIONS`.
const USUAL: u64 = 400;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures")
        .join(name)
}

/// Replacements of a number in a file.
const NUMBERS: [&str; 24] = [
    "0",
    "-0.0",
    "-1",
    "1",
    "1e-300",
    "1e300",
    "-1e300",
    "nan",
    "inf",
    "-inf",
    "1e-9",
    "1e9",
    "0.5",
    "3.14",
    "100",
    "1000",
    "4294967296",
    "9223372036854775808",
    "-2147483649",
    "1e",
    ".",
    "",
    "\"1\"",
    "[1]",
];

/// Positions of the numbers in a text.
fn numbers(text: &str) -> Vec<std::ops::Range<usize>> {
    let part = |c: char| c.is_ascii_digit() || c == '.';
    let mut found: Vec<std::ops::Range<usize>> = vec![];
    for (at, c) in text.char_indices().filter(|(_, c)| part(*c)) {
        match found.last_mut().filter(|last| last.end == at) {
            Some(last) => last.end = at + c.len_utf8(),
            None => found.push(at..at + c.len_utf8()),
        }
    }
    found
}

/// Replaces a number: mostly by a plausible one, in another unit, of another sign, slightly changed; or a special one.
fn other_number(rng: &mut StdRng, old: &str) -> String {
    match (rng.random_range(0..6), old.parse::<f64>()) {
        (0..=2, Ok(value)) => {
            let factors = [1e3, 1e-3, -1.0, 0.3048, 25.4, 1.1, 10.0, 57.29578];
            (value * factors.choose(rng).unwrap()).to_string()
        }
        (3 | 4, Ok(value)) => {
            (value + value.abs().max(0.01) * rng.random_range(-0.3..0.3)).to_string()
        }
        _ => (*NUMBERS.choose(rng).unwrap()).to_owned(),
    }
}

/// A line removed, duplicated or moved.
fn other_lines(rng: &mut StdRng, text: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let at = rng.random_range(0..lines.len());
    let line = lines[at];
    match rng.random_range(0..3) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(at, line),
        _ => {
            lines.remove(at);
            lines.insert(rng.random_range(0..=lines.len()), line);
        }
    }
    lines.join("\n")
}

fn mutate_text(rng: &mut StdRng, text: &str) -> Vec<u8> {
    let mut text = text.to_owned();
    for _ in 0..rng.random_range(1..=3) {
        let places = numbers(&text);
        match rng.random_range(0..12) {
            0..=7 if !places.is_empty() => {
                let at = places.choose(rng).unwrap().clone();
                let new = other_number(rng, &text[at.clone()]);
                text.replace_range(at, &new);
            }
            8 | 9 if places.len() > 1 => {
                let (a, b) = (
                    places.choose(rng).unwrap().clone(),
                    places.choose(rng).unwrap().clone(),
                );
                let new = text[b].to_owned();
                text.replace_range(a, &new);
            }
            10 if !text.is_empty() => text = other_lines(rng, &text),
            _ => return mutate_bytes(rng, text.into_bytes()),
        }
    }
    text.into_bytes()
}

/// A part of an image black, white, noisy, copied elsewhere, or mirrored; a few of these.
fn mutate_picture(rng: &mut StdRng, of: &Raster) -> Vec<u8> {
    let (w, h) = (of.width(), of.height());
    let mut luma = of.luma().to_vec();
    for _ in 0..rng.random_range(1..=6) {
        // Most of the wing takes a few hundred pixels; some mutations take all of it.
        let side = if rng.random_bool(0.1) {
            w
        } else {
            rng.random_range(8..600)
        };
        let (width, height) = (side.min(w), rng.random_range(8..=side).min(h));
        let at = |rng: &mut StdRng| {
            (
                rng.random_range(0..=w - width),
                rng.random_range(0..=h - height),
            )
        };
        let ((u, v), (from_u, from_v)) = (at(rng), at(rng));
        let (kind, grey) = (rng.random_range(0..5), rng.random::<u8>());
        let source = luma.clone();
        for y in 0..height {
            for x in 0..width {
                luma[(v + y) * w + u + x] = match kind {
                    0 => grey,
                    1 => rng.random(),
                    2 => source[(from_v + y) * w + from_u + x],
                    3 => source[(v + y) * w + u + width - 1 - x],
                    _ => source[(v + height - 1 - y) * w + u + x],
                };
            }
        }
    }
    [format!("P5\n{w} {h}\n255\n").as_bytes(), &luma].concat()
}

fn mutate_bytes(rng: &mut StdRng, mut bytes: Vec<u8>) -> Vec<u8> {
    let n = bytes.len().max(2);
    // Headers are short and the most sensitive part.
    let place = |rng: &mut StdRng| {
        if rng.random() {
            rng.random_range(0..n)
        } else {
            rng.random_range(0..n.min(700))
        }
    };
    for _ in 0..rng.random_range(1..=4) {
        let at = place(rng).min(bytes.len().saturating_sub(1));
        let end = (at + rng.random_range(1..200)).min(bytes.len());
        match rng.random_range(0..6) {
            0 | 1 if at < bytes.len() => bytes[at] = rng.random(),
            2 => drop(bytes.drain(at..end)),
            3 => bytes[at..end].fill(0),
            4 => {
                let again = bytes[at..end].to_vec();
                bytes.splice(at..at, again);
            }
            _ => bytes.truncate(place(rng)),
        }
    }
    bytes
}

/// The folder of all mutations, in its sound state.
struct Bench {
    folder: tempfile::TempDir,
    sound: Vec<(&'static str, Vec<u8>)>,
}

/// Mutated in their bytes as files, in their pixels as images.
const GROUND_PICTURE: &str = "image of ground.jpg";
const FLIGHT_PICTURE: &str = "image of flight.jpg";

/// Mutated files, with the commands that read them.
const KINDS: [(&str, &[&str]); 10] = [
    (
        "i/installation.toml",
        &["check", "solve-by-hand", "plan", "orient"],
    ),
    (
        "i/survey.csv",
        &["check", "solve-by-hand", "plan", "orient"],
    ),
    (
        "i/camera.toml",
        &["check", "solve-by-hand", "plan", "orient"],
    ),
    ("i/orientation.toml", &["check", "solve-by-hand", "solve"]),
    ("ground.jpg", &["orient"]),
    ("flight.jpg", &["solve"]),
    (GROUND_PICTURE, &["orient"]),
    (FLIGHT_PICTURE, &["solve"]),
    ("hand.csv", &["solve-by-hand", "solve-profile"]),
    ("wingd.toml", &["check-config"]),
];

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("i")).unwrap();
        for name in ["installation.toml", "camera.toml", "survey.csv"] {
            std::fs::copy(fixture("dev/installation").join(name), path("i").join(name)).unwrap();
        }
        std::fs::copy(fixture("dev/frames/ground.jpg"), path("ground.jpg")).unwrap();
        std::fs::copy(fixture("dev/frames/flight-1.jpg"), path("flight.jpg")).unwrap();
        let text = "installation = \"i\"\n[camera]\nkind = \"replay\"\nfolder = \"frames\"\n[series]\ninterval = \"1h\"\n\
                    shots = 10\n[store]\npath = \"store\"\nreserve_mb = 1000\n[solve]\nmethod = \"spatial\"\n\
                    deadline = \"60s\"\n";
        std::fs::write(path("wingd.toml"), text).unwrap();
        std::fs::create_dir(path("frames")).unwrap();
        std::fs::copy(fixture("jpeg/baseline-2x1.jpg"), path("frames/1.jpg")).unwrap();
        std::fs::write(path("hand.csv"), "").unwrap();
        let bench = Self {
            folder,
            sound: vec![],
        };
        assert_eq!(bench.run("orient").0, Some(0));
        bench.remove_digests();
        let (_, solved, _) = bench.run("solve");
        std::fs::write(bench.path("hand.csv"), manual(&solved)).unwrap();
        let files = KINDS
            .iter()
            .map(|(name, _)| *name)
            .filter(|name| ![GROUND_PICTURE, FLIGHT_PICTURE].contains(name));
        let sound = files
            .map(|name| (name, std::fs::read(bench.path(name)).unwrap()))
            .collect();
        Self { sound, ..bench }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Removes the digests of an orientation, so that a changed survey is read.
    fn remove_digests(&self) {
        let path = self.path("i/orientation.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        let (from, to) = (
            text.find("[made_with]").unwrap(),
            text.find("[[image]]").unwrap(),
        );
        std::fs::write(path, [&text[..from], &text[to..]].concat()).unwrap();
    }

    fn mutate(&self, rng: &mut StdRng, name: &str) {
        let file = name.strip_prefix("image of ").unwrap_or(name);
        let sound = &self
            .sound
            .iter()
            .find(|(other, _)| *other == file)
            .unwrap()
            .1;
        let mutated = match std::str::from_utf8(sound) {
            Ok(text) => mutate_text(rng, text),
            Err(_) if file != name => mutate_picture(rng, &decode_image(sound, None).unwrap()),
            Err(_) => mutate_bytes(rng, sound.clone()),
        };
        std::fs::write(self.path(file), mutated).unwrap();
    }

    /// Exit status (`None`: a signal, or no end in time), both outputs, processor time.
    fn run(&self, command: &str) -> (Option<i32>, String, Duration) {
        let arguments: &[&str] = match command {
            "check" => &["check", "--installation", "i"],
            "check-config" => &["check", "--config", "wingd.toml"],
            "plan" => &["plan", "--json", "--installation", "i"],
            "orient" => &["orient", "--json", "--installation", "i", "ground.jpg"],
            "solve" => &["solve", "--json", "--installation", "i", "flight.jpg"],
            "solve-profile" => &[
                "solve",
                "--json",
                "--method",
                "profile",
                "--installation",
                "i",
                "--observations",
                "hand.csv",
            ],
            _ => &[
                "solve",
                "--json",
                "--installation",
                "i",
                "--observations",
                "hand.csv",
            ],
        };
        let printed = self.path("said");
        let output = File::create(&printed).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_wingd"));
        let child = child.args(arguments).current_dir(self.folder.path());
        let mut child = child
            .stderr(output.try_clone().unwrap())
            .stdout(output)
            .spawn()
            .unwrap();
        let (started, before) = (Instant::now(), children_time());
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status.code(),
                None if started.elapsed() > GIVEN_UP => {
                    child.kill().unwrap();
                    child.wait().unwrap();
                    break None;
                }
                None => std::thread::sleep(Duration::from_millis(2)),
            }
        };
        let text = String::from_utf8_lossy(&std::fs::read(printed).unwrap()).into_owned();
        (status, text, children_time().saturating_sub(before))
    }
}

/// Processor time of all children that have ended (`man 5 proc_pid_stat`, fields 16 and 17, in hundredths).
fn children_time() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let after_name = stat.rsplit(')').next().unwrap();
    let ticks: u64 = after_name
        .split_whitespace()
        .skip(13)
        .take(2)
        .map(|f| f.parse::<u64>().unwrap())
        .sum();
    Duration::from_millis(10 * ticks)
}

/// Measured markers of a frame as manual observations.
fn manual(solved: &str) -> String {
    let record: serde_json::Value = serde_json::from_str(solved.lines().next().unwrap()).unwrap();
    let line = |m: &serde_json::Value| {
        format!(
            "{},{},{},0.2\n",
            m["id"].as_str().unwrap(),
            m["u_px"],
            m["v_px"]
        )
    };
    let seen = record["markers"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|m| !m["u_px"].is_null());
    "id,u_px,v_px,sigma_px\n".to_owned() + &seen.map(line).collect::<String>()
}

/// The error of an ending, if any.
fn check_ending(
    command: &str,
    (status, printed, time): &(Option<i32>, String, Duration),
) -> Option<String> {
    let Some(status) = status else {
        return Some("no end in time, or a signal".into());
    };
    let crashed = ["panicked", "internal error", "decoder failed", "crashed"]
        .iter()
        .any(|word| printed.contains(word));
    if crashed || ![0, 1, 2, 78].contains(status) {
        return Some(format!("exit {status}"));
    }
    if *time > LIMIT {
        return Some(format!("{time:?}"));
    }
    // One of our type names with a list of fields is debug text.
    let of_ours = |before: &str| {
        let name = before
            .rsplit(|c: char| !c.is_ascii_alphanumeric())
            .next()
            .unwrap_or_default();
        name.starts_with(|c: char| c.is_ascii_uppercase())
    };
    let parts: Vec<&str> = printed.split(" { ").collect();
    if parts[..parts.len() - 1]
        .iter()
        .any(|before| of_ours(before))
        || printed.contains("Some(")
    {
        return Some("debug text".into());
    }
    let json = || {
        printed
            .lines()
            .find_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
    };
    let sound = match (status, command) {
        (0, "solve" | "solve-by-hand" | "solve-profile") => json().is_some_and(|record| {
            let sigma = record["tip"]["sigma_deflection_m"].as_f64();
            record["status"] == "ok"
                && record["tip"]["deflection_m"].is_f64()
                && sigma.is_some_and(|s| s > 0.0)
        }),
        (0, "orient") => {
            json().is_some_and(|fit| fit["rms_px"].is_f64() && fit["sigma_mrad"].is_array())
        }
        (0, "plan") => json().is_some(),
        _ => printed.trim().len() > 20,
    };
    (!sound).then(|| format!("exit {status} without a result or a reason"))
}

/// First seed of the changes of foreign files; 0 without `WINGD_SEED`.
pub fn first_seed() -> u64 {
    std::env::var("WINGD_SEED").map_or(0, |text| text.parse().unwrap())
}

/// Number of seeds, or from..to: files of a single one are kept for inspection.
fn seeds(wanted: &str) -> std::ops::Range<u64> {
    let number = |text: &str| text.parse().ok();
    let range = wanted
        .split_once("..")
        .and_then(|(from, to)| Some(number(from)?..number(to)?));
    range.unwrap_or(0..number(wanted).unwrap_or(USUAL))
}

#[test]
#[ignore = "minutes: make test-mutations"]
fn mutated_inputs_end_with_a_result_or_a_reason() {
    let seeds = seeds(&std::env::var("WINGD_MUTATIONS").unwrap_or_default());
    let bench = Bench::new();
    let (mut endings, mut slowest) = (
        std::collections::BTreeMap::new(),
        (Duration::ZERO, 0, "", ""),
    );
    let mut failures = vec![];
    for seed in seeds.clone() {
        let mut rng = StdRng::seed_from_u64(seed);
        let (name, commands) = KINDS[seed as usize % KINDS.len()];
        let command = commands[seed as usize / KINDS.len() % commands.len()];
        for (file, bytes) in &bench.sound {
            std::fs::write(bench.path(file), bytes).unwrap();
        }
        bench.mutate(&mut rng, name);
        let ending = bench.run(command);
        slowest = slowest.max((ending.2, seed, name, command));
        *endings.entry((name, command, ending.0)).or_insert(0) += 1;
        if let Some(what) = check_ending(command, &ending) {
            let printed: String = ending.1.chars().take(400).collect();
            eprintln!("seed {seed}, {name}, {command}: {what}: {printed}");
            failures.push(seed);
        }
    }
    endings
        .iter()
        .for_each(|(ending, count)| eprintln!("{ending:?}: {count}"));
    let wanted = seeds.count();
    eprintln!("{wanted} mutations, the slowest: {slowest:?}");
    if wanted == 1 {
        eprintln!("left in {}", bench.folder.keep().display());
    }
    assert!(
        failures.is_empty(),
        "{} of {wanted}: {failures:?}",
        failures.len()
    );
}
