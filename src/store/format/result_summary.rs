//! The beginnings of results: frame, inputs and a few fields of the record, without reading on through
//! markers and correlations. A flight has thousands of results, a list of them needs a number of each.

use std::fmt;

use serde::Deserializer as _;
use serde::de::{DeserializeSeed, Error, IgnoredAny, MapAccess, Visitor};
use serde_json::{Map, Value};

/// What was asked for of one result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Head {
    /// File in the series' folder.
    pub frame: String,
    /// What it was computed from.
    pub provenance: Map<String, Value>,
    /// The fields asked for; those that the record does not have are missing here too.
    pub record: Map<String, Value>,
}

/// The heads of the whole lines, in the order written. A line that is none is left out: `verify` names it.
pub fn parse(bytes: &[u8], fields: &[&str]) -> Vec<Head> {
    let mut begin = 0;
    let lines = memchr::memchr_iter(b'\n', bytes).filter_map(|end| {
        let line = bytes.get(begin..end);
        begin = end + 1;
        line
    });
    lines.filter_map(|line| head(line, fields)).collect()
}

fn head(line: &[u8], fields: &[&str]) -> Option<Head> {
    let mut found = Partial { frame: None, provenance: None, record: Map::new(), fields };
    // An error is the sign of having enough, or a damaged line; what was found tells which.
    let _ =
        serde_json::Deserializer::from_slice(line).deserialize_map(Level { found: &mut found, inner: false });
    Some(Head { frame: found.frame?, provenance: found.provenance?, record: found.record })
}

struct Partial<'a> {
    frame: Option<String>,
    provenance: Option<Map<String, Value>>,
    record: Map<String, Value>,
    fields: &'a [&'a str],
}

impl Partial<'_> {
    fn is_complete(&self) -> bool {
        self.frame.is_some() && self.provenance.is_some() && self.record.len() == self.fields.len()
    }
}

/// The line's object, or the record in it.
struct Level<'a, 'f> {
    found: &'a mut Partial<'f>,
    inner: bool,
}

impl<'de> DeserializeSeed<'de> for Level<'_, '_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Level<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { found, inner } = self;
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                wanted if inner && found.fields.contains(&wanted) => {
                    found.record.insert(key, map.next_value()?);
                }
                "frame" if !inner => found.frame = Some(map.next_value()?),
                "provenance" if !inner => found.provenance = Some(map.next_value()?),
                "record" if !inner && !found.fields.is_empty() => {
                    map.next_value_seed(Level { found: &mut *found, inner: true })?;
                }
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
            if found.is_complete() {
                return Err(A::Error::custom("enough"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    const LINE: &str = r#"{"frame":"0001.jpg","frame_sha256":"ab","inputs":"cd","provenance":{"program":"x"},"record":{"image":"a","status":"ok","tip":{"deflection_m":2.5},"markers":[1,2]}}"#;

    #[test]
    fn the_fields_come_whatever_their_order_and_a_torn_tail_does_not() {
        let value: Value = serde_json::from_str(LINE).unwrap();
        let turned: Map<String, Value> = value.as_object().unwrap().clone().into_iter().rev().collect();
        let turned = serde_json::to_string(&turned).unwrap();
        let text = format!("{LINE}\n{turned}\n\nx\n{LINE}");
        let heads = parse(text.as_bytes(), &["status", "tip"]);
        assert_eq!(heads.len(), 2);
        for head in heads {
            assert_eq!((head.frame.as_str(), &head.provenance["program"]), ("0001.jpg", &"x".into()));
            assert_eq!(
                (&head.record["status"], &head.record["tip"]["deflection_m"]),
                (&"ok".into(), &2.5.into())
            );
        }
    }

    #[test]
    fn it_stops_reading_where_it_has_enough() {
        // What comes after is not even JSON.
        let cut = LINE.split("\"markers\"").next().unwrap();
        assert_eq!(parse(format!("{cut}!\n").as_bytes(), &["tip"]).len(), 1);
        assert_eq!(parse(b"{\"frame\":\"0001.jpg\",\"prov\n", &[]).len(), 0);
    }
}
