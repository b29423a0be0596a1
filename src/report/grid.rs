//! A grid is a table that is built once and shown in a terminal or in the report.

mod fit;

use maud::{Markup, html};

/// Words up to so many characters stay on one line of the report; longer ones get room for as many.
const SHORT: usize = 24;

/// A column's heading and how its cells are set.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// With the unit.
    pub title: String,
    /// Numbers to the right, words to the left.
    pub right: bool,
    /// Left out where the table is too wide for a terminal.
    pub spare: bool,
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
    /// Headings; one that starts with `<` is a column of words, one with `~` before that is left out where there is no
    /// room for it.
    pub fn new(titles: &[&str]) -> Self {
        let column = |t: &&str| {
            let (spare, title) = t.strip_prefix('~').map_or((false, *t), |title| (true, title));
            let (right, title) = title.strip_prefix('<').map_or((true, title), |title| (false, title));
            Column { title: title.to_owned(), right, spare }
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

    /// For a terminal of 80 columns: columns two blanks apart, a rule under the headings. What is wider gets its headings
    /// on two lines, then loses its spare columns, then has its longest words on several lines.
    pub fn text(&self) -> String {
        fit::text(self, fit::Width::Terminal)
    }

    /// Every column, as wide as it comes.
    pub fn wide(&self) -> String {
        fit::text(self, fit::Width::All)
    }

    /// As [`Self::wide`] or as [`Self::text`].
    pub fn text_at(&self, wide: bool) -> String {
        if wide { self.wide() } else { self.text() }
    }

    /// For the report.
    pub fn html(&self) -> Markup {
        let classes: Vec<&str> = (0..self.columns.len()).map(|k| self.class(k)).collect();
        html! {
            table {
                thead { tr { @for (c, class) in self.columns.iter().zip(&classes) { th class=(class) { (c.title.replace("sigma", "σ")) } } } }
                tbody {
                    @for row in &self.rows {
                        tr { @for (cell, class) in row.iter().zip(&classes) { td class=(class) { (cell) } } }
                    }
                }
            }
        }
    }

    /// How the report sets a column: numbers, short words, long words.
    fn class(&self, column: usize) -> &'static str {
        let long = |row: &Vec<String>| row.get(column).is_some_and(|cell| cell.chars().count() > SHORT);
        match self.columns.get(column) {
            Some(Column { right: true, .. }) => "n",
            _ if self.rows.iter().any(long) => "l",
            _ => "s",
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_control_characters_are_harmless() {
        let mut grid = Grid::new(&["<name", "deflection / m"]);
        grid.push(vec!["a\u{1b}[2J".into(), "2.93".into()]);
        grid.push(vec!["é".into(), "-0.1".into()]);
        let expected = "name   deflection / m\n-----  --------\na\u{fffd}[2J      2.93\né          -0.1\n";
        assert_eq!(grid.text(), expected);
    }

    #[test]
    fn html_is_escaped() {
        let mut grid = Grid::new(&["<name"]);
        grid.push(vec!["<script>".into()]);
        assert!(grid.html().into_string().contains("&lt;script&gt;"));
    }
}
