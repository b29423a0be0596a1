//! Which lens model a file declares: the value of the key that declares it, whatever else stands in the file.

use super::interior::CALIBRATE;
use crate::installation::keyed::{Node, Trouble};

/// Lens models that are not ours, as files name them. A key that nobody knows is refused with such a value: it may be the
/// key that declares the model, in another program's words.
const FOREIGN: [&str; 29] = [
    "equidistant",
    "fisheye",
    "kannala_brandt",
    "kannala-brandt",
    "kannala_brandt4",
    "kb4",
    "omni",
    "omnidirectional",
    "mei",
    "ucm",
    "eucm",
    "ds",
    "double_sphere",
    "doublesphere",
    "fov",
    "atan",
    "scaramuzza",
    "ocam",
    "ocamcalib",
    "cahvor",
    "cahvore",
    "stereographic",
    "equisolid",
    "orthographic",
    "thin_prism",
    "thin_prism_fisheye",
    "tilted",
    "division",
    "inverse_brown_conrady",
];

/// Values that say "not this model" or "no name".
const NONE: [&str; 6] = ["", "0", "false", "no", "none", "off"];

/// Models that are ours, where a key declares one beside those that the format knows: `camera_model: pinhole`.
const OURS: [&str; 5] = ["pinhole", "plumb_bob", "radtan", "brown", "rational_polynomial"];

/// The refusal of a model by its name.
pub(super) fn foreign(node: &Node, key: &str, name: &str) -> Trouble {
    Trouble::new(node.line, key, format!("\"{name}\" is another lens model"), CALIBRATE)
}

/// Every key that may declare a model says one of ours; the other keys are told to be known or not. Returns the keys
/// that are no part of an interior orientation, and remarks on those that nobody knows.
///
/// # Errors
/// The first key with another model, by its name.
pub(super) fn check(
    map: &Node,
    known: &[&str],
    beside: &[&str],
) -> Result<(Vec<String>, Vec<String>), Trouble> {
    let (mut left, mut remarks) = (vec![], vec![]);
    for entry in map.entries() {
        let key = entry.key.to_ascii_lowercase();
        let is = |list: &[&str]| list.iter().any(|k| k.eq_ignore_ascii_case(&key));
        if is(known) {
            continue;
        }
        let text = entry.node.text().map(|t| t.trim().to_ascii_lowercase());
        let declares = key.contains("model") || key.contains("fisheye") || key.contains("omni");
        let none = text.as_deref().is_some_and(|t| NONE.contains(&t) || OURS.contains(&t));
        let names_one = text.as_deref().is_some_and(|t| FOREIGN.contains(&t));
        if (declares && !none) || (names_one && !is(beside)) {
            return Err(foreign(&entry.node, &entry.key, &declared_name(&key, text.as_deref())));
        }
        if is(beside) || (declares && none) {
            left.push(entry.key.clone());
        } else {
            remarks
                .push(format!("line {}: the key {} is not known and not read", entry.node.line, entry.key));
        }
    }
    Ok((left, remarks))
}

/// A model by its value; of a flag such as `fisheye_model: 1` by its key.
fn declared_name(key: &str, text: Option<&str>) -> String {
    match text {
        Some("1" | "true" | "yes" | "on") | None => key.to_owned(),
        Some(name) => name.to_owned(),
    }
}
