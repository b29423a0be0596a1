//! Keyed files of other programs, read by their own grammars into one tree: YAML (OpenCV, ROS, Kalibr), OpenCV's XML, and
//! the Python literal of mrcal. Comments, quotes, layout and order are the parser's business and not the reader's.

mod literal;
mod tree;
mod xml;
mod yaml;

pub use tree::{Entry, Node, Trouble, Value};

/// How the text of a keyed file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Syntax {
    /// YAML 1.2 with OpenCV's `%YAML:1.0`.
    Yaml,
    /// JSON, a part of YAML, with the comments that OpenCV writes: `// ...`.
    Json,
    /// The XML of OpenCV's FileStorage.
    Xml,
    /// A Python dictionary, as mrcal writes it.
    Literal,
}

/// The tree of a file.
///
/// # Errors
/// The first place that is not of the syntax, with the mend.
pub fn parse(text: &str, syntax: Syntax) -> Result<Node, Trouble> {
    let tree = match syntax {
        Syntax::Yaml => yaml::parse(text)?,
        Syntax::Json => yaml::parse(&yaml::without_comments(text))?,
        Syntax::Xml => xml::parse(text)?,
        Syntax::Literal => literal::parse(text)?,
    };
    tree.no_key_twice()?;
    Ok(tree)
}
