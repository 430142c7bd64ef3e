//! Options of the store: which samples are stored, and for how long.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Options of the store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StoreOptions {
    /// Limits of age and size.
    pub retention: Retention,
    /// Policy for the samples of windows.
    pub keep: SamplePolicy,
}

/// Limits of age and size of stored windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Retention {
    /// Days in use after which a day's windows are deleted; `None` for never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_age_days: Option<u32>,
    /// Most bytes of all windows on disk: beyond it older ones are thinned, the newest stay.
    pub max_bytes: u64,
}

impl Default for Retention {
    fn default() -> Self {
        Self {
            max_age_days: None,
            max_bytes: 2_000_000_000,
        }
    }
}

/// Policy for the samples of windows. Every window has a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SamplePolicy {
    /// All: `"all"`.
    #[default]
    All,
    /// One in N that arrive in a session: `"one-in-10"`.
    OneIn(u32),
    /// Those that the gate refused or that changed the lookup, and those without a result yet:
    /// `"telling"`.
    Informative,
}

impl fmt::Display for SamplePolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::OneIn(n) => write!(f, "one-in-{n}"),
            Self::Informative => f.write_str("telling"),
        }
    }
}

/// Text that names no policy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} says not which windows to keep: all, telling, or one-in-N with an N above 0")]
pub struct UnknownSamplePolicy(pub String);

impl FromStr for SamplePolicy {
    type Err = UnknownSamplePolicy;

    fn from_str(text: &str) -> Result<Self, UnknownSamplePolicy> {
        match text {
            "all" => Ok(Self::All),
            "telling" => Ok(Self::Informative),
            _ => text
                .strip_prefix("one-in-")
                .and_then(|n| n.parse().ok())
                .filter(|n| *n > 0)
                .map(Self::OneIn)
                .ok_or_else(|| UnknownSamplePolicy(text.to_owned())),
        }
    }
}

impl Serialize for SamplePolicy {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SamplePolicy {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_is_a_word() {
        for keep in [
            SamplePolicy::All,
            SamplePolicy::OneIn(7),
            SamplePolicy::Informative,
        ] {
            assert_eq!(keep.to_string().parse(), Ok(keep));
            let json = serde_json::to_string(&keep).unwrap();
            assert_eq!(serde_json::from_str::<SamplePolicy>(&json).unwrap(), keep);
        }
        for wrong in [
            "",
            "one-in-0",
            "one-in-",
            "one-in--1",
            "ALL",
            "one-in-4294967296",
        ] {
            assert_eq!(
                wrong.parse::<SamplePolicy>(),
                Err(UnknownSamplePolicy(wrong.to_owned()))
            );
        }
    }

    #[test]
    fn what_is_not_said_is_as_documented_and_a_wrong_key_is_an_error() {
        let options: StoreOptions = serde_json::from_str("{}").unwrap();
        assert_eq!(options.retention.max_bytes, 2_000_000_000);
        assert_eq!(
            (options.retention.max_age_days, options.keep),
            (None, SamplePolicy::All)
        );
        assert!(serde_json::from_str::<StoreOptions>(r#"{"kept":"all"}"#).is_err());
    }
}
