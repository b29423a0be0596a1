//! Promise: the pages of the tables and the fleet's schema follow from the list of quantities.
//!
//! `UPDATE_TABLES=1 cargo test --test system result_tables` writes them; in the schema it adds columns that are missing.

use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::ser::{PrettyFormatter, Serializer};
use serde_json::{Map, Value};
use wingd::aircraft::Quantity;
use wingd::quantities::{
    LiveForm, QuantitySection, ResultQuantity, ResultTable, SECTIONS, Subject, TableColumn,
    ValueGetter, unit_suffix,
};
use wingd::store::ValueKind;

const FRAME_TABLES: [(ResultTable, &str); 5] = [
    (ResultTable::Shots, "shots"),
    (ResultTable::Markers, "markers"),
    (ResultTable::Span, "span"),
    (ResultTable::Moments, "moments"),
    (ResultTable::Parameters, "parameters"),
];

pub fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Compares a file with what follows from the quantities, or writes it.
pub fn assert_or_update(path: &Path, expected: &str) {
    if std::env::var_os("UPDATE_TABLES").is_some() {
        std::fs::write(path, expected).unwrap();
    }
    let text = std::fs::read_to_string(path).unwrap();
    let differing = text
        .lines()
        .zip(expected.lines())
        .find(|(is, should)| is != should);
    let hint = "run UPDATE_TABLES=1 cargo test --test system -- result_tables command_page";
    assert!(
        text == expected,
        "{}: {differing:?}; {hint}",
        path.display()
    );
}

/// Replaces the part of a page between a mark and the next end mark.
pub fn with_part(page: &str, mark: &str, part: &str) -> String {
    let (before, rest) = page.split_once(&format!("<!-- {mark} -->\n")).unwrap();
    let (_, after) = rest.split_once("<!-- end -->").unwrap();
    format!("{before}<!-- {mark} -->\n{part}<!-- end -->{after}")
}

/// Names the tables in which a quantity has a column of its plain name.
fn tables_of(section: &QuantitySection, quantity: &ResultQuantity) -> Vec<&'static str> {
    let frames = FRAME_TABLES
        .iter()
        .filter(|(table, _)| !quantity.only_live && section.tables.contains(table));
    let plain = matches!(
        section.subject,
        Subject::Row | Subject::Pair | Subject::Aircraft
    );
    let is_exported = !matches!(quantity.live, LiveForm::Absent);
    let live = (plain && is_exported).then_some("live");
    frames.map(|(_, name)| *name).chain(live).collect()
}

/// Rows of a page: a quantity without a meaning of its own belongs to the row before.
fn table(quantities: impl Iterator<Item = (String, Vec<&'static str>, &'static str)>) -> String {
    let mut rows: Vec<(Vec<String>, Vec<&str>, &str)> = vec![];
    for (name, tables, meaning) in quantities.filter(|(_, tables, _)| !tables.is_empty()) {
        match rows.last_mut() {
            Some(row) if meaning.is_empty() && row.1 == tables => row.0.push(format!("`{name}`")),
            _ => rows.push((vec![format!("`{name}`")], tables, meaning)),
        }
    }
    let line = |(names, tables, meaning): &(Vec<String>, Vec<&str>, &str)| {
        // The page says that `sigma_` before the name of a value marks its standard deviation.
        let value_is_listed = |name: &&String| !names.contains(&name.replacen("`sigma_", "`", 1));
        let names: Vec<&str> = names
            .iter()
            .filter(|name| !name.starts_with("`sigma_") || value_is_listed(name))
            .map(String::as_str)
            .collect();
        let all = tables.len() == FRAME_TABLES.len() + 1;
        let tables: Vec<String> = tables.iter().map(|table| format!("`{table}`")).collect();
        format!(
            "| {} | {} | {meaning} |\n",
            names.join(", "),
            if all {
                "all".to_owned()
            } else {
                tables.join(", ")
            }
        )
    };
    let lines: String = rows.iter().map(line).collect();
    format!("| columns | tables | |\n|---|---|---|\n{lines}")
}

#[test]
fn the_page_of_the_tables_lists_the_quantities() {
    let plain = SECTIONS.iter().flat_map(|section| {
        section.quantities.iter().flat_map(move |quantity| {
            let names = match section.subject {
                Subject::Pair => vec![format!("torsion_PAIR_{}", quantity.column_name())],
                Subject::Aircraft => Quantity::ALL
                    .map(|one| format!("{}{}", quantity.name, one.name()))
                    .into(),
                _ => vec![quantity.column_name()],
            };
            let meanings = std::iter::once(quantity.meaning).chain(std::iter::repeat(""));
            names
                .into_iter()
                .zip(meanings)
                .map(move |(name, meaning)| (name, tables_of(section, quantity), meaning))
        })
    });
    let lists = SECTIONS.iter().flat_map(|section| {
        let label = match section.subject {
            Subject::Marker => "ID",
            Subject::Station => "sNN",
            Subject::Section => "bNN",
            Subject::CurvatureTerm | Subject::CurvatureTermPair => "N",
            Subject::Row | Subject::Pair | Subject::Aircraft => "",
        };
        let stored = section.quantities.iter().filter(move |quantity| {
            let is_place = matches!(section.subject, Subject::Station | Subject::Section);
            let arc_length = is_place && quantity.name == "arc_length";
            !label.is_empty() && (arc_length || quantity.stored_form().is_some())
        });
        stored.map(move |quantity| {
            let name = format!("{}_{label}{}", quantity.name, unit_suffix(quantity.unit));
            (name, vec!["live"], quantity.meaning)
        })
    });
    let path = file("docs/tables.md");
    let page = std::fs::read_to_string(&path).unwrap();
    assert_or_update(
        &path,
        &with_part(
            &with_part(&page, "columns", &table(plain)),
            "lists",
            &table(lists),
        ),
    );
}

/// Type of a column in the fleet's schema; in tables of frames all numbers are double.
fn arrow_type(quantity: &ResultQuantity, live: bool) -> &'static str {
    let stored = quantity
        .stored_form()
        .filter(|form| live && form.name.is_none())
        .map(|form| form.kind);
    match quantity.value {
        ValueGetter::Text(_) => "string",
        // Whether a marker of a live result was used is stored as a number.
        ValueGetter::Count(_) if quantity.name == "used" => "bool",
        ValueGetter::Flag(_) => "bool",
        ValueGetter::Time(_) => "timestamp[us, tz=UTC]",
        ValueGetter::Count(_) => "int64",
        ValueGetter::Number(_) if stored == Some(ValueKind::F32) => "float",
        ValueGetter::Number(_) => "double",
    }
}

/// Columns of the fleet's tables of live results that come from stored quantities of a subject.
fn stored_columns(subject: Subject) -> Vec<(String, &'static str)> {
    let sections = SECTIONS.iter().filter(|section| section.subject == subject);
    let stored = sections
        .flat_map(|section| section.quantities)
        .filter(|one| one.stored_form().is_some());
    stored
        .map(|one| (one.column_name(), arrow_type(one, true)))
        .collect()
}

#[test]
fn the_schema_of_the_fleet_has_every_column_with_its_type() {
    let path = file("python/wingd/fleet/schema/v3.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let mut schema: Map<String, Value> = serde_json::from_str(&text).unwrap();
    let mut add = |table: &str, columns: Vec<(String, &'static str)>| {
        let known = schema[table].as_object_mut().unwrap();
        for (name, kind) in columns {
            let is = known.entry(name.clone()).or_insert_with(|| kind.into());
            assert_eq!(is, kind, "{table}: {name}");
        }
    };
    let names = |quantity: Quantity| {
        [
            quantity.name().to_owned(),
            format!("sigma_{}", quantity.name()),
        ]
    };
    let aircraft: Vec<_> = Quantity::ALL
        .into_iter()
        .flat_map(names)
        .map(|name| (name, "double"))
        .collect();
    let typed = |columns: Vec<TableColumn>, live| {
        columns
            .into_iter()
            .map(move |column| (column.name, arrow_type(column.quantity, live)))
            .collect::<Vec<_>>()
    };
    // The fleet has no table of moments.
    for (table, name) in FRAME_TABLES
        .into_iter()
        .filter(|(_, name)| *name != "moments")
    {
        add(name, typed(TableColumn::of_frames(table, &[]), false));
        add(name, aircraft.clone());
    }
    add("shape", aircraft.clone());
    add("live", typed(TableColumn::of_live(true), true));
    add("live", stored_columns(Subject::Row));
    add("live", typed(TableColumn::of_live(false), true));
    for (table, subject) in [
        ("live_markers", Subject::Marker),
        ("live_span", Subject::Station),
    ] {
        add(table, stored_columns(subject));
        add(table, aircraft.clone());
    }
    let (mut bytes, format) = (vec![], PrettyFormatter::with_indent(b" "));
    schema
        .serialize(&mut Serializer::with_formatter(&mut bytes, format))
        .unwrap();
    assert_or_update(&path, &(String::from_utf8(bytes).unwrap() + "\n"));
}
