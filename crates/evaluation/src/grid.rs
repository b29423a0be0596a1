//! Tables that are built once and shown in a terminal or in the report.

mod fit;

use maud::{Markup, html};

use ColumnDefinition::{One, Pair};

/// Maximum length, in characters, of a cell that stays on one line of the report; columns with longer cells are set wider.
const MAX_SHORT_CELL: usize = 24;

/// Heading of a column, and how its cells are set.
#[derive(Clone, Debug, PartialEq)]
pub struct GridColumn {
    /// Heading, with the unit.
    pub title: String,
    /// Aligned right (numbers) instead of left (words).
    pub is_right_aligned: bool,
    /// Omitted if the table is too wide for a terminal.
    pub optional: bool,
}

/// Table: rows of cells under headings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    /// Columns from left to right.
    pub columns: Vec<GridColumn>,
    /// Rows; each has one cell per column.
    pub rows: Vec<Vec<String>>,
}

impl Grid {
    /// Creates an empty table. A heading with the prefix `<` marks a column of words; a `~` before it marks an optional
    /// column, which is omitted if there is no room for it.
    pub fn new(titles: &[&str]) -> Self {
        let column = |t: &&str| {
            let (optional, title) = t
                .strip_prefix('~')
                .map_or((false, *t), |title| (true, title));
            let (is_right_aligned, title) = title
                .strip_prefix('<')
                .map_or((true, title), |title| (false, title));
            GridColumn {
                title: title.to_owned(),
                is_right_aligned,
                optional,
            }
        };
        Self {
            columns: titles.iter().map(column).collect(),
            rows: Vec::new(),
        }
    }

    /// Begins a table with one row per item.
    pub fn for_rows<I>(rows: I) -> GridRows<I> {
        GridRows(rows)
    }

    /// Adds a row.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    /// Formats the table for a terminal of 80 columns: two blanks between columns, a rule under the headings. If it is too
    /// wide, its headings are folded to two lines, then optional columns are omitted, then the longest words are wrapped.
    pub fn text(&self) -> String {
        self.text_with_width(false)
    }

    /// Formats the table with all columns in full width if `wide`, otherwise as [`Self::text`].
    pub fn text_with_width(&self, wide: bool) -> String {
        fit::fit_text(self, wide)
    }

    /// Formats the table as HTML for the report.
    pub fn html(&self) -> Markup {
        let classes: Vec<&str> = (0..self.columns.len())
            .map(|k| self.column_class(k))
            .collect();
        html! {
            div.scroll tabindex="0" { table {
                thead { tr { @for (c, class) in self.columns.iter().zip(&classes) { th class=(class) { (c.title.replace("sigma", "σ")) } } } }
                tbody {
                    @for row in &self.rows {
                        tr { @for (cell, class) in row.iter().zip(&classes) { td class=(class) { (cell) } } }
                    }
                }
            } }
        }
    }

    /// Returns the CSS class of a column: numbers `n`, short words `s`, long words `l`.
    fn column_class(&self, column: usize) -> &'static str {
        let long = |row: &Vec<String>| {
            row.get(column)
                .is_some_and(|cell| cell.chars().count() > MAX_SHORT_CELL)
        };
        match self.columns.get(column) {
            Some(GridColumn {
                is_right_aligned: true,
                ..
            }) => "n",
            _ if self.rows.iter().any(long) => "l",
            _ => "s",
        }
    }
}

/// Definition of columns: their headings, and the function that makes their cells from an item.
pub enum ColumnDefinition<'a, T> {
    /// Single column.
    One(&'a str, &'a dyn Fn(&T) -> String),
    /// Value and its standard deviation, which are rounded together.
    Pair(&'a str, &'a str, &'a dyn Fn(&T) -> (String, String)),
}

/// Table whose rows are given and whose columns are not yet defined.
pub struct GridRows<I>(I);

impl<'r, T: 'r, I: IntoIterator<Item = &'r T>> GridRows<I> {
    /// Builds the table from its column definitions; headings have the prefixes of [`Grid::new`].
    pub fn columns(self, columns: &[ColumnDefinition<T>]) -> Grid {
        let titles = columns.iter().flat_map(|column| match column {
            One(title, _) => vec![*title],
            Pair(value, sigma, _) => vec![*value, *sigma],
        });
        let cells = |row: &T| {
            let all = columns.iter().flat_map(|column| match column {
                One(_, cell) => vec![cell(row)],
                Pair(.., cells) => <[String; 2]>::from(cells(row)).to_vec(),
            });
            all.collect()
        };
        Grid {
            rows: self.0.into_iter().map(cells).collect(),
            ..Grid::new(&titles.collect::<Vec<_>>())
        }
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
        let expected = "name   deflection / m\n-----  --------------\na\u{fffd}[2J            2.93\né                -0.1\n";
        assert_eq!(grid.text(), expected);
    }

    #[test]
    fn html_is_escaped() {
        let mut grid = Grid::new(&["<name"]);
        grid.push(vec!["<script>".into()]);
        assert!(grid.html().into_string().contains("&lt;script&gt;"));
    }
}
