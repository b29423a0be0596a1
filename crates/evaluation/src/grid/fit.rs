//! Formatting of a table as lines of text that fit the terminal if possible.

use super::{Grid, GridColumn};

/// Width of a terminal, characters.
const TERMINAL_WIDTH: usize = 80;
/// Gap between two columns, characters.
const GAP: usize = 2;
/// Minimum width of a column of wrapped words, characters.
const MIN_WORDS_WIDTH: usize = 20;

/// Columns and cells to be written; a heading or a cell is a list of lines.
struct TextTable {
    columns: Vec<GridColumn>,
    titles: Vec<Vec<String>>,
    rows: Vec<Vec<Vec<String>>>,
}

impl TextTable {
    fn from_grid(grid: &Grid, is_included: impl Fn(&GridColumn) -> bool) -> Self {
        let chosen: Vec<usize> = (0..grid.columns.len())
            .filter(|k| is_included(&grid.columns[*k]))
            .collect();
        let lines = |cell: &String| vec![replace_control_characters(cell)];
        let cells = |row: &Vec<String>| {
            chosen
                .iter()
                .map(|k| row.get(*k).map(lines).unwrap_or_default())
                .collect()
        };
        let columns: Vec<GridColumn> = chosen.iter().map(|k| grid.columns[*k].clone()).collect();
        Self {
            titles: columns.iter().map(|c| lines(&c.title)).collect(),
            rows: grid.rows.iter().map(cells).collect(),
            columns,
        }
    }

    /// Folds headings to two lines: the unit, or the second word, below the first.
    fn fold_titles(mut self) -> Self {
        for title in &mut self.titles {
            let text = title.concat();
            let parted = text.split_once(" / ").or_else(|| text.split_once(' '));
            if let Some((first, second)) = parted.filter(|_| text.chars().count() > 6) {
                *title = vec![first.to_owned(), second.to_owned()];
            }
        }
        self
    }

    /// Wraps headings to the width of their column's cells.
    fn tighten_titles(mut self) -> Self {
        if self.total_width() <= TERMINAL_WIDTH {
            return self;
        }
        for k in 0..self.titles.len() {
            let cells = self.rows.iter().filter_map(|row| row.get(k)).flatten();
            let below = cells.map(|line| line.chars().count()).max().unwrap_or(0);
            let title = self.titles[k].join(" ");
            let longest = word_parts(&title)
                .map(|part| part.trim_end().chars().count())
                .max()
                .unwrap_or(0);
            self.titles[k] = wrap_parts(word_parts(&title), below.max(longest));
        }
        self
    }

    fn column_widths(&self) -> Vec<usize> {
        let longest = |cell: &Vec<String>| {
            cell.iter()
                .map(|line| line.chars().count())
                .max()
                .unwrap_or(0)
        };
        let column = |k: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(k));
            self.titles
                .get(k)
                .into_iter()
                .chain(cells)
                .map(longest)
                .max()
                .unwrap_or(0)
        };
        (0..self.columns.len()).map(column).collect()
    }

    fn total_width(&self) -> usize {
        let widths = self.column_widths();
        widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1)
    }

    /// Wraps the widest column of words so that the table fits, if enough width remains for it.
    fn break_longest_words(mut self) -> Self {
        let widths = self.column_widths();
        let words = (0..widths.len())
            .filter(|k| !self.columns[*k].is_right_aligned)
            .max_by_key(|k| widths[*k]);
        let over = self.total_width().saturating_sub(TERMINAL_WIDTH);
        let Some((k, room)) = words.and_then(|k| Some((k, widths[k].checked_sub(over)?))) else {
            return self;
        };
        if over > 0 && room >= MIN_WORDS_WIDTH {
            for cell in self.rows.iter_mut().filter_map(|row| row.get_mut(k)) {
                *cell = wrap_parts(cell.concat().split_inclusive(' '), room);
            }
        }
        self
    }

    fn to_text(&self) -> String {
        let widths = self.column_widths();
        let rule: Vec<Vec<String>> = widths.iter().map(|w| vec!["-".repeat(*w)]).collect();
        let mut out = String::new();
        for row in [&self.titles, &rule].into_iter().chain(&self.rows) {
            let height = row.iter().map(Vec::len).max().unwrap_or(1);
            for line in 0..height {
                self.append_text_line(&mut out, row, &widths, line);
            }
        }
        out
    }

    fn append_text_line(
        &self,
        out: &mut String,
        row: &[Vec<String>],
        widths: &[usize],
        line: usize,
    ) {
        for ((cell, column), width) in row.iter().zip(&self.columns).zip(widths) {
            let text = cell.get(line).map_or("", String::as_str);
            let fill = " ".repeat(width.saturating_sub(text.chars().count()));
            let (before, after) = if column.is_right_aligned {
                (fill.as_str(), "")
            } else {
                ("", fill.as_str())
            };
            out.push_str(&format!("{before}{text}{after}  "));
        }
        out.truncate(out.trim_end_matches(' ').len());
        out.push('\n');
    }
}

/// Formats a table, with all columns in full width if `wide`; a last line gives the number of omitted columns.
pub(super) fn fit_text(grid: &Grid, wide: bool) -> String {
    let whole = TextTable::from_grid(grid, |_| true);
    if wide || whole.total_width() <= TERMINAL_WIDTH {
        return whole.to_text();
    }
    let folded = whole.fold_titles();
    if folded.total_width() <= TERMINAL_WIDTH {
        return folded.to_text();
    }
    let omitted = grid.columns.iter().filter(|c| c.optional).count();
    let text = TextTable::from_grid(grid, |column| !column.optional)
        .fold_titles()
        .tighten_titles()
        .break_longest_words()
        .to_text();
    match omitted {
        0 => text,
        1 => format!("{text}1 more column with --wide\n"),
        n => format!("{text}{n} more columns with --wide\n"),
    }
}

/// Splits a text at blanks and after hyphens.
fn word_parts(text: &str) -> impl Iterator<Item = &str> {
    text.split_inclusive([' ', '-'])
}

/// Joins parts to lines of at most `width` characters, without the blanks at their ends; a longer part has its own line.
fn wrap_parts<'a>(parts: impl Iterator<Item = &'a str>, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for part in parts {
        let used = lines.last().map_or(0, |line| line.chars().count());
        if used > 0 && used + part.trim_end().chars().count() > width {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            line.push_str(part);
        }
    }
    lines
        .iter()
        .map(|line| line.trim_end().to_owned())
        .collect()
}

/// Replaces control characters, so that external names cannot control the terminal.
fn replace_control_characters(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(names: &[&str], cell: &str) -> Grid {
        let mut grid = Grid::new(names);
        grid.push(names.iter().map(|_| cell.to_owned()).collect());
        grid
    }

    #[test]
    fn a_narrow_table_keeps_its_headings_on_one_line() {
        assert_eq!(
            grid(&["<name", "deflection / m"], "1.5").text(),
            "name  deflection / m\n----  --------------\n1.5              1.5\n"
        );
    }

    #[test]
    fn a_wide_table_is_folded_then_loses_optional_columns_then_wraps_words() {
        let folded = grid(
            &[
                "<name",
                "standard deviation / m",
                "standard deviation / m",
                "variance factor / 1",
                "angle / deg",
            ],
            "1",
        )
        .text();
        assert!(
            folded.lines().all(|line| line.chars().count() <= 80) && !folded.contains("--wide"),
            "{folded}"
        );
        assert!(
            folded
                .lines()
                .nth(1)
                .is_some_and(|line| line.contains("m") && !line.contains("angle")),
            "{folded}"
        );
        let mut whole = Grid::new(&[
            "<in",
            "ground-air-ground / kN m",
            "command less screen / ms",
        ]);
        whole.push(vec![
            "a-name-of-forty-characters-and-no-blanks".into(),
            "1972".into(),
            "-5.8".into(),
        ]);
        whole.columns[0].title = "x".repeat(50);
        let tight = whole.text();
        assert!(
            tight.lines().all(|line| line.chars().count() <= 80),
            "{tight}"
        );
        assert!(
            tight
                .lines()
                .nth(1)
                .is_some_and(|line| line.contains("air-") && line.contains("less")),
            "{tight}"
        );
        let spare = grid(
            &["<name", "~a", "~b", "c"],
            "a cell of thirty characters !!",
        )
        .text();
        assert!(spare.contains("2 more columns with --wide"), "{spare}");
        let mut long = Grid::new(&["<marker", "<remark"]);
        long.push(vec![
            "M01".into(),
            "hidden by glare ".repeat(9).trim_end().into(),
        ]);
        let text = long.text();
        assert!(
            text.lines().count() == 4 && text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
        assert!(
            long.text_with_width(true)
                .lines()
                .any(|line| line.chars().count() > 100)
        );
    }
}
