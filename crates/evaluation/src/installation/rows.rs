//! Reader of all CSV files (RFC 4180: quotes, separators within them). Lines are not trimmed, so a blank first cell is
//! kept.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::columns::find_columns;
use super::reader::{Reader, range_problem};
use wingd_base::fault::{Fault, FaultSubject};

/// Record of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Line on which it begins, from 1.
    pub line: u64,
    /// Text in the file, without its line end.
    pub text: String,
    /// Cells without their quotes and surrounding blanks.
    pub cells: Vec<String>,
}

impl Row {
    /// Returns whether all cells are empty.
    pub fn is_blank(&self) -> bool {
        self.cells.iter().all(String::is_empty)
    }

    /// Returns whether a cell beyond this number of columns is not empty.
    pub fn exceeds(&self, columns: usize) -> bool {
        self.cells.iter().skip(columns).any(|cell| !cell.is_empty())
    }
}

/// Reason why a text is not a table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct RowsError {
    /// Line on which the record begins, from 1.
    pub line: u64,
    problem: String,
}

/// Parses a text into records; blank ones are skipped.
///
/// # Errors
/// Returns an error for the first invalid record.
pub fn parse_rows(text: &str, separator: char) -> Result<Vec<Row>, RowsError> {
    let fault = |line: u64, problem: String| RowsError { line, problem };
    let wide = |_| {
        fault(
            1,
            format!("the separator {separator:?} is not a single byte"),
        )
    };
    let delimiter = u8::try_from(separator).map_err(wide)?;
    let mut csv = csv::ReaderBuilder::new();
    csv.delimiter(delimiter).has_headers(false).flexible(true);
    let mut csv = csv.from_reader(text.as_bytes());
    let mut record = csv::StringRecord::new();
    let mut found: Vec<Row> = vec![];
    loop {
        let begin = csv.position().clone();
        let more = csv.read_record(&mut record).map_err(|error| {
            let line = error.position().map_or(begin.line(), csv::Position::line);
            fault(line, error.to_string())
        })?;
        if !more {
            return Ok(found);
        }
        let bytes = begin.byte() as usize..csv.position().byte() as usize;
        // The parser skips empty lines before a record together with it.
        let raw = text.get(bytes).unwrap_or_default();
        let own = raw.trim_start_matches(['\r', '\n']);
        let line = begin.line() + raw[..raw.len() - own.len()].matches('\n').count() as u64;
        let own = own.trim_end_matches(['\r', '\n']);
        if let Some(problem) = quote_problem(own, separator) {
            return Err(fault(line, problem.to_owned()));
        }
        let cells = record
            .iter()
            .map(|cell| wingd_base::text::cell_text(cell.trim()).to_owned())
            .collect();
        let row = Row {
            line,
            text: own.to_owned(),
            cells,
        };
        if !row.is_blank() {
            found.push(row);
        }
    }
}

/// Returns the error of a record's quotes: an open field swallows all following lines, and readers disagree about `"1"2`.
fn quote_problem(record: &str, separator: char) -> Option<&'static str> {
    let (mut quoted, mut begins) = (false, true);
    let mut signs = record.chars().peekable();
    while let Some(sign) = signs.next() {
        match (sign, quoted) {
            ('"', true) if signs.peek() == Some(&'"') => drop(signs.next()),
            ('"', true) if signs.peek().is_some_and(|next| *next != separator) => {
                return Some("text follows a closing quote");
            }
            ('"', true) => quoted = false,
            ('"', false) => quoted = begins,
            _ => {}
        }
        begins = !quoted && sign == separator;
    }
    quoted.then_some("a quote is not closed")
}

/// Returns whether a first line names the separator, `sep=;`, as spreadsheets write it.
fn is_separator_line(line: &str) -> bool {
    let rest = line.trim_matches(['\r', '\n', '"']).strip_prefix("sep=");
    rest.is_some_and(|sign| sign.chars().count() == 1)
}

/// Line of a table with named columns.
pub(crate) struct TableLine<const N: usize> {
    file: Rc<Path>,
    columns: [&'static str; N],
    /// Line on which it begins, from 1.
    pub number: u64,
    /// Texts in the order of the columns; empty for a missing optional one.
    pub cells: [String; N],
}

impl<const N: usize> TableLine<N> {
    /// Reports an error of the line.
    pub fn fault(
        &self,
        reader: &mut Reader,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        let subject = FaultSubject::Line(self.number);
        reader
            .faults
            .push(Fault::in_table(&*self.file, subject, problem, remedy));
    }

    /// Reports an error of a cell.
    pub fn cell_fault(
        &self,
        reader: &mut Reader,
        k: usize,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        let (line, column) = (self.number, self.columns[k]);
        let subject = FaultSubject::Cell { line, column };
        reader
            .faults
            .push(Fault::in_table(&*self.file, subject, problem, remedy));
    }

    /// Parses a finite number; reports an error if the cell is not one.
    pub fn parse_number(&self, reader: &mut Reader, k: usize) -> Option<f64> {
        let value = self.cells[k].parse::<f64>().ok().filter(|v| v.is_finite());
        if value.is_none() {
            let (line, column) = (self.number, self.columns[k]);
            reader.faults.push(Fault::in_table(
                &*self.file,
                FaultSubject::NoNumber { line, column },
                format!("\"{}\" is not a finite number", self.cells[k]),
                "give a decimal number with a point",
            ));
        }
        value
    }

    /// Parses the numbers of consecutive columns; reports an error for each cell that is not one.
    pub fn parse_numbers<const M: usize>(
        &self,
        reader: &mut Reader,
        first: usize,
    ) -> Option<[f64; M]> {
        let numbers: [Option<f64>; M] =
            std::array::from_fn(|k| self.parse_number(reader, first + k));
        let found: Vec<f64> = numbers.into_iter().flatten().collect();
        found.try_into().ok()
    }

    /// Reports a number of a cell outside its range.
    pub fn check_range(
        &self,
        reader: &mut Reader,
        k: usize,
        value: f64,
        range: RangeInclusive<f64>,
        unit: &str,
    ) {
        if let Some((problem, remedy)) = range_problem(value, range, unit) {
            self.cell_fault(reader, k, problem, remedy);
        }
    }
}

/// Table with named columns.
pub(crate) struct Table<const N: usize> {
    /// Index of each column in the records; `None` for a missing optional one.
    pub index: [Option<usize>; N],
    /// Records below the header, each with a cell per column.
    pub rows: Vec<Row>,
}

/// Reads the lines of a table with named columns, separated by commas; `optional` columns may be missing. One cause is
/// reported once.
pub(crate) fn read_table<const N: usize>(
    reader: &mut Reader,
    name: impl AsRef<Path>,
    remedy: &str,
    columns: [&'static str; N],
    optional: &[&str],
) -> Option<(PathBuf, Vec<TableLine<N>>)> {
    let (file, text) = reader.read_text(name, remedy)?;
    let Table { index, rows } = parse_records(reader, &file, &text, columns, optional)?;
    let shared: Rc<Path> = Rc::from(file.as_path());
    let line = |row: Row| {
        let cell = |k: Option<usize>| k.and_then(|k| row.cells.get(k)).cloned();
        TableLine {
            file: Rc::clone(&shared),
            columns,
            number: row.line,
            cells: index.map(|k| cell(k).unwrap_or_default()),
        }
    };
    Some((file, rows.into_iter().map(line).collect()))
}

/// Parses the text of a table with named columns, as [`read_table`].
pub(crate) fn parse_records<const N: usize>(
    reader: &mut Reader,
    file: &Path,
    text: &str,
    columns: [&'static str; N],
    optional: &[&str],
) -> Option<Table<N>> {
    let needed = columns.iter().filter(|c| !optional.contains(c)).count();
    if text.lines().next().is_some_and(is_separator_line) {
        let remedy = "delete the line: columns are separated by commas";
        reader.fault(
            file,
            "line 1",
            "is a spreadsheet's separator line (sep=)",
            remedy,
        );
        return None;
    }
    let text = blank_comments(reader, file, text, needed);
    let found = match parse_rows(&text, ',') {
        Ok(found) => found,
        Err(error) => {
            reader.fault(
                file,
                &format!("line {}", error.line),
                error.to_string(),
                "correct the line",
            );
            return None;
        }
    };
    let mut found = found.into_iter();
    let header = found.next().unwrap_or_else(|| Row {
        line: 1,
        text: String::new(),
        cells: vec![],
    });
    let index = find_columns(
        reader,
        file,
        (header.line, &header.cells),
        columns,
        optional,
    )?;
    let width = header.cells.len();
    let mut rows = vec![];
    for row in found {
        // Optional columns at the end may be omitted with their commas.
        let short = header
            .cells
            .iter()
            .skip(row.cells.len())
            .any(|name| !optional.contains(&name.as_str()));
        if short || row.exceeds(width) {
            let problem = format!("has {} cells under a header of {width}", row.cells.len());
            let remedy = "give one cell per column: decimal points in numbers, quotes around a text with a comma";
            let subject = FaultSubject::Line(row.line);
            reader
                .faults
                .push(Fault::in_table(file, subject, problem, remedy));
            continue;
        }
        rows.push(row);
    }
    Some(Table { index, rows })
}

/// Replaces comments by empty lines. A line that begins with `#` and is a complete row may be a comment or a name, which is
/// an error.
fn blank_comments(reader: &mut Reader, file: &Path, text: &str, columns: usize) -> String {
    let mut kept = String::with_capacity(text.len());
    for (k, line) in text.lines().enumerate() {
        let comment = line.trim_start().strip_prefix('#');
        if comment
            .is_some_and(|c| !c.starts_with([' ', '\t', '#']) && c.split(',').count() >= columns)
        {
            let id = line.split(',').next().unwrap_or_default().trim();
            let remedy = "write a blank after # if it is a comment, or give a name that does not begin with #";
            reader.fault(
                file,
                &format!("line {}", k + 1),
                format!("\"{id}\" may be a comment or a name"),
                remedy,
            );
        }
        kept.push_str(if comment.is_some() { "" } else { line });
        kept.push('\n');
    }
    kept
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn cells(text: &str, separator: char) -> Vec<(u64, Vec<String>)> {
        parse_rows(text, separator)
            .unwrap()
            .into_iter()
            .map(|row| (row.line, row.cells))
            .collect()
    }

    #[test]
    fn quotes_contain_separators_and_line_ends_and_blank_cells_stay() {
        let found = cells(
            "a,b\r\n\r\n\"x, y\",\"2\n3\"\n\tlast,\" \"\"q\"\" \"\n",
            ',',
        );
        assert_eq!(found[0], (1, vec!["a".into(), "b".into()]));
        assert_eq!(found[1], (3, vec!["x, y".into(), "2\n3".into()]));
        assert_eq!(found[2], (5, vec!["last".into(), "\"q\"".into()]));
        assert_eq!(cells("T/O\t1\t2\n\t3\t4\n", '\t')[1].1, ["", "3", "4"]);
        let problem = |text| parse_rows(text, ',').map_err(|error| (error.line, error.to_string()));
        assert_eq!(
            problem("a,b\n1,\"2\n3,4\n"),
            Err((2, "a quote is not closed".into()))
        );
        assert_eq!(parse_rows("a,b\n1,5\" pipe\n3,4\n", ',').unwrap().len(), 3);
        assert_eq!(
            problem("a,b\n\"1\"2,3\n"),
            Err((2, "text follows a closing quote".into()))
        );
    }

    #[test]
    fn rows_keep_their_text() {
        let found = parse_rows("a;b\n\n \"1\";2 \r\n;;\n3;4", ';').unwrap();
        let texts: Vec<(u64, &str)> = found
            .iter()
            .map(|row| (row.line, row.text.as_str()))
            .collect();
        assert_eq!(texts, [(1, "a;b"), (3, " \"1\";2 "), (5, "3;4")]);
        assert_eq!(
            (is_separator_line("sep=;\r"), is_separator_line("separator")),
            (true, false)
        );
    }
}
