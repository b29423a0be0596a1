//! Messages of many frames gathered by kind: texts that differ in their numbers alone.

/// Messages of one kind, in the order of their first appearance.
#[derive(Clone, Debug, PartialEq)]
pub struct MessageKind {
    /// Text without its numbers.
    kind: String,
    /// First text.
    pub text: String,
    /// Place of the first text: a frame or a series.
    pub first: String,
    /// Number of places.
    pub count: usize,
    /// Distinct subjects of the messages, such as ids of markers.
    pub subjects: Vec<String>,
    is_varied: bool,
    last: String,
}

impl MessageKind {
    /// Returns the text; numbers that differ between the messages are left out.
    pub fn common_text(&self) -> &str {
        if self.is_varied {
            &self.kind
        } else {
            &self.text
        }
    }
}

/// Replaces each number of a text by an ellipsis.
fn text_without_numbers(text: &str) -> String {
    let mut kind = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let number = &rest[at..];
        let after = number.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
        kind.push_str(&rest[..at]);
        kind.push('…');
        // A full stop ends the sentence.
        if number[..number.len() - after.len()].ends_with('.') {
            kind.push('.');
        }
        rest = after;
    }
    kind + rest
}

/// Gathers messages, each with its place and its subject.
pub fn gather_messages<'a>(
    messages: impl Iterator<Item = (&'a str, String, &'a str)>,
) -> Vec<MessageKind> {
    let mut kinds: Vec<MessageKind> = vec![];
    for (text, place, subject) in messages {
        let kind = text_without_numbers(text);
        let Some(known) = kinds.iter_mut().find(|known| known.kind == kind) else {
            kinds.push(MessageKind {
                kind,
                text: text.to_owned(),
                first: place.clone(),
                count: 1,
                subjects: vec![subject.to_owned()],
                is_varied: false,
                last: place,
            });
            continue;
        };
        known.is_varied |= known.text != text;
        if known.last != place {
            known.count += 1;
            known.last = place;
        }
        if !known.subjects.iter().any(|other| other == subject) {
            known.subjects.push(subject.to_owned());
        }
    }
    kinds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_that_differ_in_numbers_are_one_kind() {
        let message = |text, place: &str, id| (text, place.to_owned(), id);
        let kinds = gather_messages(
            [
                message("not found near (12.5, 3) px.", "a.jpg", "M01"),
                message("not found near (7, 1234.5) px.", "a.jpg", "M02"),
                message("hidden", "a.jpg", "M03"),
                message("not found near (12.5, 3) px.", "b.jpg", "M01"),
            ]
            .into_iter(),
        );
        assert_eq!(kinds.len(), 2);
        assert_eq!(kinds[0].common_text(), "not found near (…, …) px.");
        assert_eq!((kinds[0].count, kinds[0].first.as_str()), (2, "a.jpg"));
        assert_eq!(kinds[0].subjects, ["M01", "M02"]);
        assert_eq!(kinds[1].common_text(), "hidden");
    }
}
