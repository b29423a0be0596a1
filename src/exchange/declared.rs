//! Lens model that a file declares: the value of the key that declares it, whatever the file contains besides.

use super::interior::MODEL_REMEDY;
use super::keyed::{KeyedEntry, KeyedValue, Node};
use crate::installation::KeyFault;

/// Unsupported lens models, as files name them, normalized by [`normalize_model_name`], without the number of terms.
///
/// An unknown key with such a value is rejected: it may be another program's key for the model.
const FOREIGN_MODELS: [&str; 29] = [
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

/// Parameters of unsupported models by their keys, normalized like a model's name: with another value than 0, every ray is
/// another one.
const FOREIGN_PARAMETERS: [(&str, &str); 5] = [
    ("xi", "omnidirectional"),
    ("alpha beta", "unified or double sphere"),
    ("fov omega", "FOV"),
    ("thinprism s1 s2 s3 s4 sx1 sy1 sx2 sy2", "thin prism"),
    ("tau taux tauy tilt", "tilted sensor"),
];

/// Returns the unsupported model of which an entry is a parameter that is not 0.
fn foreign_parameter(entry: &KeyedEntry) -> Option<&'static str> {
    let key = normalize_model_name(&entry.key);
    let (_, model) = FOREIGN_PARAMETERS
        .iter()
        .find(|(keys, _)| keys.split(' ').any(|k| k == key))?;
    let numbers = entry
        .node
        .get("data")
        .ok()
        .flatten()
        .unwrap_or(&entry.node)
        .numbers(&entry.key)
        .unwrap_or_default();
    numbers.iter().any(|value| *value != 0.0).then_some(*model)
}

/// Values that mean "not this model" or "no name".
const NO_MODEL_WORDS: [&str; 6] = ["", "0", "false", "no", "none", "off"];

/// Names of Brown's model, normalized by [`normalize_model_name`].
const BROWN_MODELS: [&str; 4] = ["plumbbob", "radtan", "brown", "brownconrady"];

/// Further supported models, if a key declares one in addition to those of the format: `camera_model: pinhole`.
const OTHER_OWN_MODELS: [&str; 2] = ["pinhole", "rationalpolynomial"];

/// Returns a model's name in lower case, without the characters in which programs differ: `Kannala-Brandt`,
/// `kannala_brandt`.
pub(super) fn normalize_model_name(name: &str) -> String {
    name.to_lowercase()
        .chars()
        .filter(char::is_ascii_alphanumeric)
        .collect()
}

/// Returns whether a name is an unsupported model, with any number of terms appended: `KannalaBrandt8`.
fn is_foreign_model(name: &str) -> bool {
    FOREIGN_MODELS
        .contains(&normalize_model_name(name).trim_end_matches(|c: char| c.is_ascii_digit()))
}

/// Returns whether a name is one of Brown's model.
pub(super) fn is_brown_model(name: &str) -> bool {
    BROWN_MODELS.contains(&normalize_model_name(name).as_str())
}

/// Creates the error for an unsupported model.
pub(super) fn foreign_model_fault(node: &Node, key: &str, name: &str) -> KeyFault {
    KeyFault::on_line(
        node.line,
        key,
        format!("\"{name}\" is not a supported lens model"),
        MODEL_REMEDY,
    )
}

/// Checks that every key that may declare a model names a supported one.
///
/// Returns the keys that are not part of an interior orientation, and remarks on unknown keys.
///
/// # Errors
/// Returns an error for the first key with an unsupported model.
pub(super) fn check_declared_models(
    map: &Node,
    known: &[&str],
    ignored: &[&str],
) -> Result<(Vec<String>, Vec<String>), KeyFault> {
    let (mut left, mut remarks) = (vec![], vec![]);
    for entry in map.entries() {
        let is = |list: &[&str]| list.iter().any(|k| k.eq_ignore_ascii_case(&entry.key));
        let declares = key_declares_model(&entry.key, &["model", "fisheye", "omni"]);
        if is(known) {
            continue;
        }
        if declares && !names_no_foreign_model(&entry.node) {
            return Err(foreign_model_fault(
                &entry.node,
                &entry.key,
                &declared_model_name(&entry.key, entry.node.text()),
            ));
        }
        if let Some(model) = foreign_parameter(entry) {
            let problem =
                format!("is a parameter of the {model} model, which is not a supported lens model");
            return Err(KeyFault::on_line(
                entry.node.line,
                &entry.key,
                problem,
                MODEL_REMEDY,
            ));
        }
        if is(ignored) || declares {
            left.push(entry.key.clone());
        } else {
            check_nested_models(entry)?;
            remarks.push(format!(
                "line {}: the key {} is unknown and not read",
                entry.node.line, entry.key
            ));
        }
    }
    Ok((left, remarks))
}

fn key_declares_model(key: &str, words: &[&str]) -> bool {
    let key = key.to_ascii_lowercase();
    words.iter().any(|word| key.contains(word))
}

/// Returns whether a value is a supported model, or means that the key's model does not apply.
fn names_no_foreign_model(node: &Node) -> bool {
    let text = node.text().map(|t| t.trim().to_ascii_lowercase());
    let ours =
        |t: &str| is_brown_model(t) || OTHER_OWN_MODELS.contains(&normalize_model_name(t).as_str());
    text.is_some_and(|t| NO_MODEL_WORDS.contains(&t.as_str()) || ours(&t))
}

/// Rejects an unknown key, or one within its value, that names an unsupported model.
fn check_nested_models(entry: &KeyedEntry) -> Result<(), KeyFault> {
    let (key, node) = (&entry.key, &entry.node);
    let by_key = key_declares_model(key, &["fisheye", "omni"]) && !names_no_foreign_model(node);
    if by_key || node.text().is_some_and(is_foreign_model) {
        return Err(foreign_model_fault(
            node,
            key,
            &declared_model_name(key, node.text()),
        ));
    }
    let KeyedValue::List(items) = &node.value else {
        return node.entries().iter().try_for_each(check_nested_models);
    };
    items
        .iter()
        .flat_map(Node::entries)
        .try_for_each(check_nested_models)
}

/// Returns the name of a model: the value, or the key for a flag such as `fisheye_model: 1`.
fn declared_model_name(key: &str, text: Option<&str>) -> String {
    match text.map(|t| t.trim().to_ascii_lowercase()).as_deref() {
        Some("1" | "true" | "yes" | "on") | None => key.to_owned(),
        Some(_) => text.unwrap_or_default().trim().to_owned(),
    }
}
