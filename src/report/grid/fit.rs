//! A grid becomes lines of text no wider than a terminal, where that can be.

use super::{Column, Grid};

/// Of a terminal, characters.
const TERMINAL: usize = 80;
/// Between two columns, characters.
const GAP: usize = 2;
/// Words are not broken into lines narrower than this, characters.
const NARROWEST: usize = 20;

/// How wide a table may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Width {
    /// Of 80 characters.
    Terminal,
    /// As it comes.
    All,
}

/// Columns and cells that are to be written; a heading or a cell is its lines.
struct Sheet {
    columns: Vec<Column>,
    titles: Vec<Vec<String>>,
    rows: Vec<Vec<Vec<String>>>,
}

impl Sheet {
    fn of(grid: &Grid, kept: impl Fn(&Column) -> bool) -> Self {
        let chosen: Vec<usize> = (0..grid.columns.len()).filter(|k| kept(&grid.columns[*k])).collect();
        let cells = |row: &Vec<String>| {
            chosen.iter().map(|k| vec![row.get(*k).map(|cell| printable(cell)).unwrap_or_default()]).collect()
        };
        let columns: Vec<Column> = chosen.iter().map(|k| grid.columns[*k].clone()).collect();
        Self {
            titles: columns.iter().map(|c| vec![printable(&c.title)]).collect(),
            rows: grid.rows.iter().map(cells).collect(),
            columns,
        }
    }

    /// Headings on two lines: the unit, or the second word, under the first.
    fn folded(mut self) -> Self {
        for title in &mut self.titles {
            let text = title.concat();
            let parted = text.split_once(" / ").or_else(|| text.split_once(' '));
            if let Some((first, second)) = parted.filter(|_| text.chars().count() > 6) {
                *title = vec![first.to_owned(), second.to_owned()];
            }
        }
        self
    }

    /// Headings on as many lines as what stands below them asks for.
    fn tight(mut self) -> Self {
        if self.width() <= TERMINAL {
            return self;
        }
        for k in 0..self.titles.len() {
            let cells = self.rows.iter().filter_map(|row| row.get(k)).flatten();
            let below = cells.map(|line| line.chars().count()).max().unwrap_or(0);
            let title = self.titles[k].join(" ");
            let longest = parts(&title).map(|part| part.trim_end().chars().count()).max().unwrap_or(0);
            self.titles[k] = packed(&title, below.max(longest));
        }
        self
    }

    fn widths(&self) -> Vec<usize> {
        let longest = |cell: &Vec<String>| cell.iter().map(|line| line.chars().count()).max().unwrap_or(0);
        let column = |k: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(k));
            self.titles.get(k).into_iter().chain(cells).map(longest).max().unwrap_or(0)
        };
        (0..self.columns.len()).map(column).collect()
    }

    fn width(&self) -> usize {
        let widths = self.widths();
        widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1)
    }

    /// The widest column of words broken, so that the whole fits, where that leaves enough of it.
    fn broken(mut self) -> Self {
        let widths = self.widths();
        let words = (0..widths.len()).filter(|k| !self.columns[*k].right).max_by_key(|k| widths[*k]);
        let over = self.width().saturating_sub(TERMINAL);
        let Some((k, room)) = words.and_then(|k| Some((k, widths[k].checked_sub(over)?))) else {
            return self;
        };
        if over > 0 && room >= NARROWEST {
            for cell in self.rows.iter_mut().filter_map(|row| row.get_mut(k)) {
                *cell = lines_of(&cell.concat(), room);
            }
        }
        self
    }

    fn text(&self) -> String {
        let widths = self.widths();
        let rule: Vec<Vec<String>> = widths.iter().map(|w| vec!["-".repeat(*w)]).collect();
        let mut out = String::new();
        for row in [&self.titles, &rule].into_iter().chain(&self.rows) {
            let height = row.iter().map(Vec::len).max().unwrap_or(1);
            for line in 0..height {
                self.line(&mut out, row, &widths, line);
            }
        }
        out
    }

    fn line(&self, out: &mut String, row: &[Vec<String>], widths: &[usize], line: usize) {
        for ((cell, column), width) in row.iter().zip(&self.columns).zip(widths) {
            let text = cell.get(line).map_or("", String::as_str);
            let fill = " ".repeat(width.saturating_sub(text.chars().count()));
            let (before, after) = if column.right { (fill.as_str(), "") } else { ("", fill.as_str()) };
            out.push_str(&format!("{before}{text}{after}  "));
        }
        out.truncate(out.trim_end_matches(' ').len());
        out.push('\n');
    }
}

/// The table, and a line on what is left out of it.
pub(super) fn text(grid: &Grid, width: Width) -> String {
    let whole = Sheet::of(grid, |_| true);
    if width == Width::All || whole.width() <= TERMINAL {
        return whole.text();
    }
    let folded = whole.folded();
    if folded.width() <= TERMINAL {
        return folded.text();
    }
    let left_out = grid.columns.iter().filter(|c| c.spare).count();
    let text = Sheet::of(grid, |column| !column.spare).folded().tight().broken().text();
    match left_out {
        0 => text,
        1 => format!("{text}1 more column: --wide\n"),
        n => format!("{text}{n} more columns: --wide\n"),
    }
}

/// What may stand on a line of its own: words, and parts of words up to a hyphen.
fn parts(text: &str) -> impl Iterator<Item = &str> {
    text.split_inclusive([' ', '-'])
}

/// Parts of a heading on lines of at most so many characters.
fn packed(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for part in parts(text) {
        let used = lines.last().map_or(0, |line| line.chars().count());
        if used > 0 && used + part.trim_end().chars().count() > width {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            line.push_str(part);
        }
    }
    lines.iter().map(|line| line.trim_end().to_owned()).collect()
}

/// Words on lines of at most so many characters; a longer word has a line of its own.
fn lines_of(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let used = lines.last().map_or(0, |line| line.chars().count());
        if used > 0 && used + 1 + word.chars().count() > width {
            lines.push(String::new());
        }
        if let Some(line) = lines.last_mut() {
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
    }
    lines
}

/// Control characters of outside names must not reach a terminal.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
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
    fn what_fits_keeps_its_headings_on_a_line() {
        assert_eq!(
            grid(&["<name", "deflection / m"], "1.5").text(),
            "name  deflection / m\n----  --------\n1.5        1.5\n"
        );
    }

    #[test]
    fn what_is_too_wide_is_folded_then_loses_spare_columns_then_breaks_words() {
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
            folded.lines().nth(1).is_some_and(|line| line.contains("m") && !line.contains("angle")),
            "{folded}"
        );
        let mut whole = Grid::new(&["<in", "ground-air-ground / kN m", "command less screen / ms"]);
        whole.push(vec!["a-name-of-forty-characters-and-no-blanks".into(), "1972".into(), "-5.8".into()]);
        whole.columns[0].title = "x".repeat(50);
        let tight = whole.text();
        assert!(tight.lines().all(|line| line.chars().count() <= 80), "{tight}");
        assert!(
            tight.lines().nth(1).is_some_and(|line| line.contains("air-") && line.contains("less")),
            "{tight}"
        );
        let spare = grid(&["<name", "~a", "~b", "c"], "a cell of thirty characters !!").text();
        assert!(spare.contains("2 more columns: --wide"), "{spare}");
        let mut long = Grid::new(&["<marker", "<remark"]);
        long.push(vec!["M01".into(), "hidden by glare ".repeat(9).trim_end().into()]);
        let text = long.text();
        assert!(text.lines().count() == 4 && text.lines().all(|line| line.chars().count() <= 80), "{text}");
        assert!(long.wide().lines().any(|line| line.chars().count() > 100));
    }
}
