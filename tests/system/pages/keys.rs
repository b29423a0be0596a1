//! The reference pages give the default of every key that the program knows, and name no other key.
//!
//! A section of a page names its table in its heading, shows the minimal table as TOML, and lists its keys. The
//! program lists its keys in reply to an unknown one, and confirms defaults if setting them changes nothing.

use std::collections::BTreeSet;
use std::path::Path;

use toml::{Table, Value};
use wingd::installation::Fault;
use wingd::measure::setup::Width;

use super::{ROOT, blocks};

/// A key of no table.
const UNKNOWN: &str = "a_key_that_no_table_has";

/// Reader of a file with such a table: a description of the values found, or the error.
type Read<'a> = &'a dyn Fn(&Table) -> Result<String, String>;

/// A part of a page, about one table.
struct Section {
    heading: String,
    /// Names from the top down.
    path: Vec<String>,
    least: Table,
    /// Key and content of the column `default`.
    rows: Vec<(String, String)>,
}

/// Sections of a page about a table; `base` is the text that each needs in addition to its own block.
fn sections(page: &str, base: &Table) -> Vec<Section> {
    let text = std::fs::read_to_string(Path::new(ROOT).join(page)).unwrap();
    let parts = text.split("\n## ").skip(1).map(str::to_owned);
    let of = |part: String| {
        let (heading, body) = part.split_once('\n').unwrap();
        let name = heading
            .split('`')
            .nth(1)
            .filter(|name| name.starts_with('['));
        let rows: Vec<(String, String)> = body.lines().filter_map(row).collect();
        if rows.is_empty() {
            return None;
        }
        let path = name.map_or(vec![], |name| {
            name.trim_matches(['[', ']'])
                .split('.')
                .map(str::to_owned)
                .collect()
        });
        let mut least = base.clone();
        for block in blocks(body).iter().filter(|block| block.language == "toml") {
            merge(&mut least, block.text.parse().unwrap());
        }
        Some(Section {
            heading: heading.to_owned(),
            path,
            least,
            rows,
        })
    };
    parts.filter_map(of).collect()
}

/// Key and default of a row `| key | type | default | meaning |`.
fn row(line: &str) -> Option<(String, String)> {
    let cells: Vec<&str> = line.strip_prefix('|')?.split('|').map(str::trim).collect();
    let key = cells.first()?.strip_prefix('`')?.strip_suffix('`')?;
    Some((key.to_owned(), (*cells.get(2)?).to_owned()))
}

/// A camera of another kind replaces the first; other tables are merged.
fn merge(into: &mut Table, from: Table) {
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(Value::Table(old)), Value::Table(new)) if !new.contains_key("kind") => {
                merge(old, new)
            }
            (_, value) => drop(into.insert(key, value)),
        }
    }
}

/// The table of a path, created if it is missing; of a list of tables the first.
fn table_at<'a>(table: &'a mut Table, path: &[String]) -> &'a mut Table {
    path.iter().fold(table, |table, name| {
        let value = table
            .entry(name.clone())
            .or_insert_with(|| Value::Table(Table::new()));
        match value {
            Value::Array(list) => list.first_mut().and_then(Value::as_table_mut).unwrap(),
            value => value.as_table_mut().unwrap(),
        }
    })
}

/// Names in an error: unknown field `x`, expected one of `a`, `b`.
fn expected(complaint: &str) -> Option<BTreeSet<String>> {
    let (_, names) = complaint.split_once(&format!("unknown field `{UNKNOWN}`, expected "))?;
    let names = names.split('\n').next()?;
    Some(
        names
            .split('`')
            .skip(1)
            .step_by(2)
            .map(str::to_owned)
            .collect(),
    )
}

impl Section {
    fn table_with(&self, key: &str, value: Value) -> Table {
        let mut table = self.least.clone();
        table_at(&mut table, &self.path).insert(key.to_owned(), value);
        table
    }

    fn table_without(&self, key: &str) -> Table {
        let mut table = self.least.clone();
        table_at(&mut table, &self.path).remove(key);
        table
    }

    /// Faults of the section.
    fn faults(&self, read: Read) -> Vec<String> {
        let complaint = read(&self.table_with(UNKNOWN, Value::Integer(1)))
            .err()
            .unwrap_or_default();
        let Some(mut known) = expected(&complaint) else {
            return vec![format!("no keys in: {complaint}")];
        };
        let listed: BTreeSet<String> = self.rows.iter().map(|(key, _)| key.clone()).collect();
        // The key that selects the kind of a table is no field of any kind.
        if table_at(&mut self.least.clone(), &self.path).contains_key("kind") {
            known.insert("kind".to_owned());
        }
        let mut faults: Vec<String> = known
            .difference(&listed)
            .map(|key| format!("does not list `{key}`"))
            .collect();
        faults.extend(
            listed
                .difference(&known)
                .map(|key| format!("lists `{key}`, which is not known")),
        );
        let wrong = |(key, default): &(String, String)| self.wrong_default(key, default, read);
        faults.extend(self.rows.iter().filter_map(wrong));
        faults
    }

    fn wrong_default(&self, key: &str, default: &str, read: Read) -> Option<String> {
        let without = read(&self.table_without(key));
        let literal = default
            .strip_prefix('`')
            .and_then(|rest| rest.strip_suffix('`'));
        match (default, literal) {
            (required, _) if required.starts_with("required") => {
                let missing = [
                    format!("missing field `{key}`"),
                    format!(".{key}: is missing"),
                    format!("needs a text as `{key}`"),
                ];
                let asked = without
                    .as_ref()
                    .is_err_and(|printed| missing.iter().any(|m| printed.contains(m)));
                (!asked).then(|| format!("`{key}` is not required: {without:?}"))
            }
            (_, Some(literal)) => {
                let value: Table = format!("value = {literal}").parse().unwrap();
                let with = read(&self.table_with(key, value.get("value").unwrap().clone()));
                (with.is_err() || with != without)
                    .then(|| format!("the default of `{key}` is not {literal}: {with:?}"))
            }
            _ => without
                .err()
                .map(|printed| format!("`{key}` cannot be omitted: {printed}")),
        }
    }
}

fn check(page: &str, base: &Table, least: usize, read: Read) {
    let sections = sections(page, base);
    let keys: usize = sections.iter().map(|section| section.rows.len()).sum();
    assert!(keys > least, "{page}: only {keys} keys found");
    let faults = sections.iter().flat_map(|section| {
        let of = move |fault| format!("{page}, {}: {fault}", section.heading);
        section.faults(read).into_iter().map(of)
    });
    let faults: Vec<String> = faults.collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

fn configuration(table: &Table) -> Result<String, String> {
    let file = std::path::Path::new("wingd.toml");
    wingd::config::parse_configuration(file, &table.to_string())
        .map(|config| format!("{config:?}"))
        .map_err(|faults| faults.iter().map(ToString::to_string).collect())
}

#[test]
fn every_key_of_the_configuration_is_on_its_page() {
    let base = "camera.kind = \"replay\"\nstore.path = \"store\""
        .parse()
        .unwrap();
    check("docs/reference/wingd-toml.md", &base, 50, &configuration);
    check(
        "docs/reference/wingd-toml-camera.md",
        &base,
        30,
        &configuration,
    );
}

#[test]
fn every_key_of_an_installation_is_on_its_page() {
    let folder = tempfile::tempdir().unwrap();
    let fixture = Path::new(ROOT).join("fixtures/dev/installation");
    for name in ["camera.toml", "survey.csv"] {
        std::fs::copy(fixture.join(name), folder.path().join(name)).unwrap();
    }
    let ties = "id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m\na,0,0,0,0,0,0\nb,1,0,0,1,0,0\nc,0,1,0,0,1,0\nd,0,0,1,0,0,1\n";
    std::fs::write(folder.path().join("tie_points.csv"), ties).unwrap();
    let beam = "s_m,ei_n_m2,sigma_ei_n_m2\n0,2e9,1e8\n30,1e8,1e7\n";
    std::fs::write(folder.path().join("structure.csv"), beam).unwrap();
    let read = |table: &Table| {
        std::fs::write(folder.path().join("installation.toml"), table.to_string()).unwrap();
        let printed = |faults: Vec<Fault>| {
            faults
                .iter()
                .map(Fault::to_string)
                .collect::<Vec<_>>()
                .join("\n")
        };
        let found = wingd::installation::load(folder.path()).map_err(printed)?;
        Ok(format!(
            "{:?}",
            (
                found.setup,
                found.cad,
                found.cad_model,
                found.optics,
                found.structure
            )
        ))
    };
    let base = std::fs::read_to_string(fixture.join("installation.toml"))
        .unwrap()
        .parse()
        .unwrap();
    check("docs/reference/installation-toml.md", &base, 50, &read);
}

/// Type and meaning in the row of each width are those of the registry; `every_key_of_an_installation_is_on_its_page` compares the default.
#[test]
fn the_rows_of_widths_are_those_of_the_registry() {
    let page = std::fs::read_to_string(Path::new(ROOT).join("docs/reference/installation-toml.md"))
        .unwrap();
    for row in Width::ROWS {
        let section = page
            .split("\n## ")
            .find(|part| part.starts_with(&format!("`[{}]`", row.section)))
            .unwrap();
        let unit = if row.unit.name.is_empty() {
            String::new()
        } else {
            format!(" {},", row.unit.name)
        };
        let begin = format!("| `{}` | number,{unit} 0 to {} | ", row.key, row.max);
        let end = format!(" | {} |", row.meaning.trim());
        let found = section
            .lines()
            .any(|line| line.starts_with(&begin) && line.ends_with(&end));
        assert!(
            found,
            "the page needs the row {begin}`{}`{end}",
            row.default
        );
    }
}

/// Defaults in the page of priors are those of the registry.
#[test]
fn the_page_of_priors_has_the_defaults_of_the_registry() {
    let page =
        std::fs::read_to_string(Path::new(ROOT).join("docs/adjustment/installation.md")).unwrap();
    for row in Width::ROWS {
        let unit = if row.unit.name.is_empty() {
            String::new()
        } else {
            format!(" {}", row.unit.name)
        };
        let begin = format!("| `{}.{}` | {}{unit} | ", row.section, row.key, row.default);
        assert!(
            page.lines().any(|line| line.starts_with(&begin)),
            "the page needs a row that begins: {begin}"
        );
    }
}

#[test]
fn the_check_of_the_pages_detects_errors() {
    let base: Table = "camera.kind = \"replay\"\nstore.path = \"store\""
        .parse()
        .unwrap();
    let section = |rows: &[(&str, &str)]| Section {
        heading: String::new(),
        path: vec!["power".to_owned()],
        least: base.clone(),
        rows: rows
            .iter()
            .map(|(key, default)| ((*key).to_owned(), (*default).to_owned()))
            .collect(),
    };
    let sound = [
        ("stop_within", "`\"30s\"`"),
        ("hold_up", "`\"2s\"`"),
        ("file", "none"),
        ("line", "none"),
    ];
    assert_eq!(section(&sound).faults(&configuration), [""; 0]);
    assert_eq!(
        section(&sound[1..]).faults(&configuration),
        ["does not list `stop_within`"]
    );
    let other = [
        ("stop_within", "`\"31s\"`"),
        ("hold_up", "required"),
        ("file", "none"),
        ("line", "none"),
    ];
    assert_eq!(section(&other).faults(&configuration).len(), 2);
    let more = [&sound[..], &[("never", "none")]].concat();
    assert_eq!(
        section(&more).faults(&configuration),
        ["lists `never`, which is not known"]
    );
}
