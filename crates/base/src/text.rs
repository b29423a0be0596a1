//! Text files and their names, as all readers decode them and all messages show them.

use std::borrow::Cow;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;

/// First bytes of files that are not text, with problem and remedy.
const FOREIGN_STARTS: [(&[u8], &str, &str); 4] = [
    (
        b"PK\x03\x04",
        "is a spreadsheet file or an archive",
        "save the table as CSV, UTF-8",
    ),
    (b"\x1f\x8b", "is compressed", "unpack it"),
    (b"\xff\xfe", "is UTF-16 text", "save it as UTF-8"),
    (b"\xfe\xff", "is UTF-16 text", "save it as UTF-8"),
];

/// Decodes a file's text, without a byte order mark and with lines ended by ` `, so that line numbers in messages are
/// right.
///
/// # Errors
/// Returns problem and remedy if the bytes are not text.
pub fn decode_text(bytes: Vec<u8>) -> Result<String, (&'static str, &'static str)> {
    if let Some((_, what, remedy)) = FOREIGN_STARTS
        .iter()
        .find(|(begin, ..)| bytes.starts_with(begin))
    {
        return Err((what, remedy));
    }
    let text =
        String::from_utf8(bytes).map_err(|_| ("is not UTF-8 text", "save it as plain UTF-8"))?;
    if text.contains('\0') {
        return Err(("is not a text file", "save it as plain UTF-8"));
    }
    Ok(text
        .trim_start_matches('\u{feff}')
        .replace("\r\n", "\n")
        .replace('\r', "\n"))
}

/// Formats a name or path on one line. Bytes that are not UTF-8 are shown as `\xfc`, so that names that differ only in them
/// stay distinct.
pub fn printable_path(path: impl AsRef<OsStr>) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    for chunk in path.as_ref().as_bytes().utf8_chunks() {
        for sign in chunk.valid().chars() {
            if sign.is_control() {
                text.extend(sign.escape_default())
            } else {
                text.push(sign)
            }
        }
        chunk.invalid().iter().for_each(|byte| {
            let _ = write!(text, "\\x{byte:02x}");
        });
    }
    text
}

/// Formats a text for a terminal: control characters other than line ends and tabs, with which a name from elsewhere could
/// rewrite the output, are shown as escapes.
pub fn printable_text(text: &str) -> Cow<'_, str> {
    let control = |c: char| c.is_control() && c != '\n' && c != '\t';
    // Most text is ASCII, whose bytes are checked several times faster than characters.
    if text
        .bytes()
        .all(|b| matches!(b, b' '..=b'~' | b'\n' | b'\t'))
        || !text.contains(control)
    {
        return text.into();
    }
    let mut printable = String::with_capacity(text.len());
    for sign in text.chars() {
        if control(sign) {
            printable.extend(sign.escape_default())
        } else {
            printable.push(sign)
        }
    }
    printable.into()
}

/// First characters with which a spreadsheet takes a cell for a formula.
const FORMULA_STARTS: [char; 4] = ['=', '+', '-', '@'];

/// Formats free text as a cell of a table: a spreadsheet must not take it for a formula.
pub fn text_cell(text: &str) -> Cow<'_, str> {
    if text.starts_with(FORMULA_STARTS) {
        format!("'{text}").into()
    } else {
        text.into()
    }
}

/// Returns the text of a cell that [`text_cell`] may have formatted.
pub fn cell_text(cell: &str) -> &str {
    cell.strip_prefix('\'')
        .filter(|text| text.starts_with(FORMULA_STARTS))
        .unwrap_or(cell)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_gets_no_control_characters_and_a_spreadsheet_no_formula() {
        assert_eq!(printable_text("a\u{1b}[2Jb\n\tc"), "a\\u{1b}[2Jb\n\tc");
        for text in ["=1+2", "+1", "-M5", "@x", "'=1"] {
            assert_eq!(
                cell_text(&text_cell(text)),
                text.strip_prefix("'=").map_or(text, |_| "=1"),
                "{text}"
            );
            assert!(!text_cell(text).starts_with(FORMULA_STARTS));
        }
        assert_eq!(
            (text_cell("M05"), cell_text("'quoted'")),
            ("M05".into(), "'quoted'")
        );
    }

    #[test]
    fn text_of_any_system_reads_equal_and_other_bytes_are_named() {
        assert_eq!(
            decode_text(b"\xef\xbb\xbfa\r\nb\rc".to_vec()),
            Ok("a\nb\nc".to_owned())
        );
        for (bytes, what) in [
            (&b"PK\x03\x04..."[..], "spreadsheet"),
            (b"\x1f\x8b\x08", "compressed"),
            (b"\xff\xfea\0", "UTF-16"),
            (b"a\0b\0", "not a text file"),
            (b"fl\xfcgel", "not UTF-8"),
        ] {
            let found = decode_text(bytes.to_vec());
            assert!(
                found.is_err_and(|(problem, _)| problem.contains(what)),
                "{what}"
            );
        }
    }

    #[test]
    fn names_that_are_not_utf8_stay_distinct() {
        let names = [b"fl\xfcgel".as_slice(), b"fl\xe4gel"]
            .map(|name| printable_path(OsStr::from_bytes(name)));
        assert_eq!(names, ["fl\\xfcgel", "fl\\xe4gel"]);
        assert_eq!(printable_path("C:\new/flügel"), "C:\\new/flügel");
    }
}
