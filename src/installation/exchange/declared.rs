//! Which lens model a file declares: the value of the key that declares it, whatever else stands in the file.

use super::interior::CALIBRATE;
use crate::installation::keyed::{Entry, Node, Trouble, Value};

/// Lens models that are not ours, as files name them, in the letters of [`plain`], without the number of terms. A key that
/// nobody knows is refused with such a value: it may be the key that declares the model, in another program's words.
const FOREIGN: [&str; 29] = [
    "equi",
    "equidistant",
    "fisheye",
    "fisheyeopencv",
    "opencvfisheye",
    "kannalabrandt",
    "kb",
    "omni",
    "omnidirectional",
    "mei",
    "ucm",
    "eucm",
    "ds",
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
    "thinprism",
    "thinprismfisheye",
    "tilted",
    "division",
    "inversebrownconrady",
];

/// Values that say "not this model" or "no name".
const NONE: [&str; 6] = ["", "0", "false", "no", "none", "off"];

/// Names of Brown's model, in the letters of [`plain`].
const BROWN: [&str; 4] = ["plumbbob", "radtan", "brown", "brownconrady"];

/// The other models that are ours, where a key declares one beside those that the format knows: `camera_model: pinhole`.
const OURS: [&str; 2] = ["pinhole", "rationalpolynomial"];

/// A model's name in small letters, without the signs in which programs differ: `Kannala-Brandt`, `kannala_brandt`.
pub(super) fn plain(name: &str) -> String {
    name.to_lowercase().chars().filter(char::is_ascii_alphanumeric).collect()
}

/// Whether a name is one of a model that is not ours, whatever number of terms stands behind it: `KannalaBrandt8`.
fn is_foreign(name: &str) -> bool {
    FOREIGN.contains(&plain(name).trim_end_matches(|c: char| c.is_ascii_digit()))
}

/// Whether a name is one of Brown's model.
pub(super) fn is_browns(name: &str) -> bool {
    BROWN.contains(&plain(name).as_str())
}

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
        let is = |list: &[&str]| list.iter().any(|k| k.eq_ignore_ascii_case(&entry.key));
        let declares = says_model(&entry.key, &["model", "fisheye", "omni"]);
        if is(known) {
            continue;
        }
        if declares && !says_none(&entry.node) {
            return Err(foreign(&entry.node, &entry.key, &declared_name(&entry.key, entry.node.text())));
        }
        if is(beside) || declares {
            left.push(entry.key.clone());
        } else {
            within(entry)?;
            remarks
                .push(format!("line {}: the key {} is not known and not read", entry.node.line, entry.key));
        }
    }
    Ok((left, remarks))
}

fn says_model(key: &str, words: &[&str]) -> bool {
    let key = key.to_ascii_lowercase();
    words.iter().any(|word| key.contains(word))
}

/// Whether a value is one of our models, or says that the key's model is none of this camera.
fn says_none(node: &Node) -> bool {
    let text = node.text().map(|t| t.trim().to_ascii_lowercase());
    let ours = |t: &str| is_browns(t) || OURS.contains(&plain(t).as_str());
    text.is_some_and(|t| NONE.contains(&t.as_str()) || ours(&t))
}

/// Refuses a key that nobody knows, or one within its value, where a model that is not ours stands there.
fn within(entry: &Entry) -> Result<(), Trouble> {
    let (key, node) = (&entry.key, &entry.node);
    let by_key = says_model(key, &["fisheye", "omni"]) && !says_none(node);
    if by_key || node.text().is_some_and(is_foreign) {
        return Err(foreign(node, key, &declared_name(key, node.text())));
    }
    let Value::List(items) = &node.value else { return node.entries().iter().try_for_each(within) };
    items.iter().flat_map(Node::entries).try_for_each(within)
}

/// A model by its value; of a flag such as `fisheye_model: 1` by its key.
fn declared_name(key: &str, text: Option<&str>) -> String {
    match text.map(|t| t.trim().to_ascii_lowercase()).as_deref() {
        Some("1" | "true" | "yes" | "on") | None => key.to_owned(),
        Some(_) => text.unwrap_or_default().trim().to_owned(),
    }
}
