//! A grid is a table that is built once and shown in a terminal or in the report.

use maud::{Markup, html};

/// A column's heading and how its cells are set.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// With the unit.
    pub title: String,
    /// Numbers to the right, words to the left.
    pub right: bool,
}

/// Rows of cells under headings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    /// Left to right.
    pub columns: Vec<Column>,
    /// As many cells each as there are columns.
    pub rows: Vec<Vec<String>>,
}

impl Grid {
    /// Headings; one that starts with `<` is a column of words.
    pub fn new(titles: &[&str]) -> Self {
        let column = |t: &&str| match t.strip_prefix('<') {
            Some(title) => Column { title: title.to_owned(), right: false },
            None => Column { title: (*t).to_owned(), right: true },
        };
        Self { columns: titles.iter().map(column).collect(), rows: Vec::new() }
    }

    /// Begins a table with a row for each of these.
    pub fn each<I>(rows: I) -> Each<I> {
        Each(rows)
    }

    /// Adds a row.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    /// For a terminal: columns two blanks apart, a rule under the headings.
    pub fn text(&self) -> String {
        let titles: Vec<String> = self.columns.iter().map(|c| printable(&c.title)).collect();
        let rows: Vec<Vec<String>> =
            self.rows.iter().map(|r| r.iter().map(|c| printable(c)).collect()).collect();
        let widths: Vec<usize> = (0..titles.len()).map(|i| width(&titles, &rows, i)).collect();
        let rule: Vec<String> = widths.iter().map(|w| "-".repeat(*w)).collect();
        let mut out = self.line(&titles, &widths);
        out.push_str(&self.line(&rule, &widths));
        for row in &rows {
            out.push_str(&self.line(row, &widths));
        }
        out
    }

    /// For the report.
    pub fn html(&self) -> Markup {
        html! {
            table {
                thead { tr { @for c in &self.columns { th.n[c.right] { (c.title.replace("sigma", "σ")) } } } }
                tbody {
                    @for row in &self.rows {
                        tr { @for (cell, c) in row.iter().zip(&self.columns) { td.n[c.right] { (cell) } } }
                    }
                }
            }
        }
    }

    fn line(&self, cells: &[String], widths: &[usize]) -> String {
        let mut out = String::new();
        for ((cell, column), width) in cells.iter().zip(&self.columns).zip(widths) {
            let fill = " ".repeat(width.saturating_sub(cell.chars().count()));
            let (before, after) = if column.right { (fill.as_str(), "") } else { ("", fill.as_str()) };
            out.push_str(&format!("{before}{cell}{after}  "));
        }
        out.truncate(out.trim_end().len());
        out.push('\n');
        out
    }
}

/// A column: its heading, and what stands below of each row.
pub type Titled<'a, T> = (&'a str, &'a dyn Fn(&T) -> String);

/// A table whose columns are still to be named.
pub struct Each<I>(I);

impl<'r, T: 'r, I: IntoIterator<Item = &'r T>> Each<I> {
    /// Of each column its heading, as [`Grid::new`] takes it, and what stands below.
    pub fn columns(self, columns: &[Titled<T>]) -> Grid {
        let titles: Vec<&str> = columns.iter().map(|(title, _)| *title).collect();
        let cells = |row: &T| columns.iter().map(|(_, cell)| cell(row)).collect();
        Grid { rows: self.0.into_iter().map(cells).collect(), ..Grid::new(&titles) }
    }
}

fn width(titles: &[String], rows: &[Vec<String>], column: usize) -> usize {
    let cells = rows.iter().filter_map(|r| r.get(column));
    titles.get(column).into_iter().chain(cells).map(|c| c.chars().count()).max().unwrap_or(0)
}

/// Control characters of outside names must not reach a terminal.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_control_characters_are_harmless() {
        let mut grid = Grid::new(&["<name", "lift / m"]);
        grid.push(vec!["a\u{1b}[2J".into(), "2.93".into()]);
        grid.push(vec!["é".into(), "-0.1".into()]);
        let expected = "name   lift / m\n-----  --------\na\u{fffd}[2J      2.93\né          -0.1\n";
        assert_eq!(grid.text(), expected);
    }

    #[test]
    fn html_is_escaped() {
        let mut grid = Grid::new(&["<name"]);
        grid.push(vec!["<script>".into()]);
        assert!(grid.html().into_string().contains("&lt;script&gt;"));
    }
}
