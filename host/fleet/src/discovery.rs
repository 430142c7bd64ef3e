//! By what Home Assistant finds a hob's quantities over MQTT (docs/mqtt.md): one sensor a quantity, all of one device.
//!
//! Keys and classes are those of Home Assistant's documents "MQTT discovery" and "MQTT sensor". What a NATS client publishes is not
//! retained for MQTT, so an edge sends these at its start and whenever Home Assistant says that it has started.

use serde_json::{Value, json};

use crate::names;

/// Where Home Assistant says `online` when it has started, and `offline` before it ends.
pub const STATUS: &str = "homeassistant.status";

/// Seconds without a state after which Home Assistant shows a value as unavailable: states come once a second.
pub const EXPIRES_AFTER_S: u32 = 10;

/// A sensor. Where a field is `null`, its template makes `None` of it, which Home Assistant shows as unknown.
struct Quantity {
    /// Its field in the state's message, and the end of its id.
    field: &'static str,
    /// As people read it.
    name: &'static str,
    /// What of the message is shown; the field itself without.
    template: Option<&'static str>,
    /// Home Assistant's class where it has one.
    device_class: Option<&'static str>,
    /// Of what is shown; a text without.
    unit: Option<&'static str>,
    /// Decimals that are shown.
    decimals: Option<u8>,
    /// Whether it is for who looks for a fault.
    is_diagnostic: bool,
}

/// A number with its unit.
const fn number(
    field: &'static str,
    name: &'static str,
    unit: &'static str,
    decimals: u8,
) -> Quantity {
    Quantity {
        field,
        name,
        template: None,
        device_class: None,
        unit: Some(unit),
        decimals: Some(decimals),
        is_diagnostic: false,
    }
}

/// A word.
const fn word(field: &'static str, name: &'static str) -> Quantity {
    Quantity {
        field,
        name,
        template: None,
        device_class: None,
        unit: None,
        decimals: None,
        is_diagnostic: false,
    }
}

const QUANTITIES: [Quantity; 9] = [
    word("state", "State"),
    word("pot", "Pot"),
    Quantity {
        device_class: Some("power"),
        ..number("power_w", "Power", "W", 0)
    },
    Quantity {
        device_class: Some("power"),
        ..number("asked_w", "Power asked for", "W", 0)
    },
    Quantity {
        device_class: Some("frequency"),
        ..number("f_sw_hz", "Switching frequency", "Hz", 0)
    },
    number("r_ohm", "Load resistance", "Ω", 3),
    Quantity {
        // Nobody reads 0.0000783 H.
        template: Some("{{ value_json.l_h * 1000000 if value_json.l_h is number else none }}"),
        ..number("l_h", "Load inductance", "µH", 2)
    },
    // No class `temperature`: Home Assistant would make degrees Celsius of a difference in kelvin.
    number("pot_rise_k", "Pot's rise in temperature", "K", 0),
    Quantity {
        is_diagnostic: true,
        ..word("lookup_version", "Version of the lookup")
    },
];

/// Subjects and messages (JSON) by which Home Assistant finds a hob, named as in its subjects.
pub fn of_hob(hob: &str) -> Vec<(String, Vec<u8>)> {
    let message = |quantity: &Quantity| {
        let subject = format!("homeassistant.sensor.ihd_{hob}.{}.config", quantity.field);
        (subject, config(hob, quantity).to_string().into_bytes())
    };
    QUANTITIES.iter().map(message).collect()
}

/// Fields of the state's message that are shown.
pub fn fields() -> impl Iterator<Item = &'static str> {
    QUANTITIES.iter().map(|quantity| quantity.field)
}

/// The topic of MQTT that a subject is: their levels are apart by slashes.
pub fn topic(subject: &str) -> String {
    subject.replace('.', "/")
}

fn config(hob: &str, quantity: &Quantity) -> Value {
    let field = quantity.field;
    let plain = format!("{{{{ value_json.{field} }}}}");
    let mut config = json!({
        "name": quantity.name,
        "unique_id": format!("ihd_{hob}_{field}"),
        "state_topic": topic(&names::state(hob)),
        "value_template": quantity.template.unwrap_or(&plain),
        "expire_after": EXPIRES_AFTER_S,
        "device": {
            "identifiers": [format!("ihd_{hob}")],
            "name": format!("Induction hob {hob}"),
            "manufacturer": "ihd",
        },
        "origin": { "name": "ihd", "sw_version": env!("CARGO_PKG_VERSION") },
    });
    if let Some(class) = quantity.device_class {
        config["device_class"] = class.into();
    }
    if let Some(unit) = quantity.unit {
        config["unit_of_measurement"] = unit.into();
        config["state_class"] = "measurement".into();
    }
    if let Some(decimals) = quantity.decimals {
        config["suggested_display_precision"] = decimals.into();
    }
    if quantity.is_diagnostic {
        config["entity_category"] = "diagnostic".into();
    }
    config
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// What the document "MQTT sensor" knows, as far as it may stand in a message of discovery.
    const KEYS: [&str; 27] = [
        "availability",
        "availability_mode",
        "availability_template",
        "availability_topic",
        "default_entity_id",
        "device",
        "device_class",
        "enabled_by_default",
        "encoding",
        "entity_category",
        "entity_picture",
        "expire_after",
        "force_update",
        "icon",
        "json_attributes_template",
        "json_attributes_topic",
        "last_reset_value_template",
        "name",
        "options",
        "origin",
        "qos",
        "state_class",
        "state_topic",
        "suggested_display_precision",
        "unique_id",
        "unit_of_measurement",
        "value_template",
    ];

    /// Units that Home Assistant knows for a class; of another one it says that it is wrong.
    const UNITS: [(&str, &[&str]); 2] = [
        ("power", &["mW", "W", "kW", "MW", "GW", "TW"]),
        ("frequency", &["Hz", "kHz", "MHz", "GHz"]),
    ];

    fn configs(hob: &str) -> Vec<(String, Value)> {
        let parse =
            |(subject, json): (String, Vec<u8>)| (subject, serde_json::from_slice(&json).unwrap());
        of_hob(hob).into_iter().map(parse).collect()
    }

    #[test]
    fn each_message_is_as_home_assistants_documents_say() {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        for (subject, config) in configs("hob-a") {
            let keys = config.as_object().unwrap();
            assert!(
                keys.keys().all(|key| KEYS.contains(&key.as_str())),
                "{config}"
            );
            // Needed: where the value is, who it is, whose it is, and who says so.
            assert_eq!(config["state_topic"], "ihd/v1/hob-a/state");
            assert!(text(&config["unique_id"]).is_some() && text(&config["name"]).is_some());
            assert_eq!(config["device"]["identifiers"], json!(["ihd_hob-a"]));
            assert!(text(&config["origin"]["name"]).is_some());
            assert!(config["expire_after"].as_u64().unwrap() > 1);
            if let Some(class) = config.get("device_class") {
                let units = UNITS.iter().find(|(name, _)| *name == class).unwrap().1;
                let unit = text(&config["unit_of_measurement"]).unwrap();
                assert!(units.contains(&unit.as_str()), "{subject}");
            }
            if let Some(category) = config.get("entity_category") {
                assert!(["config", "diagnostic"].contains(&category.as_str().unwrap()));
            }
            // Only what has a unit is a measurement with a history of means.
            let has_unit = config.get("unit_of_measurement").is_some();
            assert_eq!(config.get("state_class").is_some(), has_unit, "{subject}");
        }
    }

    #[test]
    fn topics_have_the_documented_form_and_ids_are_unique() {
        let (mut topics, mut ids) = (BTreeSet::new(), BTreeSet::new());
        for hob in ["hob-a", "hob_b"] {
            for (subject, config) in configs(hob) {
                // <discovery_prefix>/<component>/<node_id>/<object_id>/config
                let topic = topic(&subject);
                let levels: Vec<&str> = topic.split('/').collect();
                let [prefix, component, node, object, end] = levels[..] else {
                    panic!("{topic}")
                };
                assert_eq!(
                    (prefix, component, end),
                    ("homeassistant", "sensor", "config")
                );
                let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                assert!(node.chars().chain(object.chars()).all(plain), "{topic}");
                assert!(topics.insert(topic));
                assert!(ids.insert(config["unique_id"].to_string()));
            }
        }
        assert_eq!(topics.len(), 2 * QUANTITIES.len());
    }

    #[test]
    fn each_value_is_taken_from_its_own_field() {
        for (quantity, (_, config)) in QUANTITIES.iter().zip(configs("h")) {
            let template = config["value_template"].as_str().unwrap().to_owned();
            let wanted = format!("value_json.{} ", quantity.field);
            assert!(template.contains(&wanted), "{template}");
            assert!(template.starts_with("{{ ") && template.ends_with(" }}"));
        }
    }
}
