//! Sections of `installation.toml` that have widths: their own keys are fields, the keys of widths are in the registry
//! ([`Width`]).

use std::marker::PhantomData;

use serde::de::{DeserializeSeed, Deserializer, Error, IntoDeserializer, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use crate::measure::setup::Width;

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
        self.0.iter().try_for_each(|(width, value)| map.serialize_entry(width.row().key, value))?;
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
        let table = T::deserialize(SectionReader { map, section: T::NAME, fields: &[], widths: &mut widths })?;
        Ok(Section { table, widths })
    }
}

/// Source of a section's own table, which takes the widths out.
struct SectionReader<'a, A> {
    map: A,
    section: &'static str,
    /// Own keys.
    fields: &'static [&'static str],
    widths: &'a mut GivenWidths,
}

impl<'de, A: MapAccess<'de>> Deserializer<'de> for SectionReader<'_, A> {
    type Error = A::Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, A::Error> {
        visitor.visit_map(SectionReader { fields, ..self })
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, A::Error> {
        visitor.visit_map(self)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for SectionReader<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        let mut seed = Some(seed);
        loop {
            let reader = KeyReader { section: self.section, fields: self.fields, seed: &mut seed };
            match self.map.next_key_seed(reader)? {
                Some(SectionKey::Width(width)) => self.widths.0.push((width, self.map.next_value()?)),
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

/// Reader of one key; the seed for an own key remains until it is used.
struct KeyReader<'a, K> {
    section: &'static str,
    fields: &'static [&'static str],
    seed: &'a mut Option<K>,
}

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for KeyReader<'_, K> {
    type Value = SectionKey<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, source: D) -> Result<Self::Value, D::Error> {
        source.deserialize_str(self)
    }
}

impl<'de, K: DeserializeSeed<'de>> Visitor<'de> for KeyReader<'_, K> {
    type Value = SectionKey<K::Value>;

    fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<Self::Value, E> {
        if let Some(width) = Width::from_key(self.section, key) {
            return Ok(SectionKey::Width(width));
        }
        match self.seed.take().filter(|_| self.fields.contains(&key)) {
            Some(seed) => Ok(SectionKey::Own(seed.deserialize(key.into_deserializer())?)),
            None => {
                let widths = Width::ROWS.iter().filter(|row| row.section == self.section).map(|row| row.key);
                let known: Vec<String> = self.fields.iter().copied().chain(widths).map(|k| format!("`{k}`")).collect();
                Err(E::custom(format!("unknown field `{key}`, expected one of {}", known.join(", "))))
            }
        }
    }
}
