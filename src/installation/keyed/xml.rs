//! The XML of OpenCV's FileStorage: elements are keys, lists are words between blanks or elements named `_`.

use roxmltree::{Document, Node as Element};

use super::tree::{DEEPEST, Entry, MAX_NODES, Node, Trouble, Value, too_deep, too_many};

/// Its outermost element.
const ROOT: &str = "opencv_storage";

pub(super) fn parse(text: &str) -> Result<Node, Trouble> {
    let document = Document::parse(text).map_err(|error| {
        Trouble::new(error.pos().row as u64, "", format!("is no XML ({error})"), "export it again")
    })?;
    let root = document.root_element();
    if root.tag_name().name() != ROOT {
        let problem = format!("begins with <{}>", root.tag_name().name());
        let mend = format!("give the XML of OpenCV's FileStorage, which begins with <{ROOT}>");
        return Err(Trouble::new(line(&document, &root), "", problem, mend));
    }
    let tree = element(&document, &root, 0)?;
    if tree.size() > MAX_NODES { Err(too_many(0)) } else { Ok(tree) }
}

fn line(document: &Document<'_>, element: &Element<'_, '_>) -> u64 {
    document.text_pos_at(element.range().start).row as u64
}

fn element(document: &Document<'_>, of: &Element<'_, '_>, depth: usize) -> Result<Node, Trouble> {
    let line = line(document, of);
    if depth > DEEPEST {
        return Err(too_deep(line));
    }
    let tag = of.attribute("type_id").map(str::to_owned);
    let children: Vec<Element<'_, '_>> = of.children().filter(Element::is_element).collect();
    if children.is_empty() {
        return Ok(Node { line, tag, value: words(line, of) });
    }
    let within = |child: &Element<'_, '_>| element(document, child, depth + 1);
    let value = if children.iter().all(|c| c.tag_name().name() == "_") {
        Value::List(children.iter().map(within).collect::<Result<_, _>>()?)
    } else {
        let entry = |c: &Element<'_, '_>| Ok(Entry { key: c.tag_name().name().to_owned(), node: within(c)? });
        Value::Map(children.iter().map(entry).collect::<Result<_, Trouble>>()?)
    };
    Ok(Node { line, tag, value })
}

/// A text in quotes, one word, or a list of words. Comments within are none of its text.
fn words(line: u64, of: &Element<'_, '_>) -> Value {
    let text: String = of.children().filter_map(|c| if c.is_text() { c.text() } else { None }).collect();
    let text = text.trim();
    let quoted = text.strip_prefix('"').and_then(|t| t.strip_suffix('"'));
    if let Some(inner) = quoted {
        return Value::Text(inner.to_owned());
    }
    let words: Vec<&str> = text.split_whitespace().collect();
    let node = |word: &&str| Node { line, tag: None, value: Value::Text((*word).to_owned()) };
    match words.len() {
        0 | 1 => Value::Text(text.to_owned()),
        _ => Value::List(words.iter().map(node).collect()),
    }
}
