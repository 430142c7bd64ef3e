//! The variants of a scenario: every combination of its matrix.
//!
//! A `[[matrix]]` names places of the file by path and gives values for each: the file runs once for every
//! combination of them. Several `[[matrix]]` are run one after the other; without any the file runs as it is.

use anyhow::{Context, bail};
use toml::{Table, Value};

/// One run: what is special about it, and the file with that put in.
#[derive(Clone, Debug)]
pub struct Variant {
    /// The values put in, in words; empty for a file without matrix.
    pub name: String,
    /// The file, without matrix.
    pub file: Table,
}

/// Every variant of a file.
pub fn of(mut file: Table) -> anyhow::Result<Vec<Variant>> {
    let Some(matrix) = file.remove("matrix") else {
        let name = String::new();
        return Ok(vec![Variant { name, file }]);
    };
    let mut all = Vec::new();
    for entry in matrix
        .as_array()
        .context("[[matrix]] is a list of tables")?
    {
        let entry = entry.as_table().context("[[matrix]] is a list of tables")?;
        let mut variants = vec![Variant {
            name: String::new(),
            file: file.clone(),
        }];
        for (path, values) in entry {
            let values = values
                .as_array()
                .with_context(|| format!("matrix {path}: give a list of values"))?;
            variants = combine(&variants, path, values)?;
        }
        all.extend(variants);
    }
    Ok(all)
}

fn combine(variants: &[Variant], path: &str, values: &[Value]) -> anyhow::Result<Vec<Variant>> {
    let mut all = Vec::new();
    for variant in variants {
        for value in values {
            let mut file = variant.file.clone();
            put(&mut file, path, value).with_context(|| format!("matrix {path}"))?;
            // Limits are shown as limits.
            let name = match path.starts_with("limits.") {
                true => variant.name.clone(),
                false => format!("{} {}", variant.name, shown(value)),
            };
            let name = name.trim().to_owned();
            all.push(Variant { name, file });
        }
    }
    Ok(all)
}

fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Table(table) => {
            let values: Vec<_> = table.values().map(shown).collect();
            values.join("/")
        }
        other => other.to_string(),
    }
}

/// Puts a value at a path of names and, in lists, numbers from 0.
fn put(file: &mut Table, path: &str, value: &Value) -> anyhow::Result<()> {
    let mut names: Vec<&str> = path.split('.').collect();
    let last = names.pop().context("no name")?;
    let mut place = file;
    let mut rest = names.into_iter();
    while let Some(name) = rest.next() {
        let next = place
            .entry(name)
            .or_insert_with(|| Value::Table(Table::new()));
        place = match next {
            Value::Table(table) => table,
            Value::Array(list) => {
                let index: usize = rest.next().unwrap_or_default().parse()?;
                let item = list.get_mut(index).and_then(Value::as_table_mut);
                item.with_context(|| format!("{name} has no item {index}"))?
            }
            _ => bail!("{name} is neither a table nor a list"),
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
        power_w = 500
        [[matrix]]
        "mains.hz" = [50, 60]
        "event.0.power_w" = [500, 1000, 1500]
        [[matrix]]
        "pot.name" = ["none"]
        "limits.fault" = ["NoPot"]
    "#;

    #[test]
    fn every_combination_of_each_matrix_is_a_variant() {
        let all = of(toml::from_str(FILE).unwrap()).unwrap();
        assert_eq!(all.len(), 7);
        let names: Vec<&str> = all.iter().map(|v| v.name.as_str()).collect();
        assert!(
            names.contains(&"1500 60") && names.contains(&"none"),
            "{names:?}"
        );
        let sixty = all.iter().find(|v| v.name == "1500 60").unwrap();
        assert_eq!(sixty.file["mains"]["hz"].as_integer(), Some(60));
        assert_eq!(sixty.file["event"][0]["power_w"].as_integer(), Some(1500));
        assert!(!sixty.file.contains_key("matrix"));
        assert_eq!(all[6].file["limits"]["fault"].as_str(), Some("NoPot"));
    }

    #[test]
    fn a_path_that_leads_nowhere_is_refused() {
        let file = "duration_s = 1.0\n[[matrix]]\n\"event.0.power_w\" = [1]\n[event]\n";
        let sound = of(toml::from_str(file).unwrap());
        assert!(sound.is_ok(), "a table takes any name");
        let file = "event = []\n[[matrix]]\n\"event.0.power_w\" = [1]\n";
        assert!(of(toml::from_str(file).unwrap()).is_err());
    }
}
