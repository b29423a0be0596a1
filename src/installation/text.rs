//! Files of text and their names, as every reader takes them and every message shows them.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;

/// What begins files that are no text, what they are, and the mend.
const OTHERS: [(&[u8], &str, &str); 4] = [
    (b"PK\x03\x04", "is a spreadsheet's own file or an archive", "save the table as CSV, UTF-8"),
    (b"\x1f\x8b", "is compressed", "unpack it"),
    (b"\xff\xfe", "is UTF-16 text", "save it as UTF-8"),
    (b"\xfe\xff", "is UTF-16 text", "save it as UTF-8"),
];

/// The text of a file's bytes, without a byte order mark, its lines ended by `\n`: line ends of other systems would put
/// the line numbers of faults out.
///
/// # Errors
/// What else the bytes are, and the mend.
pub fn text_of(bytes: Vec<u8>) -> Result<String, (&'static str, &'static str)> {
    if let Some((_, what, mend)) = OTHERS.iter().find(|(begin, ..)| bytes.starts_with(begin)) {
        return Err((what, mend));
    }
    let text = String::from_utf8(bytes).map_err(|_| ("is not UTF-8 text", "save it as plain UTF-8"))?;
    if text.contains('\0') {
        return Err(("is no text", "save it as plain UTF-8"));
    }
    Ok(text.trim_start_matches('\u{feff}').replace("\r\n", "\n").replace('\r', "\n"))
}

/// A name or path on one line, in which bytes that are no UTF-8 stand as `\xfc`, so that two that differ in them stay two.
pub fn shown_path(path: impl AsRef<OsStr>) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    for chunk in path.as_ref().as_bytes().utf8_chunks() {
        for sign in chunk.valid().chars() {
            if sign.is_control() { text.extend(sign.escape_default()) } else { text.push(sign) }
        }
        chunk.invalid().iter().for_each(|byte| {
            let _ = write!(text, "\\x{byte:02x}");
        });
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_of_any_system_is_one_and_what_is_none_is_named() {
        assert_eq!(text_of(b"\xef\xbb\xbfa\r\nb\rc".to_vec()), Ok("a\nb\nc".to_owned()));
        for (bytes, what) in [
            (&b"PK\x03\x04..."[..], "spreadsheet"),
            (b"\x1f\x8b\x08", "compressed"),
            (b"\xff\xfea\0", "UTF-16"),
            (b"a\0b\0", "no text"),
            (b"fl\xfcgel", "not UTF-8"),
        ] {
            let found = text_of(bytes.to_vec());
            assert!(found.is_err_and(|(problem, _)| problem.contains(what)), "{what}");
        }
    }

    #[test]
    fn names_that_are_no_utf8_stay_two() {
        let names = [b"fl\xfcgel".as_slice(), b"fl\xe4gel"].map(|name| shown_path(OsStr::from_bytes(name)));
        assert_eq!(names, ["fl\\xfcgel", "fl\\xe4gel"]);
        assert_eq!(shown_path("C:\new/flügel"), "C:\\new/flügel");
    }
}
