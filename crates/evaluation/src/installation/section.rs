//! Sections of `installation.toml` that have widths: their own keys are fields, the keys of widths are in the registry
//! ([`Width`]).

use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Deserializer, Error, IntoDeserializer, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use wingd_measure::setup::Width;

/// Table of a section's own keys.
pub(super) trait SectionTable {
    /// Name of the section.
    const NAME: &'static str;
}

/// Section with its widths.
#[derive(Serialize)]
pub(super) struct Section<T> {
    /// Own keys.
    #[serde(flatten)]
    pub table: T,
    #[serde(flatten)]
    pub widths: GivenWidths,
}

impl<T> std::ops::Deref for Section<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.table
    }
}

/// Widths that a section gives, in the units of their keys.
#[derive(Default)]
pub(super) struct GivenWidths(pub Vec<(Width, f64)>);

impl Serialize for GivenWidths {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        self.0
            .iter()
            .try_for_each(|(width, value)| map.serialize_entry(width.row().key, value))?;
        map.end()
    }
}

impl<'de, T: Deserialize<'de> + SectionTable> Deserialize<'de> for Section<T> {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        source.deserialize_map(SectionVisitor(PhantomData))
    }
}

struct SectionVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de> + SectionTable> Visitor<'de> for SectionVisitor<T> {
    type Value = Section<T>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "a section [{}]", T::NAME)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        let mut widths = GivenWidths::default();
        let own = SectionKeys {
            map,
            section: T::NAME,
            widths: &mut widths,
        };
        let table = T::deserialize(MapAccessDeserializer::new(own))?;
        Ok(Section { table, widths })
    }
}

/// Keys of a section without its widths, which are collected.
struct SectionKeys<'a, A> {
    map: A,
    section: &'static str,
    widths: &'a mut GivenWidths,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for SectionKeys<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, A::Error> {
        let mut seed = Some(seed);
        loop {
            match self.map.next_key_seed(KeyReader {
                section: self.section,
                seed: &mut seed,
            })? {
                Some(SectionKey::Width(width)) => {
                    self.widths.0.push((width, self.map.next_value()?))
                }
                Some(SectionKey::Own(key)) => return Ok(Some(key)),
                None => return Ok(None),
            }
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.map.next_value_seed(seed)
    }
}

enum SectionKey<T> {
    Width(Width),
    Own(T),
}

/// Reader of one key; the seed remains until it reads an own key.
struct KeyReader<'a, K> {
    section: &'static str,
    seed: &'a mut Option<K>,
}

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for KeyReader<'_, K> {
    type Value = SectionKey<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, source: D) -> Result<Self::Value, D::Error> {
        let key = String::deserialize(source)?;
        if let Some(width) = Width::from_key(self.section, &key) {
            return Ok(SectionKey::Width(width));
        }
        let seed = self
            .seed
            .take()
            .ok_or_else(|| D::Error::custom("has a key after an error"))?;
        // The error of an unknown key lists the own keys.
        let unknown = |error: D::Error| {
            let rows = Width::ROWS.iter().filter(|row| row.section == self.section);
            let widths = rows
                .map(|row| format!("`{}`", row.key))
                .collect::<Vec<_>>()
                .join(", ");
            let text = error.to_string();
            let text = text.trim_end();
            D::Error::custom(match text.strip_suffix("there are no fields") {
                Some(begin) => format!("{begin}expected one of {widths}"),
                None => format!("{text}, {widths}"),
            })
        };
        seed.deserialize(key.into_deserializer())
            .map(SectionKey::Own)
            .map_err(unknown)
    }
}
