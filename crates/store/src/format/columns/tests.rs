//! Round trip of rows; torn, changed and misplaced blocks are rejected.
use serde_json::json;

use super::block::{encode_block, first_block_digest};
use super::*;
use crate::jsonl;

fn table() -> LiveTable {
    let column = |name: &str, unit: &str, kind, width| LiveColumn {
        name: name.into(),
        unit: unit.into(),
        kind,
        width,
    };
    let columns = vec![
        column("utc", UTC, ValueKind::U64, 1),
        column("markers.deflection", "m", ValueKind::F32, 3),
        column("latency", "ms", ValueKind::F64, 1),
        column("number", "", ValueKind::U32, 1),
        column("markers.used", "", ValueKind::U8, 3),
    ];
    LiveTable {
        source: json!({"markers": ["M1", "M2", "M3"]}),
        columns,
    }
}

/// Rows with the smallest, largest and missing values of every kind.
fn rows(count: usize) -> Vec<LiveRow> {
    let row = |n: usize| {
        let x = n as f64;
        let none = |value: f64| if n % 7 == 3 { f64::NAN } else { value };
        let deflection = |k: f64| f64::from((0.5 + 1e-3 * (x * k).sin()) as f32);
        let moment = 1.7e15 + 1e5 * x;
        let wide = if n == 1 { 2_f64.powi(53) } else { none(moment) };
        let number = if n == 2 {
            f64::from(u32::MAX - 1)
        } else {
            none(x)
        };
        vec![
            wide,
            deflection(1.0),
            none(deflection(2.0)),
            deflection(3.0),
            none(-1e300 * x),
            number,
            0.0,
            none(254.0),
            x % 2.0,
        ]
    };
    (0..count).map(row).collect()
}

fn head() -> LiveHead {
    let utc = "2026-03-01T08:00:00Z".parse().unwrap();
    let began = Stamp {
        utc,
        utc_synchronised: true,
        boot_id: "b".to_owned(),
        since_boot_s: 1.5,
    };
    LiveHead {
        format: FORMAT,
        flight: "f0001".to_owned(),
        began,
        table: table(),
    }
}

/// Encodes blocks as a file; returns it with the end of each block.
fn file(blocks: &[Vec<LiveRow>]) -> (Vec<u8>, Vec<usize>) {
    let mut bytes = jsonl::encode_line(&head()).unwrap();
    let (mut check, mut ends) = (first_block_digest(&bytes), vec![bytes.len()]);
    for rows in blocks {
        let (more, next) = encode_block(&table(), rows, &check).unwrap();
        bytes.extend(more);
        check = next;
        ends.push(bytes.len());
    }
    (bytes, ends)
}

fn same(a: &[LiveRow], b: &[LiveRow]) -> bool {
    let bits = |rows: &[LiveRow]| {
        rows.iter()
            .flatten()
            .map(|v| v.to_bits())
            .collect::<Vec<_>>()
    };
    bits(a) == bits(b)
}

#[test]
fn every_value_of_every_kind_comes_back_and_none_stays_none() {
    let blocks = [rows(50), rows(1), rows(2000)];
    let (bytes, ends) = file(&blocks);
    let mut read = LiveFile::parse(&bytes).unwrap();
    assert_eq!(read.head, head());
    for rows in &blocks {
        let block = read.next_block().unwrap();
        assert_eq!(block.len(), rows.len());
        assert!(same(&block.rows().unwrap(), rows));
        let numbers: Vec<f64> = rows.iter().map(|row| row[5]).collect();
        assert!(
            same(&[block.column_values(3).unwrap()], &[numbers]),
            "one column by itself"
        );
    }
    assert!(read.next_block().is_none() && read.torn_length() == 0);
    assert_eq!(
        intact_prefix(&bytes),
        Some((*ends.last().unwrap(), "f0001".to_owned()))
    );
}

#[test]
fn values_out_of_range_are_refused_with_their_column() {
    let refused = |at: usize, value: f64| {
        let mut row = rows(1).remove(0);
        row[at] = value;
        encode_block(&table(), &[row], &[0; 32])
            .unwrap_err()
            .to_string()
    };
    assert_eq!(refused(5, -1.0), "column number cannot hold -1");
    assert_eq!(
        refused(5, f64::from(u32::MAX)),
        "column number cannot hold 4294967295"
    );
    assert_eq!(refused(8, 0.5), "column markers.used cannot hold 0.5");
    assert_eq!(
        refused(0, 2_f64.powi(54)),
        "column utc cannot hold 18014398509481984"
    );
    let short = encode_block(&table(), &[vec![1.0]], &[0; 32])
        .unwrap_err()
        .to_string();
    assert_eq!(short, "a row has 1 values, its table 9");
}

#[test]
fn a_torn_changed_zeroed_or_misplaced_block_ends_the_intact_ones() {
    let (bytes, ends) = file(&[rows(20), rows(21), rows(22)]);
    for cut in ends[1]..bytes.len() {
        let good = ends.iter().rev().find(|end| **end <= cut).unwrap();
        assert_eq!(
            intact_prefix(&bytes[..cut]).unwrap().0,
            *good,
            "cut at {cut}"
        );
        let mut zeroed = bytes.clone();
        zeroed[cut..].fill(0);
        let good = ends
            .iter()
            .rev()
            .find(|end| zeroed[..**end] == bytes[..**end])
            .unwrap();
        assert_eq!(intact_prefix(&zeroed).unwrap().0, *good, "zeros from {cut}");
    }
    for changed in ends[1]..ends[2] {
        let mut other = bytes.clone();
        other[changed] ^= 0x10;
        assert_eq!(
            intact_prefix(&other).unwrap().0,
            ends[1],
            "changed at {changed}"
        );
    }
    let without = [&bytes[..ends[1]], &bytes[ends[2]..]].concat();
    assert_eq!(
        intact_prefix(&without).unwrap().0,
        ends[1],
        "the one before is missing"
    );
    let twice = [&bytes[..ends[2]], &bytes[ends[1]..ends[2]]].concat();
    assert_eq!(intact_prefix(&twice).unwrap().0, ends[2]);
    for line in ["", "{}\n", "\n", "{\"format\":2}"] {
        assert!(LiveFile::parse(line.as_bytes()).is_none(), "{line:?}");
    }
}

#[test]
fn a_row_that_its_column_cannot_hold_is_recognised() {
    let table = table();
    let row = &rows(1)[0];
    let beyond: LiveRow = std::iter::once(-1.0)
        .chain(row.iter().skip(1).copied())
        .collect();
    let later: LiveRow = std::iter::once(1e17)
        .chain(row.iter().skip(1).copied())
        .collect();
    assert!(table.accepts(row) && !table.accepts(&beyond) && !table.accepts(&later));
}
