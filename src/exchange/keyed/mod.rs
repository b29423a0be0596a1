//! Keyed files of other programs, parsed by their own grammars into one tree: YAML (OpenCV, ROS, Kalibr), OpenCV's XML, and
//! mrcal's Python literal. Comments, quotes, layout and order are handled by the parser.

mod literal;
mod tree;
mod xml;
mod yaml;

pub use tree::{KeyedEntry, KeyedValue, Node};

use crate::installation::KeyFault;

/// Syntax of a keyed file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Syntax {
    /// YAML 1.2 with OpenCV's `%YAML:1.0`.
    Yaml,
    /// JSON, a subset of YAML, with the comments that OpenCV writes: `// ...`.
    Json,
    /// XML of OpenCV's FileStorage.
    Xml,
    /// Python dictionary, as mrcal writes it.
    Literal,
}

/// Parses a file into a tree.
///
/// # Errors
/// Returns an error at the first violation of the syntax, with the remedy.
pub fn parse_keyed(text: &str, syntax: Syntax) -> Result<Node, KeyFault> {
    let tree = match syntax {
        Syntax::Yaml => yaml::parse_yaml(text)?,
        Syntax::Json => yaml::parse_yaml(&yaml::strip_comments(text))?,
        Syntax::Xml => xml::parse_xml(text)?,
        Syntax::Literal => literal::parse_literal(text)?,
    };
    tree.check_duplicate_keys()?;
    Ok(tree)
}
