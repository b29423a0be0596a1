//! Conditions on the aircraft data of a frame, as text: `mach between 0.78 and 0.80 and weight_kg < 190000`.

use super::{AircraftState, Quantity};

/// Range that a quantity must be in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightCondition {
    quantity: Quantity,
    low: f64,
    high: f64,
}

/// Remedy for a text that is no condition.
const FORM: &str = "write conditions as `mach between 0.78 and 0.80 and weight_kg < 190000`";

impl FlightCondition {
    /// Parses conditions that are joined by `and`.
    ///
    /// # Errors
    /// Returns a sentence that names the word that is not understood, with the form of a condition.
    pub fn parse_all(text: &str) -> Result<Vec<Self>, String> {
        let mut words = text.split_whitespace();
        let mut all = vec![];
        loop {
            all.push(Self::parse_one(&mut words)?);
            match words.next() {
                None => return Ok(all),
                Some("and") => {}
                Some(other) => return Err(format!("\"{other}\" is not understood; {FORM}")),
            }
        }
    }

    fn parse_one<'a>(words: &mut impl Iterator<Item = &'a str>) -> Result<Self, String> {
        let mut next = || {
            words
                .next()
                .ok_or_else(|| format!("the condition is incomplete; {FORM}"))
        };
        let name = next()?;
        let (quantity, (scale, offset)) = Quantity::parse_with_unit(name)?;
        let number = |word: &str| {
            let parsed = word
                .parse::<f64>()
                .map_err(|_| format!("\"{word}\" is not a number; {FORM}"));
            parsed.map(|number| scale * number + offset)
        };
        let (low, high) = match next()? {
            "between" => {
                let low = number(next()?)?;
                match next()? {
                    "and" => (low, number(next()?)?),
                    other => return Err(format!("\"{other}\" is not understood; {FORM}")),
                }
            }
            "<" | "<=" => (f64::NEG_INFINITY, number(next()?)?),
            ">" | ">=" => (number(next()?)?, f64::INFINITY),
            other => return Err(format!("\"{other}\" is not understood; {FORM}")),
        };
        Ok(Self {
            quantity,
            low,
            high,
        })
    }

    /// Returns whether the data of a frame have the quantity, within the range.
    pub fn holds(&self, state: &AircraftState) -> bool {
        state
            .get(&self.quantity)
            .is_some_and(|joined| (self.low..=self.high).contains(&joined.value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_read_or_refused_with_the_word() {
        let two = FlightCondition::parse_all("mach between 0.78 and 0.80 and weight_kg < 190000")
            .unwrap();
        assert_eq!(
            (two[0].low, two[0].high, two[1].high),
            (0.78, 0.8, 190_000.0)
        );
        let tonnes = FlightCondition::parse_all("weight_t < 190").unwrap();
        assert_eq!(
            (tonnes[0].quantity, tonnes[0].high),
            (Quantity::WeightKg, 190_000.0)
        );
        for (text, part) in [
            ("match < 1", "there is no quantity \"match\""),
            ("mach less 1", "\"less\" is not understood"),
            ("mach < high", "\"high\" is not a number"),
            ("mach between 1", "incomplete"),
            ("mach < 1 or mach > 2", "\"or\" is not understood"),
        ] {
            let error = FlightCondition::parse_all(text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}
