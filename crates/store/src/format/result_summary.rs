//! Summaries of results: frame, inputs and a few fields of the record, without parsing markers and correlations. A flight
//! has thousands of results, and a list needs only a number of each.

use std::fmt;

use serde::Deserializer as _;
use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, Visitor};
use serde_json::{Map, Value};

/// Selected fields of a result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultSummary {
    /// File name of the frame in the series' folder.
    pub frame: String,
    /// Inputs of the computation.
    pub provenance: Map<String, Value>,
    /// Requested fields; fields missing in the record are missing here too.
    pub record: Map<String, Value>,
}

/// Parses the summary of a line without its newline; `None` if the line is damaged, which `verify` reports.
pub fn parse_summary(line: &[u8], fields: &[&str]) -> Option<ResultSummary> {
    let mut found = PartialSummary {
        frame: None,
        provenance: None,
        record: Map::new(),
        fields,
    };
    // An error means either that everything was found or that the line is damaged; the fields found show which.
    let _ = serde_json::Deserializer::from_slice(line).deserialize_map(SummaryVisitor {
        found: &mut found,
        in_record: false,
    });
    Some(ResultSummary {
        frame: found.frame?,
        provenance: found.provenance?,
        record: found.record,
    })
}

struct PartialSummary<'a> {
    frame: Option<String>,
    provenance: Option<Map<String, Value>>,
    record: Map<String, Value>,
    fields: &'a [&'a str],
}

impl PartialSummary<'_> {
    fn is_complete(&self) -> bool {
        self.frame.is_some() && self.provenance.is_some() && self.record.len() == self.fields.len()
    }
}

/// Visitor of the line's object, or of the record in it.
struct SummaryVisitor<'a, 'f> {
    found: &'a mut PartialSummary<'f>,
    in_record: bool,
}

impl<'de> DeserializeSeed<'de> for SummaryVisitor<'_, '_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for SummaryVisitor<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { found, in_record } = self;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                field if in_record && found.fields.contains(&field) => {
                    found.record.insert(key, map.next_value()?);
                }
                "frame" if !in_record => found.frame = Some(map.next_value()?),
                "provenance" if !in_record => found.provenance = Some(map.next_value()?),
                "record" if !in_record && !found.fields.is_empty() => {
                    map.next_value_seed(SummaryVisitor {
                        found: &mut *found,
                        in_record: true,
                    })?;
                }
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
            if found.is_complete() {
                return Err(A::Error::custom("complete"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"{"frame":"0001.jpg","frame_sha256":"ab","inputs":"cd","provenance":{"program":"x"},"record":{"image":"a","status":"ok","tip":{"deflection_m":2.5},"markers":[1,2]}}"#;

    #[test]
    fn fields_are_found_in_any_order_and_damaged_lines_are_omitted() {
        let value: Value = serde_json::from_str(LINE).unwrap();
        let turned: Map<String, Value> = value
            .as_object()
            .unwrap()
            .clone()
            .into_iter()
            .rev()
            .collect();
        let turned = serde_json::to_string(&turned).unwrap();
        let text = format!("{LINE}\n{turned}\n\nx\n");
        let heads: Vec<_> = text
            .lines()
            .filter_map(|l| parse_summary(l.as_bytes(), &["status", "tip"]))
            .collect();
        assert_eq!(heads.len(), 2);
        for head in heads {
            assert_eq!(
                (head.frame.as_str(), &head.provenance["program"]),
                ("0001.jpg", &"x".into())
            );
            assert_eq!(
                (&head.record["status"], &head.record["tip"]["deflection_m"]),
                (&"ok".into(), &2.5.into())
            );
        }
    }

    #[test]
    fn parsing_stops_when_all_fields_are_found() {
        // The rest of the line is not JSON.
        let cut = LINE.split("\"markers\"").next().unwrap();
        assert!(parse_summary(format!("{cut}!").as_bytes(), &["tip"]).is_some());
        assert_eq!(parse_summary(b"{\"frame\":\"0001.jpg\",\"prov", &[]), None);
    }
}
