//! Connected sets of marked pixels, represented by runs: unmarked pixels cost almost nothing.

use super::bitmask::{WORD_BITS, mark_word, pad_row};

/// Adjacent marked pixels of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    pub y: u32,
    pub from: u32,
    pub to: u32,
}

/// Appends the runs of row `y`, in which marked pixels are not 0.
pub fn find_runs(row: &[u8], y: usize, out: &mut Vec<Run>) {
    let (words, rest) = row.as_chunks();
    let rest = pad_row(rest);
    let words = words
        .iter()
        .chain([&rest])
        .map(|pixels| mark_word([pixels], |[v]| v > 0));
    find_runs_in_words(words, row.len(), y, out);
}

/// Appends the runs of row `y` of `width` pixels, given its marks word by word; marks beyond the width are ignored.
pub fn find_runs_in_words(
    words: impl Iterator<Item = u64>,
    width: usize,
    y: usize,
    out: &mut Vec<Run>,
) {
    let mut open: Option<usize> = None;
    for (k, marks) in words.enumerate() {
        let left = width.saturating_sub(k * WORD_BITS);
        let marks = if left < WORD_BITS {
            marks & ((1 << left) - 1)
        } else {
            marks
        };
        let before = u64::from(open.is_some());
        let mut changes = marks ^ (marks << 1 | before);
        while changes != 0 {
            let x = k * WORD_BITS + changes.trailing_zeros() as usize;
            changes &= changes - 1;
            match open {
                Some(_) => close_open_run(&mut open, x, y, out),
                None => open = Some(x),
            }
        }
    }
    close_open_run(&mut open, width, y, out);
}

/// Returns the parts of runs with values of at least `least`, given the values of their pixels run by run.
pub fn runs_at_least(runs: &[Run], mut pixels: &[u8], least: u8) -> Vec<Run> {
    let mut out = Vec::new();
    for run in runs {
        let (first, last) = (run.from as usize, run.to as usize);
        let (own, rest) = pixels.split_at((last + 1 - first).min(pixels.len()));
        pixels = rest;
        let mut open = None;
        for (x, &v) in (first..).zip(own) {
            if v >= least {
                open.get_or_insert(x);
            } else {
                close_open_run(&mut open, x, run.y as usize, &mut out);
            }
        }
        close_open_run(&mut open, last + 1, run.y as usize, &mut out);
    }
    out
}

fn close_open_run(open: &mut Option<usize>, end: usize, y: usize, out: &mut Vec<Run>) {
    if let Some(from) = open.take() {
        out.push(Run {
            y: y as u32,
            from: from as u32,
            to: end as u32 - 1,
        });
    }
}

/// Groups runs into 8-connected sets, in the order of the sets' first pixels. `runs` are ordered by row.
pub fn connected_sets(runs: &[Run]) -> ConnectedSets {
    let mut parent: Vec<u32> = (0..runs.len() as u32).collect();
    let mut above = 0;
    for (i, run) in runs.iter().enumerate() {
        while above < i && (runs[above].y + 1 < run.y || ends_before(&runs[above], run)) {
            above += 1;
        }
        let touching = runs[above..i]
            .iter()
            .take_while(|r| r.y < run.y && r.from <= run.to + 1);
        for k in above..above + touching.count() {
            join_sets(&mut parent, i, k);
        }
    }
    // The root of a set is its first run, so the roots of all earlier runs are final.
    for i in 0..parent.len() {
        parent[i] = parent[parent[i] as usize];
    }
    // For each set the number of runs, then the index of its next run.
    let mut next = vec![0u32; runs.len()];
    parent.iter().for_each(|&root| next[root as usize] += 1);
    let mut ends = Vec::new();
    let mut end = 0;
    for place in next.iter_mut().filter(|count| **count > 0) {
        let begin = end;
        end += *place;
        ends.push(end as usize);
        *place = begin;
    }
    let mut out = runs.to_vec();
    for (run, &root) in runs.iter().zip(&parent) {
        let place = &mut next[root as usize];
        out[*place as usize] = *run;
        *place += 1;
    }
    ConnectedSets { runs: out, ends }
}

/// Runs, ordered by set.
pub struct ConnectedSets {
    runs: Vec<Run>,
    ends: Vec<usize>,
}

impl ConnectedSets {
    /// Returns the runs of each set, ordered by row.
    pub fn iter(&self) -> impl Iterator<Item = &[Run]> {
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        begins
            .zip(&self.ends)
            .map(|(begin, &end)| &self.runs[begin..end])
    }
}

/// Returns true if a run of the row above ends before `run` begins.
fn ends_before(above: &Run, run: &Run) -> bool {
    above.y + 1 == run.y && above.to + 1 < run.from
}

fn find_root(parent: &mut [u32], i: usize) -> usize {
    let mut i = i as u32;
    while parent[i as usize] != i {
        let next = parent[parent[i as usize] as usize];
        parent[i as usize] = next;
        i = next;
    }
    i as usize
}

fn join_sets(parent: &mut [u32], one: usize, other: usize) {
    let (a, b) = (find_root(parent, one), find_root(parent, other));
    parent[a.max(b)] = a.min(b) as u32;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_those_of_a_flood_fill() {
        let mut seed = 7u64;
        for density in [1, 3, 6, 12] {
            let (width, height) = (53, 31);
            let marks: Vec<u8> = (0..width * height)
                .map(|_| {
                    seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    u8::from((seed >> 33) % 20 < density)
                })
                .collect();
            let mut runs = Vec::new();
            marks
                .chunks(width)
                .enumerate()
                .for_each(|(y, row)| find_runs(row, y, &mut runs));
            let sets = connected_sets(&runs);
            let mut label = vec![0usize; marks.len()];
            for (k, set) in sets.iter().enumerate() {
                for r in set {
                    (r.from..=r.to).for_each(|x| label[r.y as usize * width + x as usize] = k + 1);
                }
            }
            let level: Vec<u8> = marks
                .iter()
                .enumerate()
                .map(|(i, m)| m * (1 + (i % 3) as u8))
                .collect();
            for least in 1..=3 {
                let own = |r: &Run| {
                    level[r.y as usize * width..][r.from as usize..=r.to as usize].to_vec()
                };
                let passed: Vec<u8> = runs.iter().flat_map(own).collect();
                let dark: Vec<u8> = level.iter().map(|&v| u8::from(v >= least)).collect();
                let mut want = Vec::new();
                dark.chunks(width)
                    .enumerate()
                    .for_each(|(y, row)| find_runs(row, y, &mut want));
                assert_eq!(runs_at_least(&runs, &passed, least), want);
            }
            assert!(label.iter().zip(&marks).all(|(&l, &m)| (l > 0) == (m > 0)));
            assert_eq!(flooded(&marks, width), sets.iter().count());
            // Neighbours have the same label.
            for i in 0..marks.len() {
                for n in neighbours(i, width, height) {
                    assert!(label[i] == 0 || label[n] == 0 || label[i] == label[n]);
                }
            }
        }
    }

    fn neighbours(i: usize, width: usize, height: usize) -> Vec<usize> {
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        rows.flat_map(|v| {
            (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |u| v * width + u)
        })
        .collect()
    }

    fn flooded(marks: &[u8], width: usize) -> usize {
        let (mut left, mut count) = (marks.to_vec(), 0);
        while let Some(start) = left.iter().position(|&m| m > 0) {
            count += 1;
            let mut stack = vec![start];
            while let Some(i) = stack.pop() {
                if left[i] > 0 {
                    left[i] = 0;
                    stack.extend(neighbours(i, width, marks.len() / width));
                }
            }
        }
        count
    }
}
