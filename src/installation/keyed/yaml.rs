//! YAML: events of `saphyr-parser` into the tree.

use std::collections::HashMap;

use saphyr_parser::{Event, Parser};

use super::tree::{DEEPEST, Entry, MAX_NODES, Node, Trouble, Value, too_deep, too_many};

/// The first line of OpenCV's files, which YAML does not know.
const OPENCV: &str = "%YAML:";

/// The key by which YAML 1.1 takes the keys of another map in.
const MERGE: &str = "<<";

pub(super) fn parse(text: &str) -> Result<Node, Trouble> {
    // As a comment the line keeps its place and those after it their numbers.
    let text = text.strip_prefix(OPENCV).map_or_else(|| text.to_owned(), |rest| format!("#YAML:{rest}"));
    let mut builder = Builder::default();
    for event in Parser::new_from_str(&text) {
        let (event, span) = event.map_err(|error| {
            let mend =
                "write it as YAML: keys in line, blanks instead of tabs, lists in brackets or with dashes";
            Trouble::new(error.marker().line() as u64, "", format!("is no YAML ({})", error.info()), mend)
        })?;
        builder.take(event, span.start.line() as u64)?;
    }
    // `rostopic echo` ends what it prints with `---`: a document of nothing.
    let nothing =
        |node: &Node| node.tag.is_none() && node.text().is_some_and(|text| ["", "~"].contains(&text));
    let mut documents = builder.documents.into_iter().filter(|document| !nothing(document));
    match (documents.next(), documents.next()) {
        (Some(document), None) => Ok(document),
        (None, _) => Err(Trouble::new(0, "", "holds nothing", "export it again")),
        (Some(_), Some(second)) => {
            let problem = "holds several documents (---)";
            Err(Trouble::new(second.line, "", problem, "keep the one of the camera in a file of its own"))
        }
    }
}

/// JSON without comments from `//` to a line's end; no string of JSON goes over a line's end.
pub(super) fn without_comments(text: &str) -> String {
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

/// A map or list that has not ended.
struct Open {
    line: u64,
    tag: Option<String>,
    anchor: usize,
    /// `None`: a list.
    entries: Option<Vec<Entry>>,
    items: Vec<Node>,
    /// The key whose value comes next.
    key: Option<String>,
}

#[derive(Default)]
struct Builder {
    open: Vec<Open>,
    anchors: HashMap<usize, Node>,
    nodes: usize,
    documents: Vec<Node>,
}

impl Builder {
    fn take(&mut self, event: Event<'_>, line: u64) -> Result<(), Trouble> {
        match event {
            Event::Scalar(text, _, anchor, tag) => {
                let tag = tag.map(|t| t.suffix.clone());
                self.put(Node { line, tag, value: Value::Text(text.into_owned()) }, anchor)
            }
            Event::Alias(anchor) => {
                let again = self.anchors.get(&anchor).cloned();
                let mend = "write the value out";
                let node = again.ok_or_else(|| Trouble::new(line, "", "repeats what is not whole", mend))?;
                self.nodes += node.size();
                self.put(node, 0)
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
        entries: Option<Vec<Entry>>,
    ) -> Result<(), Trouble> {
        if self.open.len() >= DEEPEST {
            return Err(too_deep(line));
        }
        self.open.push(Open { line, tag, anchor, entries, items: vec![], key: None });
        Ok(())
    }

    fn end(&mut self) -> Result<(), Trouble> {
        let Some(Open { line, tag, anchor, entries, items, .. }) = self.open.pop() else { return Ok(()) };
        let value = entries.map_or(Value::List(items), Value::Map);
        self.put(Node { line, tag, value }, anchor)
    }

    /// A whole value goes to where it belongs.
    fn put(&mut self, node: Node, anchor: usize) -> Result<(), Trouble> {
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
            (Some(key), _) => entries.push(Entry { key, node }),
            (None, Value::Text(key)) if key == MERGE => {
                let problem = "takes keys of another place in, which is not read";
                return Err(Trouble::new(node.line, MERGE, problem, "write the keys out where they count"));
            }
            (None, Value::Text(key)) => open.key = Some(key.clone()),
            (None, _) => {
                return Err(Trouble::new(node.line, "", "has a list for a key", "give every value a name"));
            }
        }
        Ok(())
    }
}
