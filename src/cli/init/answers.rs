//! What of an installation is known when it is begun: by options, or asked for on a terminal.

use std::io::{BufRead, IsTerminal, Write};

/// What is known; the rest stays blank, and `wingd check` names it.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "What is known (else asked for on a terminal)")]
pub struct Answers {
    /// Name of aircraft and wing
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Which wing
    #[arg(long, value_name = "left|right", value_parser = ["left", "right"])]
    side: Option<String>,
    /// Place of the lens in the survey's frame, m
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true)]
    projection_centre: Option<[f64; 3]>,
    /// Horizontal direction of the span, outboard, in the survey's frame
    #[arg(long, value_name = "DX,DY", value_parser = numbers::<2>, allow_hyphen_values = true)]
    span_direction: Option<[f64; 2]>,
    /// Along the span from the lens to where bending begins, m
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    root_offset: Option<f64>,
    /// Temperature of the wing at the survey and in flight, degrees Celsius
    #[arg(long, value_name = "GROUND,FLIGHT", value_parser = numbers::<2>, allow_hyphen_values = true)]
    temperatures: Option<[f64; 2]>,
    /// The pair of markers whose torsion is wanted
    #[arg(long, value_name = "LEADING,TRAILING", value_parser = pair)]
    torsion: Option<[String; 2]>,
    /// Ask for nothing, also on a terminal
    #[arg(long)]
    no_questions: bool,
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let read: Option<Vec<f64>> =
        text.split(',').map(|t| t.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let fault = || match N {
        1 => "give a number, with a point".to_owned(),
        _ => format!("give {N} numbers with commas between them"),
    };
    read.and_then(|all| all.try_into().ok()).ok_or_else(fault)
}

fn pair(text: &str) -> Result<[String; 2], String> {
    let parts: Vec<String> = text.split(',').map(|t| t.trim().to_owned()).collect();
    let named = parts.iter().all(|t| !t.is_empty());
    parts.try_into().ok().filter(|_| named).ok_or_else(|| "give two markers' names, as in M20,M21".to_owned())
}

fn number(text: &str) -> Result<f64, String> {
    numbers::<1>(text).map(|[value]| value)
}

fn word(text: &str) -> Result<String, String> {
    Ok(text.to_owned())
}

fn side(text: &str) -> Result<String, String> {
    let known = ["left", "right"].contains(&text);
    if known { Ok(text.to_owned()) } else { Err("answer left or right".to_owned()) }
}

impl Answers {
    /// Asks for what the options leave open, where there is a terminal to ask at. An empty answer leaves it blank.
    pub fn asked(mut self) -> Self {
        let terminal = std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
        if self.no_questions || !terminal {
            return self;
        }
        eprintln!("What is not known yet: press Enter, it stays blank. installation.svg shows what is what.");
        ask(&mut self.name, "name of aircraft and wing", word);
        ask(&mut self.side, "which wing (left or right)", side);
        ask(&mut self.projection_centre, "place of the lens in the survey's frame, m (x,y,z)", numbers::<3>);
        ask(&mut self.span_direction, "direction of the span, outboard, in that frame (dx,dy)", numbers::<2>);
        ask(&mut self.root_offset, "along the span from the lens to where bending begins, m", number);
        ask(
            &mut self.temperatures,
            "temperature of the wing at the survey and in flight, C (ground,flight)",
            numbers::<2>,
        );
        ask(&mut self.torsion, "pair of markers whose torsion is wanted (leading,trailing)", pair);
        self
    }

    /// The template with what is known in the places of what is blank.
    pub fn filled(&self, template: &str) -> String {
        let list = |all: &[f64]| {
            let texts: Vec<String> = all.iter().map(|v| format!("{v:?}")).collect();
            format!("[{}]", texts.join(", "))
        };
        let known = [
            ("name = \"\"", self.name.as_ref().map(|t| format!("name = {t:?}"))),
            ("side = \"\"", self.side.as_ref().map(|t| format!("side = {t:?}"))),
            (
                "projection_centre_m = []",
                self.projection_centre.map(|p| format!("projection_centre_m = {}", list(&p))),
            ),
            ("span_direction = []", self.span_direction.map(|d| format!("span_direction = {}", list(&d)))),
            ("root_offset_m = nan", self.root_offset.map(|m| format!("root_offset_m = {m:?}"))),
        ];
        let mut text = template.to_owned();
        for (blank, filled) in known {
            if let Some(filled) = filled {
                text = text.replacen(blank, &filled, 1);
            }
        }
        if let Some([ground, flight]) = self.temperatures {
            let lines = [
                ("#[thermal]", "[thermal]".to_owned()),
                ("#expansion_per_k =", "expansion_per_k =".to_owned()),
                ("#ground_temperature_c = 15.0", format!("ground_temperature_c = {ground:?}")),
                ("#flight_temperature_c = -55.0", format!("flight_temperature_c = {flight:?}")),
            ];
            lines.iter().for_each(|(blank, filled)| text = text.replacen(blank, filled, 1));
        }
        if let Some([leading, trailing]) = &self.torsion {
            let lines = [
                ("#[[torsion]]", "[[torsion]]".to_owned()),
                ("#name = \"tip\"", "name = \"tip\"".to_owned()),
                ("#leading = \"M20\"", format!("leading = {leading:?}")),
                ("#trailing = \"M21\"", format!("trailing = {trailing:?}")),
            ];
            lines.iter().for_each(|(blank, filled)| text = text.replacen(blank, filled, 1));
        }
        text
    }
}

/// Until the answer can be read, or is empty, or nobody answers any more.
fn ask<T>(known: &mut Option<T>, what: &str, read: impl Fn(&str) -> Result<T, String>) {
    while known.is_none() {
        eprint!("{what}: ");
        let _ = std::io::stderr().flush();
        let mut line = String::new();
        let count = std::io::stdin().lock().read_line(&mut line).unwrap_or(0);
        let answer = line.trim();
        if count == 0 || answer.is_empty() {
            return;
        }
        match read(answer) {
            Ok(value) => *known = Some(value),
            Err(mend) => eprintln!("  {mend}"),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const TEMPLATE: &str = include_str!("../../../config/new/installation.toml");

    #[test]
    fn every_blank_of_the_template_has_its_answer() {
        let all = Answers {
            name: Some("D-ABCD, left wing".into()),
            side: Some("left".into()),
            projection_centre: Some([1.0, -2.5, 3.0]),
            span_direction: Some([0.5, -0.5]),
            root_offset: Some(0.7),
            temperatures: Some([12.0, -50.0]),
            torsion: Some(["M18".into(), "M19".into()]),
            no_questions: true,
        };
        let table: toml::Table = all.filled(TEMPLATE).parse().unwrap();
        assert_eq!(table["name"].as_str(), Some("D-ABCD, left wing"));
        assert_eq!(table["wing"]["side"].as_str(), Some("left"));
        assert_eq!(table["wing"]["root_offset_m"].as_float(), Some(0.7));
        assert_eq!(table["camera"]["projection_centre_m"].as_array().unwrap().len(), 3);
        assert_eq!(table["wing"]["span_direction"].as_array().unwrap().len(), 2);
        assert_eq!(table["thermal"]["flight_temperature_c"].as_float(), Some(-50.0));
        assert_eq!(table["torsion"][0]["leading"].as_str(), Some("M18"));
        let blank: toml::Table = Answers::default().filled(TEMPLATE).parse().unwrap();
        assert!(!blank.contains_key("thermal") && !blank.contains_key("torsion"));
    }

    #[test]
    fn answers_are_read_or_refused() {
        assert_eq!(numbers::<3>("1, -2.5,3"), Ok([1.0, -2.5, 3.0]));
        assert!(numbers::<3>("1,2").is_err() && numbers::<2>("1,nan").is_err() && pair("M20").is_err());
        assert_eq!(pair("M20, M21"), Ok(["M20".to_owned(), "M21".to_owned()]));
    }
}
