//! Name of a load model in tables and names of files.

use ihd_sim::recording::settings::LoadKind;

/// Name of a load model, as on the command line.
pub(crate) fn load_name(load: LoadKind) -> &'static str {
    match load {
        LoadKind::Field => "field",
        LoadKind::Surrogate => "reduced",
        LoadKind::Behavioural => "behavioural",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_settings() {
        for load in [LoadKind::Field, LoadKind::Surrogate, LoadKind::Behavioural] {
            let name = serde_json::to_value(load).unwrap();
            assert_eq!(name, load_name(load));
        }
    }
}
