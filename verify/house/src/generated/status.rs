//! The keys of a joint and of an IMU in the schema of `motorctl status`, from the tables of their
//! states. Other keys are written by hand, and stay where they are.

use super::json::Json;
use motord_shared::{Field, ImuState, JointState, Kind};
use serde_json::{Value, json};

const SCHEMA: &str = include_str!("../../../../docs/schema/motorctl-status.json");

/// Returns the schema with the keys of both tables.
pub(super) fn of_tables() -> String {
    let mut schema = Json::read(SCHEMA);
    for (list, fields) in [("joints", JointState::FIELDS), ("imus", ImuState::FIELDS)] {
        let item = schema.member("properties").member(list).member("items");
        for (key, field) in fields.iter().filter_map(|field| Some((field.json?, field))) {
            *item.member("properties").member(key) = form(field, list);
            item.member("required").add(key);
        }
    }
    schema.text()
}

/// The schema of a field, in the order of its members.
fn form(field: &Field, list: &str) -> Json {
    let about = ("description", Value::from(description(field, list)));
    let typed = |name: &str| ("type", json!(name));
    let members = match field.kind {
        Kind::Measured | Kind::Optional => vec![("type", json!(["number", "null"])), about],
        Kind::Vector(length) => vec![
            ("type", json!(["array", "null"])),
            ("items", json!({ "type": "number" })),
            ("minItems", length.into()),
            ("maxItems", length.into()),
            about,
        ],
        Kind::Latency => vec![typed("number"), about],
        Kind::Count | Kind::Total => vec![typed("integer"), about, ("minimum", 0.into())],
        Kind::Code(names) => vec![about, ("enum", json!([names, &["unknown"]].concat()))],
        Kind::Set(_) => vec![typed("array"), about, ("items", json!({ "type": "string" }))],
        Kind::Flag(_) => vec![typed("boolean"), about],
        Kind::FlagSet(_, names) => vec![typed("array"), ("items", json!({ "enum": names })), about],
        Kind::Time | Kind::Flags | Kind::Command | Kind::Reserved => panic!("{} has no form", field.name),
    };
    Json::Object(
        members.into_iter().map(|(key, value)| (key.to_owned(), Json::read(&value.to_string()))).collect(),
    )
}

/// The sentences of a field, with its unit and the meaning of `null`.
fn description(field: &Field, list: &str) -> String {
    let unit = if field.kind == Kind::Latency { "µs" } else { field.unit };
    let unit = if unit.is_empty() { String::new() } else { format!(" Unit: {unit}.") };
    let note = match field.kind {
        Kind::Measured => " null before the motor has reported it.",
        Kind::Optional if list == "joints" => " null where the motor does not report it.",
        Kind::Optional => " null where it is not reported.",
        Kind::Vector(_) => " null before the first sample.",
        Kind::Code(_) => " `unknown` for one of a newer daemon.",
        Kind::Set(_) => " Bits without a name are one hexadecimal number.",
        _ => "",
    };
    format!("{}{unit}{note}", field.doc)
}
