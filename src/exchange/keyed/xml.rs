//! Parser of OpenCV's FileStorage in XML: elements are keys, lists are words separated by blanks or elements named `_`.

use roxmltree::{Document, Node as Element};

use super::tree::{KeyedEntry, KeyedValue, MAX_DEPTH, MAX_NODES, Node, too_deep, too_many};
use crate::installation::KeyFault;

/// Outermost element.
const ROOT: &str = "opencv_storage";

/// Maximum number of attributes: the parser compares those of an element with each other.
const MAX_ATTRIBUTES: usize = 10_000;

pub(super) fn parse_xml(text: &str) -> Result<Node, KeyFault> {
    if text.matches('=').count() > MAX_ATTRIBUTES {
        let remedy = "give the XML of OpenCV's FileStorage, which has few";
        return Err(KeyFault::on_line(
            0,
            "",
            format!("has more than {MAX_ATTRIBUTES} attributes"),
            remedy,
        ));
    }
    let document = Document::parse(text).map_err(|error| {
        KeyFault::on_line(
            error.pos().row as u64,
            "",
            format!("is not XML ({error})"),
            "export it again",
        )
    })?;
    let root = document.root_element();
    if root.tag_name().name() != ROOT {
        let problem = format!("begins with <{}>", root.tag_name().name());
        let remedy = format!("give the XML of OpenCV's FileStorage, which begins with <{ROOT}>");
        return Err(KeyFault::on_line(
            element_line(&document, &root),
            "",
            problem,
            remedy,
        ));
    }
    let tree = parse_element(&document, &root, 0)?;
    if tree.size() > MAX_NODES {
        Err(too_many(0))
    } else {
        Ok(tree)
    }
}

fn element_line(document: &Document<'_>, element: &Element<'_, '_>) -> u64 {
    document.text_pos_at(element.range().start).row as u64
}

fn parse_element(
    document: &Document<'_>,
    element: &Element<'_, '_>,
    depth: usize,
) -> Result<Node, KeyFault> {
    let line = element_line(document, element);
    if depth > MAX_DEPTH {
        return Err(too_deep(line));
    }
    let tag = element.attribute("type_id").map(str::to_owned);
    let children: Vec<Element<'_, '_>> = element.children().filter(Element::is_element).collect();
    if children.is_empty() {
        return Ok(Node {
            line,
            tag,
            value: parse_words(line, element),
        });
    }
    let within = |child: &Element<'_, '_>| parse_element(document, child, depth + 1);
    let value = if children.iter().all(|c| c.tag_name().name() == "_") {
        KeyedValue::List(children.iter().map(within).collect::<Result<_, _>>()?)
    } else {
        let entry = |c: &Element<'_, '_>| {
            Ok(KeyedEntry {
                key: c.tag_name().name().to_owned(),
                node: within(c)?,
            })
        };
        KeyedValue::Map(
            children
                .iter()
                .map(entry)
                .collect::<Result<_, KeyFault>>()?,
        )
    };
    Ok(Node { line, tag, value })
}

/// Parses a quoted text, one word, or a list of words. Comments are ignored.
fn parse_words(line: u64, element: &Element<'_, '_>) -> KeyedValue {
    let text: String = element
        .children()
        .filter_map(|c| if c.is_text() { c.text() } else { None })
        .collect();
    let text = text.trim();
    let quoted = text.strip_prefix('"').and_then(|t| t.strip_suffix('"'));
    if let Some(inner) = quoted {
        return KeyedValue::Text(inner.to_owned());
    }
    let words: Vec<&str> = text.split_whitespace().collect();
    let node = |word: &&str| Node {
        line,
        tag: None,
        value: KeyedValue::Text((*word).to_owned()),
    };
    match words.len() {
        0 | 1 => KeyedValue::Text(text.to_owned()),
        _ => KeyedValue::List(words.iter().map(node).collect()),
    }
}
