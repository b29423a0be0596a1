//! Digests of bytes and of the inputs of a result.

use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

/// Computes the SHA-256 of bytes, hex.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Inputs of a result other than the frame: digests of the installation, program version, parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Inputs {
    /// Provenance as written to the result's line.
    pub provenance: Map<String, Value>,
    canonical: String,
}

impl Inputs {
    /// Creates the inputs; the order of the keys has no effect.
    pub fn new(provenance: Map<String, Value>) -> Self {
        let mut canonical = String::new();
        write_canonical(&Value::Object(provenance.clone()), &mut canonical);
        Self {
            provenance,
            canonical,
        }
    }

    /// Computes the key under which a frame's result is written once.
    pub fn key(&self, frame_sha256: &str) -> String {
        sha256_hex(format!("{frame_sha256}\n{}", self.canonical).as_bytes())
    }
}

/// Writes JSON with sorted keys and no spaces.
fn write_canonical(value: &Value, out: &mut String) {
    match value {
        Value::Object(map) => {
            let mut keys: Vec<&String> = map.keys().collect();
            keys.sort();
            out.push('{');
            for key in keys {
                out.push_str(&Value::String(key.clone()).to_string());
                out.push(':');
                write_canonical(map.get(key).unwrap_or(&Value::Null), out);
                out.push(',');
            }
            out.push('}');
        }
        Value::Array(items) => {
            out.push('[');
            for item in items {
                write_canonical(item, out);
                out.push(',');
            }
            out.push(']');
        }
        plain => out.push_str(&plain.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_follows_every_input_and_not_their_order() {
        let map = |text: &str| serde_json::from_str::<Map<String, Value>>(text).unwrap();
        let a = Inputs::new(map(r#"{"version":"1","camera":{"x":1,"y":2}}"#));
        let b = Inputs::new(map(r#"{"camera":{"y":2,"x":1},"version":"1"}"#));
        let c = Inputs::new(map(r#"{"camera":{"y":2,"x":3},"version":"1"}"#));
        assert_eq!(a.key("f"), b.key("f"));
        assert_ne!(a.key("f"), c.key("f"));
        assert_ne!(a.key("f"), a.key("g"));
    }
}
