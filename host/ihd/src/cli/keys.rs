//! Options as KEY=VALUE in one flag: `--sim pot=aluminium,lift=5mm`.
//!
//! The keys, their values and their help are those of a struct that clap describes; `help` in place of pairs lists them.

use std::ffi::OsStr;

use anyhow::Result;
use clap::builder::TypedValueParser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, ArgAction, Args, Command};

use super::usage::Usage;

/// Parser of the flag's text: `help` shows the keys, everything else is kept for [`parse`].
#[derive(Clone)]
pub struct KeysText(fn() -> Command);

/// Parser for the keys of `T`.
pub fn text<T: Args>() -> KeysText {
    KeysText(command::<T>)
}

fn command<T: Args>() -> Command {
    T::augment_args(
        Command::new("keys")
            .disable_help_flag(true)
            .no_binary_name(true),
    )
}

impl TypedValueParser for KeysText {
    type Value = String;

    fn parse_ref(
        &self,
        _: &Command,
        _: Option<&Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        match value.to_str() {
            Some("help") => Err(clap::Error::raw(ErrorKind::DisplayHelp, help(&(self.0)()))),
            Some(text) => Ok(text.to_owned()),
            None => Err(clap::Error::raw(ErrorKind::InvalidUtf8, "not UTF-8\n")),
        }
    }
}

/// Keys with their values and meaning, a paragraph each.
fn help(command: &Command) -> String {
    let mut text = "Keys, as KEY=VALUE with commas between them:\n\n".to_owned();
    for argument in command.get_arguments() {
        let default: Vec<_> = argument
            .get_default_values()
            .iter()
            .map(|d| d.to_string_lossy())
            .collect();
        let default = match default.as_slice() {
            [] => String::new(),
            _ if is_switch(argument) => String::new(),
            values => format!(" [default: {}]", values.join(",")),
        };
        let help = argument
            .get_help()
            .map(ToString::to_string)
            .unwrap_or_default();
        text += &format!("  {}\n      {help}{default}\n", spelled(argument));
    }
    text
}

/// Spelling of a key with its value: `lift=M`, or `warming`.
fn spelled(argument: &Arg) -> String {
    let key = argument.get_id().as_str();
    let key = argument.get_long().unwrap_or(key);
    match argument.get_value_names() {
        Some([name, ..]) if !is_switch(argument) => format!("{key}={name}"),
        _ => key.to_owned(),
    }
}

fn is_switch(argument: &Arg) -> bool {
    matches!(argument.get_action(), ArgAction::SetTrue)
}

/// Names of all keys of `T`.
pub fn names<T: Args>() -> Vec<String> {
    let command = command::<T>();
    let longs = command.get_arguments().filter_map(Arg::get_long);
    longs.map(str::to_owned).collect()
}

/// Parses the texts of a flag.
///
/// # Errors
/// [`Usage`] with the flag, the key, its value, and what is accepted.
pub fn parse<T: Args>(flag: &str, texts: &[String]) -> Result<T> {
    let command = command::<T>();
    let pairs: Vec<String> = texts
        .iter()
        .flat_map(|text| split(text, &command))
        .collect();
    let mut words = Vec::new();
    for pair in &pairs {
        let (key, value) = match pair.split_once('=') {
            Some((key, value)) => (key.trim(), Some(value)),
            None => (pair.trim(), None),
        };
        let known = command.get_arguments().find(|a| a.get_long() == Some(key));
        let Some(argument) = known else {
            let keys: Vec<String> = command.get_arguments().map(spelled).collect();
            return Err(wrong(
                flag,
                pair,
                &format!("no such key; there are {}", keys.join(", ")),
            ));
        };
        match (is_switch(argument), value) {
            (true, None | Some("true")) => words.push(format!("--{key}")),
            (true, Some("false")) => {}
            (true, Some(_)) => return Err(wrong(flag, pair, "true or false")),
            (false, Some(value)) => words.push(format!("--{key}={value}")),
            (false, None) => {
                return Err(wrong(
                    flag,
                    pair,
                    &format!("a value is missing: {}", spelled(argument)),
                ));
            }
        }
    }
    let matches = command.try_get_matches_from(words);
    matches
        .and_then(|matches| T::from_arg_matches(&matches))
        .map_err(|error| refused(flag, &error))
}

fn wrong(flag: &str, pair: &str, why: &str) -> anyhow::Error {
    Usage(format!("{flag} {pair}: {why}")).into()
}

/// Splits pairs at commas; what does not begin a pair continues the value before it.
fn split(text: &str, command: &Command) -> Vec<String> {
    let begins = |piece: &str| match piece.split_once('=') {
        Some((key, _)) => {
            let mut letters = key.trim().chars();
            letters.clone().next().is_some() && letters.all(|c| c.is_ascii_lowercase() || c == '-')
        }
        None => command
            .get_arguments()
            .any(|a| is_switch(a) && a.get_long() == Some(piece.trim())),
    };
    let mut pairs: Vec<String> = Vec::new();
    for piece in text.split(',') {
        match pairs.last_mut() {
            Some(last) if !begins(piece) => {
                last.push(',');
                last.push_str(piece);
            }
            _ => pairs.push(piece.trim().to_owned()),
        }
    }
    pairs
}

/// Converts clap's error about `--key=value` into one about the flag.
fn refused(flag: &str, error: &clap::Error) -> anyhow::Error {
    let context = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        Some(ContextValue::Strings(texts)) => Some(texts.join(", ")),
        _ => None,
    };
    let key = context(ContextKind::InvalidArg).unwrap_or_default();
    let key = key.split_whitespace().next().unwrap_or_default();
    let key = key
        .trim_start_matches("--")
        .split('=')
        .next()
        .unwrap_or_default()
        .to_owned();
    let value = context(ContextKind::InvalidValue).unwrap_or_default();
    match error.kind() {
        ErrorKind::ValueValidation | ErrorKind::InvalidValue => {
            let why = match std::error::Error::source(error) {
                Some(source) => source.to_string(),
                None => format!(
                    "one of {}",
                    context(ContextKind::ValidValue)
                        .unwrap_or_else(|| "the values that --help names".into())
                ),
            };
            wrong(flag, &format!("{key}={value}"), &why)
        }
        ErrorKind::ArgumentConflict => match context(ContextKind::PriorArg) {
            Some(prior) if !prior.trim_start_matches("--").starts_with(&key) => wrong(
                flag,
                &key,
                &format!("not together with {}", prior.trim_start_matches("--")),
            ),
            _ => wrong(flag, &key, "given more than once"),
        },
        _ => {
            let text = error.to_string();
            let line = text.lines().next().unwrap_or_default();
            Usage(format!("{flag}: {}", line.trim_start_matches("error: "))).into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Args)]
    struct Keys {
        /// Two numbers.
        #[arg(long, value_name = "V,I", value_parser = crate::cli::simulate::quantity::list::<2>)]
        probe: Option<[f64; 2]>,
        /// A name.
        #[arg(long, value_parser = ["left", "right"])]
        side: Option<String>,
        /// A switch.
        #[arg(long)]
        swap: bool,
    }

    fn parsed(text: &str) -> Result<Keys, String> {
        parse("--input", &[text.to_owned()]).map_err(|e: anyhow::Error| e.to_string())
    }

    #[test]
    fn commas_of_a_value_stay_with_it() {
        let keys = parsed("probe=100,10,swap,side=left").unwrap();
        assert_eq!(keys.probe, Some([100.0, 10.0]));
        assert_eq!((keys.side.as_deref(), keys.swap), (Some("left"), true));
        assert!(!parsed("swap=false").unwrap().swap);
    }

    #[test]
    fn errors_name_key_value_and_what_is_accepted() {
        for (text, words) in [
            ("prob=1,2", ["--input prob=1,2", "probe=V,I"]),
            ("probe=1", ["--input probe=1", "2 numbers"]),
            ("side=up", ["--input side=up", "left, right"]),
            ("side", ["--input side", "a value is missing"]),
            ("swap=maybe", ["--input swap=maybe", "true or false"]),
            ("side=left,side=right", ["--input side", "more than once"]),
        ] {
            let error = parsed(text).unwrap_err();
            for word in words {
                assert!(error.contains(word), "{text}: {word} not in {error}");
            }
        }
    }

    #[test]
    fn help_lists_every_key() {
        let text = help(&command::<Keys>());
        for word in ["probe=V,I", "Two numbers", "swap"] {
            assert!(text.contains(word), "{text}");
        }
    }
}
