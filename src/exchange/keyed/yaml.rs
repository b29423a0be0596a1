//! Parser of YAML: converts the events of `saphyr-parser` into the tree.

use std::collections::HashMap;

use saphyr_parser::{Event, Parser};

use super::tree::{KeyedEntry, KeyedValue, MAX_DEPTH, MAX_NODES, Node, too_deep, too_many};
use crate::installation::KeyFault;

/// First line of OpenCV's files, which is not valid YAML.
const OPENCV_DIRECTIVE: &str = "%YAML:";

/// Key by which YAML 1.1 merges another map.
const MERGE_KEY: &str = "<<";

pub(super) fn parse_yaml(text: &str) -> Result<Node, KeyFault> {
    // As a comment, the line stays, and line numbers do not change.
    let text = text
        .strip_prefix(OPENCV_DIRECTIVE)
        .map_or_else(|| text.to_owned(), |rest| format!("#YAML:{rest}"));
    let mut builder = TreeBuilder::default();
    for event in Parser::new_from_str(&text) {
        let (event, span) = event.map_err(|error| {
            let remedy = "write it as YAML: keys aligned, blanks instead of tabs, lists in brackets or with dashes";
            KeyFault::on_line(error.marker().line() as u64, "", format!("is not YAML ({})", error.info()), remedy)
        })?;
        builder.handle_event(event, span.start.line() as u64)?;
    }
    // `rostopic echo` ends its output with `---`, which begins an empty document.
    let nothing = |node: &Node| {
        node.tag.is_none() && node.text().is_some_and(|text| ["", "~"].contains(&text))
    };
    let mut documents = builder
        .documents
        .into_iter()
        .filter(|document| !nothing(document));
    match (documents.next(), documents.next()) {
        (Some(document), None) => Ok(document),
        (None, _) => Err(KeyFault::on_line(0, "", "is empty", "export it again")),
        (Some(_), Some(second)) => {
            let problem = "has several documents (---)";
            Err(KeyFault::on_line(
                second.line,
                "",
                problem,
                "keep only the document of the camera",
            ))
        }
    }
}

/// Removes comments from `//` to the line's end from JSON, whose strings never contain a line end.
pub(super) fn strip_comments(text: &str) -> String {
    let end = |line: &str| {
        let (mut quoted, mut escaped) = (false, false);
        let outside = |(_, sign): &(usize, char)| {
            let quote = *sign == '"' && !escaped;
            quoted ^= quote;
            escaped = *sign == '\\' && !escaped;
            !quoted && !quote
        };
        let outside: Vec<(usize, char)> = line.char_indices().filter(outside).collect();
        let mut pairs = outside.windows(2);
        pairs.find_map(|pair| match pair {
            [(at, '/'), (next, '/')] if *next == at + 1 => Some(*at),
            _ => None,
        })
    };
    let kept = |line: &str| format!("{}\n", &line[..end(line).unwrap_or(line.len())]);
    text.lines().map(kept).collect()
}

/// Map or list that has not ended.
struct OpenCollection {
    line: u64,
    tag: Option<String>,
    anchor: usize,
    /// Entries of a map; `None` for a list.
    entries: Option<Vec<KeyedEntry>>,
    items: Vec<Node>,
    /// Key whose value comes next.
    key: Option<String>,
}

#[derive(Default)]
struct TreeBuilder {
    open: Vec<OpenCollection>,
    anchors: HashMap<usize, Node>,
    nodes: usize,
    documents: Vec<Node>,
}

impl TreeBuilder {
    fn handle_event(&mut self, event: Event<'_>, line: u64) -> Result<(), KeyFault> {
        match event {
            Event::Scalar(text, _, anchor, tag) => {
                let tag = tag.map(|t| t.suffix.clone());
                self.add_node(
                    Node {
                        line,
                        tag,
                        value: KeyedValue::Text(text.into_owned()),
                    },
                    anchor,
                )
            }
            Event::Alias(anchor) => {
                let again = self.anchors.get(&anchor).cloned();
                let remedy = "write the value out";
                let node = again.ok_or_else(|| {
                    KeyFault::on_line(line, "", "refers to an incomplete value", remedy)
                })?;
                self.nodes += node.size();
                self.add_node(node, 0)
            }
            Event::MappingStart(anchor, tag) => {
                self.begin(line, anchor, tag.map(|t| t.suffix.clone()), Some(vec![]))
            }
            Event::SequenceStart(anchor, tag) => {
                self.begin(line, anchor, tag.map(|t| t.suffix.clone()), None)
            }
            Event::MappingEnd | Event::SequenceEnd => self.end(),
            _ => Ok(()),
        }
    }

    fn begin(
        &mut self,
        line: u64,
        anchor: usize,
        tag: Option<String>,
        entries: Option<Vec<KeyedEntry>>,
    ) -> Result<(), KeyFault> {
        if self.open.len() >= MAX_DEPTH {
            return Err(too_deep(line));
        }
        self.open.push(OpenCollection {
            line,
            tag,
            anchor,
            entries,
            items: vec![],
            key: None,
        });
        Ok(())
    }

    fn end(&mut self) -> Result<(), KeyFault> {
        let Some(OpenCollection {
            line,
            tag,
            anchor,
            entries,
            items,
            ..
        }) = self.open.pop()
        else {
            return Ok(());
        };
        let value = entries.map_or(KeyedValue::List(items), KeyedValue::Map);
        self.add_node(Node { line, tag, value }, anchor)
    }

    /// Adds a complete value to the collection that contains it.
    fn add_node(&mut self, node: Node, anchor: usize) -> Result<(), KeyFault> {
        self.nodes += 1;
        if self.nodes > MAX_NODES {
            return Err(too_many(node.line));
        }
        if anchor > 0 {
            self.nodes += node.size();
            self.anchors.insert(anchor, node.clone());
        }
        let Some(open) = self.open.last_mut() else {
            self.documents.push(node);
            return Ok(());
        };
        let Some(entries) = &mut open.entries else {
            open.items.push(node);
            return Ok(());
        };
        match (open.key.take(), &node.value) {
            (Some(key), _) => entries.push(KeyedEntry { key, node }),
            (None, KeyedValue::Text(key)) if key == MERGE_KEY => {
                let problem = "merges keys from elsewhere, which is not supported";
                return Err(KeyFault::on_line(
                    node.line,
                    MERGE_KEY,
                    problem,
                    "write the merged keys out",
                ));
            }
            (None, KeyedValue::Text(key)) => open.key = Some(key.clone()),
            (None, _) => {
                return Err(KeyFault::on_line(
                    node.line,
                    "",
                    "has a list as a key",
                    "give every value a name as its key",
                ));
            }
        }
        Ok(())
    }
}
