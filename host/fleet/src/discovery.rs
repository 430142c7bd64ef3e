//! MQTT discovery for Home Assistant (docs/fleet.md): one sensor for each quantity of a hob, all of one device.
//!
//! Keys and classes are those of Home Assistant's documents "MQTT discovery" and "MQTT sensor". MQTT does not retain what a NATS
//! client publishes, so an edge sends these messages at its start and at each start of Home Assistant.

use serde_json::{Value, json};

use crate::names;

/// Subject on which Home Assistant publishes `online` at its start and `offline` at its end.
pub const STATUS: &str = "homeassistant.status";

/// Time in seconds without a state after which Home Assistant shows a value as unavailable; states come once a second.
pub const EXPIRES_AFTER_S: u32 = 10;

/// A sensor. The template makes `None` of a field that is `null`, which Home Assistant shows as unknown.
struct Quantity {
    /// Its field in the state's message, and the end of its id.
    field: &'static str,
    /// Displayed name.
    name: &'static str,
    /// Template of the displayed value; `None` for the field itself.
    template: Option<&'static str>,
    /// Home Assistant's class of the quantity, if any.
    device_class: Option<&'static str>,
    /// Unit of the displayed value; `None` for text.
    unit: Option<&'static str>,
    /// Displayed decimals.
    decimals: Option<u8>,
    /// Shown among the diagnostic entities.
    is_diagnostic: bool,
}

/// Returns a number with its unit.
const fn number_quantity(
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

/// Returns a text quantity.
const fn text_quantity(field: &'static str, name: &'static str) -> Quantity {
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
    text_quantity("state", "State"),
    text_quantity("pot", "Pot"),
    Quantity {
        device_class: Some("power"),
        ..number_quantity("power_w", "Power", "W", 0)
    },
    Quantity {
        device_class: Some("power"),
        ..number_quantity("asked_w", "Power asked for", "W", 0)
    },
    Quantity {
        device_class: Some("frequency"),
        ..number_quantity("f_sw_hz", "Switching frequency", "Hz", 0)
    },
    number_quantity("r_ohm", "Load resistance", "Ω", 3),
    Quantity {
        // 78.3 µH instead of 0.0000783 H.
        template: Some("{{ value_json.l_h * 1000000 if value_json.l_h is number else none }}"),
        ..number_quantity("l_h", "Load inductance", "µH", 2)
    },
    // No class `temperature`: Home Assistant would convert a difference in kelvin to degrees Celsius.
    number_quantity("pot_rise_k", "Pot's rise in temperature", "K", 0),
    Quantity {
        is_diagnostic: true,
        ..text_quantity("lookup_version", "Version of the lookup")
    },
];

/// Returns subjects and discovery messages (JSON) of a hob.
pub fn sensor_messages(hob: &str) -> Vec<(String, Vec<u8>)> {
    let message = |quantity: &Quantity| {
        let subject = format!("homeassistant.sensor.ihd_{hob}.{}.config", quantity.field);
        (subject, config(hob, quantity).to_string().into_bytes())
    };
    QUANTITIES.iter().map(message).collect()
}

/// Returns the displayed fields of the state message.
pub fn fields() -> impl Iterator<Item = &'static str> {
    QUANTITIES.iter().map(|quantity| quantity.field)
}

/// Returns the MQTT topic of a subject: levels are separated by slashes.
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

    /// Keys of the document "MQTT sensor" that a discovery message may have.
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

    /// Units that Home Assistant accepts for a class.
    const UNITS: [(&str, &[&str]); 2] = [
        ("power", &["mW", "W", "kW", "MW", "GW", "TW"]),
        ("frequency", &["Hz", "kHz", "MHz", "GHz"]),
    ];

    fn configs(hob: &str) -> Vec<(String, Value)> {
        let parse =
            |(subject, json): (String, Vec<u8>)| (subject, serde_json::from_slice(&json).unwrap());
        sensor_messages(hob).into_iter().map(parse).collect()
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
            // Required: state topic, id, device and origin.
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
            // Only a quantity with a unit is a measurement with a history of means.
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
            let expected = format!("value_json.{} ", quantity.field);
            assert!(template.contains(&expected), "{template}");
            assert!(template.starts_with("{{ ") && template.ends_with(" }}"));
        }
    }
}
