//! Values of a new installation, given by options or entered on a terminal.

use std::io::{BufRead, IsTerminal, Write};

/// Known values; the others stay blank, and `wingd check` reports them.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Known values (otherwise asked for on a terminal)")]
pub struct InitAnswers {
    /// Name of aircraft and wing
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Side of the wing
    #[arg(long, value_name = "left|right", value_parser = ["left", "right"])]
    side: Option<String>,
    /// Position of the lens in the survey frame, m
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true)]
    projection_centre: Option<[f64; 3]>,
    /// Horizontal direction of the span, outboard, in the survey frame
    #[arg(long, value_name = "DX,DY", value_parser = parse_numbers::<2>, allow_hyphen_values = true)]
    span_direction: Option<[f64; 2]>,
    /// Distance along the span from the lens to the bending root, m
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    root_offset: Option<f64>,
    /// Temperature of the wing at the survey and in flight, degrees Celsius
    #[arg(long, value_name = "GROUND,FLIGHT", value_parser = parse_numbers::<2>, allow_hyphen_values = true)]
    temperatures: Option<[f64; 2]>,
    /// Pair of markers for the torsion
    #[arg(long, value_name = "LEADING,TRAILING", value_parser = parse_pair)]
    torsion: Option<[String; 2]>,
    /// Shift of the image by stabilisation of lens or sensor, standard deviation, px; 0: none, or switched off
    #[arg(long, value_name = "PX")]
    stabilised: Option<f64>,
    /// Do not ask for values, even on a terminal
    #[arg(long)]
    no_questions: bool,
}

fn parse_numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let read: Option<Vec<f64>> = text
        .split(',')
        .map(|t| t.trim().parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    let fault = || match N {
        1 => "give a number, with a decimal point".to_owned(),
        _ => format!("give {N} numbers separated by commas"),
    };
    read.and_then(|all| all.try_into().ok()).ok_or_else(fault)
}

fn parse_pair(text: &str) -> Result<[String; 2], String> {
    let parts: Vec<String> = text.split(',').map(|t| t.trim().to_owned()).collect();
    let named = parts.iter().all(|t| !t.is_empty());
    parts
        .try_into()
        .ok()
        .filter(|_| named)
        .ok_or_else(|| "give the names of two markers, for example M20,M21".to_owned())
}

fn parse_number(text: &str) -> Result<f64, String> {
    parse_numbers::<1>(text).map(|[value]| value)
}

fn parse_side(text: &str) -> Result<String, String> {
    let known = ["left", "right"].contains(&text);
    if known {
        Ok(text.to_owned())
    } else {
        Err("answer left or right".to_owned())
    }
}

impl InitAnswers {
    /// Asks for values not given by options, if there is a terminal. An empty answer leaves a value blank.
    pub fn ask_missing(mut self) -> Self {
        let terminal = std::io::stdin().is_terminal() && std::io::stderr().is_terminal();
        if self.no_questions || !terminal {
            return self;
        }
        eprintln!("Press Enter to leave a value blank. installation.svg shows the quantities.");
        let Self {
            name,
            side,
            projection_centre,
            span_direction,
            root_offset,
            temperatures,
            torsion,
            stabilised,
            ..
        } = &mut self;
        ask_value(
            name,
            "name of aircraft and wing",
            |text| Ok(text.to_owned()),
        );
        ask_value(side, "which wing (left or right)", parse_side);
        ask_value(
            projection_centre,
            "position of the lens in the survey frame, m (x,y,z)",
            parse_numbers,
        );
        ask_value(
            span_direction,
            "direction of the span, outboard, in the survey frame (dx,dy)",
            parse_numbers,
        );
        ask_value(
            root_offset,
            "distance along the span from the lens to the bending root, m",
            parse_number,
        );
        let what = "temperature of the wing at the survey and in flight, C (ground,flight)";
        ask_value(temperatures, what, parse_numbers);
        let what =
            "shift of the image by stabilisation of lens or sensor, px (0: none, or switched off)";
        ask_value(stabilised, what, parse_number);
        ask_value(
            torsion,
            "pair of markers for the torsion (leading,trailing)",
            parse_pair,
        );
        self
    }

    /// Fills the known values into the template.
    pub fn fill_template(&self, template: &str) -> String {
        let mut filled: Vec<(&str, String)> = vec![];
        filled.extend(
            self.name
                .as_ref()
                .map(|t| ("name = \"\"", format!("name = {t:?}"))),
        );
        filled.extend(
            self.side
                .as_ref()
                .map(|t| ("side = \"\"", format!("side = {t:?}"))),
        );
        let centre = self.projection_centre;
        filled.extend(centre.map(|p| {
            (
                "projection_centre_m = []",
                format!("projection_centre_m = {p:?}"),
            )
        }));
        filled.extend(
            self.span_direction
                .map(|d| ("span_direction = []", format!("span_direction = {d:?}"))),
        );
        filled.extend(
            self.root_offset
                .map(|m| ("root_offset_m = nan", format!("root_offset_m = {m:?}"))),
        );
        filled.extend(self.stabilised.map(|px| {
            (
                "# stabilised_px = 0.0  ",
                format!("stabilised_px = {px:?}    "),
            )
        }));
        if let Some([ground, flight]) = self.temperatures {
            filled.extend([
                ("#[thermal]", "[thermal]".to_owned()),
                ("#expansion_per_k =", "expansion_per_k =".to_owned()),
                (
                    "#ground_temperature_c = 15.0",
                    format!("ground_temperature_c = {ground:?}"),
                ),
                (
                    "#flight_temperature_c = -55.0",
                    format!("flight_temperature_c = {flight:?}"),
                ),
            ]);
        }
        if let Some([leading, trailing]) = &self.torsion {
            filled.extend([
                ("#[[torsion]]", "[[torsion]]".to_owned()),
                ("#name = \"tip\"", "name = \"tip\"".to_owned()),
                ("#leading = \"M20\"", format!("leading = {leading:?}")),
                ("#trailing = \"M21\"", format!("trailing = {trailing:?}")),
            ]);
        }
        filled
            .iter()
            .fold(template.to_owned(), |text, (blank, line)| {
                text.replacen(blank, line, 1)
            })
    }
}

/// Repeats a question until the answer is valid or empty, or the input ends.
fn ask_value<T>(known: &mut Option<T>, what: &str, read: impl Fn(&str) -> Result<T, String>) {
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
            Err(remedy) => eprintln!("  {remedy}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEMPLATE: &str = include_str!("../../../config/new/installation.toml");

    #[test]
    fn every_blank_of_the_template_has_an_answer() {
        let all = InitAnswers {
            name: Some("D-ABCD, left wing".into()),
            side: Some("left".into()),
            projection_centre: Some([1.0, -2.5, 3.0]),
            span_direction: Some([0.5, -0.5]),
            root_offset: Some(0.7),
            temperatures: Some([12.0, -50.0]),
            torsion: Some(["M18".into(), "M19".into()]),
            stabilised: Some(20.0),
            no_questions: true,
        };
        let table: toml::Table = all.fill_template(TEMPLATE).parse().unwrap();
        assert_eq!(table["name"].as_str(), Some("D-ABCD, left wing"));
        assert_eq!(table["wing"]["side"].as_str(), Some("left"));
        assert_eq!(table["wing"]["root_offset_m"].as_float(), Some(0.7));
        assert_eq!(
            table["camera"]["projection_centre_m"]
                .as_array()
                .unwrap()
                .len(),
            3
        );
        assert_eq!(table["camera"]["stabilised_px"].as_float(), Some(20.0));
        assert_eq!(table["wing"]["span_direction"].as_array().unwrap().len(), 2);
        assert_eq!(
            table["thermal"]["flight_temperature_c"].as_float(),
            Some(-50.0)
        );
        assert_eq!(table["torsion"][0]["leading"].as_str(), Some("M18"));
        let blank: toml::Table = InitAnswers::default()
            .fill_template(TEMPLATE)
            .parse()
            .unwrap();
        assert!(!blank.contains_key("thermal") && !blank.contains_key("torsion"));
    }

    #[test]
    fn answers_are_read_or_refused() {
        assert_eq!(parse_numbers::<3>("1, -2.5,3"), Ok([1.0, -2.5, 3.0]));
        assert!(
            parse_numbers::<3>("1,2").is_err()
                && parse_numbers::<2>("1,nan").is_err()
                && parse_pair("M20").is_err()
        );
        assert_eq!(
            parse_pair("M20, M21"),
            Ok(["M20".to_owned(), "M21".to_owned()])
        );
    }
}
