//! Variants of a scenario: every combination of the values of its matrix.
//!
//! A `[[matrix]]` names places of the file by path and gives values for each. Several `[[matrix]]` follow one
//! after the other; a file without any has itself as its only variant.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use super::ScenarioError;
use super::file::{Scenario, directory, text};

/// Variant of a file.
#[derive(Clone, Debug)]
pub struct Variant {
    /// Inserted values as text; empty for a file without matrix.
    pub name: String,
    /// The file with these values.
    pub scenario: Scenario,
}

/// Reads every variant of a file.
///
/// # Errors
/// [`ScenarioError::Read`], [`ScenarioError::Syntax`] and [`ScenarioError::Matrix`].
pub fn read(path: &Path) -> Result<Vec<Variant>, ScenarioError> {
    parse(&text(path)?, directory(path))
}

fn parse(text: &str, directory: PathBuf) -> Result<Vec<Variant>, ScenarioError> {
    // Parsed as written, for errors that name its lines.
    let matrix = Scenario::parse(text, directory.clone())?.file.matrix;
    let syntax = |e| ScenarioError::Syntax(Box::new(e));
    let mut file: Table = toml::from_str(text).map_err(syntax)?;
    file.remove("matrix");
    let unchanged = (String::new(), file);
    let mut all = Vec::new();
    for entry in &matrix {
        let mut combined = vec![unchanged.clone()];
        for (path, values) in entry {
            combined = combine(&combined, path, values)?;
        }
        all.extend(combined);
    }
    if matrix.is_empty() {
        all.push(unchanged);
    }
    let variant = |(name, file): (String, Table)| {
        let scenario = Scenario::parse(&file.to_string(), directory.clone())?;
        Ok(Variant { name, scenario })
    };
    all.into_iter().map(variant).collect()
}

/// Combines every file with every value at a path.
fn combine(
    files: &[(String, Table)],
    path: &str,
    values: &[Value],
) -> Result<Vec<(String, Table)>, ScenarioError> {
    let mut all = Vec::new();
    for (name, file) in files {
        for value in values {
            let mut file = file.clone();
            put(&mut file, path, value).map_err(|why| ScenarioError::Matrix {
                path: path.to_owned(),
                why,
            })?;
            // Limits are shown with their own format.
            let name = match path.starts_with("limits.") {
                true => name.clone(),
                false => format!("{name} {}", in_words(value)),
            };
            all.push((name.trim().to_owned(), file));
        }
    }
    Ok(all)
}

fn in_words(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Table(table) => {
            let values: Vec<_> = table.values().map(in_words).collect();
            values.join("/")
        }
        other => other.to_string(),
    }
}

/// Inserts a value at a path of names and, in lists, numbers from 0.
fn put(file: &mut Table, path: &str, value: &Value) -> Result<(), String> {
    let (places, last) = path.rsplit_once('.').unwrap_or(("", path));
    let mut place = file;
    let mut names = places.split_terminator('.');
    while let Some(name) = names.next() {
        let next = place
            .entry(name)
            .or_insert_with(|| Value::Table(Table::new()));
        place = match next {
            Value::Table(table) => table,
            Value::Array(list) => {
                let index = names.next().unwrap_or_default();
                let item = index.parse().ok().and_then(|n: usize| list.get_mut(n));
                let item = item.and_then(Value::as_table_mut);
                item.ok_or_else(|| format!("{name} has no item {index:?}"))?
            }
            _ => return Err(format!("{name} is neither a table nor a list")),
        };
    }
    place.insert(last.to_owned(), value.clone());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"
        duration_s = 1.0
        [[event]]
        at_s = 0.0
        power_w = 500
        [[matrix]]
        "mains.hz" = [50, 60]
        "event.0.power_w" = [500, 1000, 1500]
        [[matrix]]
        "pot.name" = ["none"]
        "limits.fault" = ["OverCurrent"]
    "#;

    #[test]
    fn every_combination_of_each_matrix_is_a_variant() {
        let all = parse(FILE, PathBuf::new()).unwrap();
        let names: Vec<&str> = all.iter().map(|v| v.name.as_str()).collect();
        let combined = [
            "500 50", "500 60", "1000 50", "1000 60", "1500 50", "1500 60",
        ];
        assert_eq!(names, [&combined[..], &["none"]].concat());
        let sixty = &all[5].scenario.file;
        assert_eq!(sixty.mains.hz, Some(60.0));
        assert_eq!(sixty.event[0].get_ref().power_w, Some(1500.0));
        assert!(sixty.matrix.is_empty());
        let none = &all[6].scenario.file;
        assert_eq!(none.event[0].get_ref().power_w, Some(500.0));
        assert!(none.pot.pot.base.is_none());
    }

    #[test]
    fn a_file_without_matrix_is_its_own_variant() {
        let all = parse("duration_s = 1.0", PathBuf::new()).unwrap();
        assert_eq!(all.len(), 1);
        assert_eq!(all[0].name, "");
    }

    #[test]
    fn a_path_that_leads_nowhere_is_refused() {
        for (path, why) in [
            ("event.1.power_w", "event has no item \"1\""),
            ("event.power_w.x", "event has no item \"power_w\""),
            ("duration_s.x.y", "duration_s is neither a table nor a list"),
        ] {
            let matrix = format!("[[matrix]]\n{path:?} = [1]\n");
            let wrong = parse(&format!("{FILE}{matrix}"), PathBuf::new()).unwrap_err();
            assert_eq!(wrong.to_string(), format!("matrix {path}: {why}"));
        }
        let field = format!("{FILE}[[matrix]]\n\"mains.volts\" = [230]\n");
        let wrong = parse(&field, PathBuf::new()).unwrap_err().to_string();
        assert!(wrong.contains("volts"), "{wrong}");
    }
}
