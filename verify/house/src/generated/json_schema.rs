//! The schemas of `docs/schema` that describe a structure: properties, types and descriptions are
//! those of its fields. Title and constraints, such as the words of an `enum`, are written by hand.

use super::json::Json;
use crate::sources::root;
use motord_shared::{Field, ImuState, JointState, Kind};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use syn::{Attribute, Fields, GenericArgument, ItemStruct, PathArguments, Type};

/// A schema, the type that the command prints, and the files with this type and those of its fields.
pub(super) struct Schema {
    pub(super) name: &'static str,
    printed: &'static str,
    files: &'static [&'static str],
}

const fn schema(name: &'static str, printed: &'static str, files: &'static [&'static str]) -> Schema {
    Schema { name, printed, files }
}

pub(super) const SCHEMAS: &[Schema] = &[
    schema("motorctl-fault", "FaultReport", &["motorctl/src/fault.rs", "motorctl/direct/src/status.rs"]),
    schema("motorctl-health", "Health", &["motorctl/src/health.rs"]),
    schema("motorctl-hold", "Line", &["motorctl/src/hold/report.rs"]),
    schema("motorctl-imu-level", "Level", &["motorctl/src/imu/level.rs"]),
    schema("motorctl-instances", "Vec<Entry>", &["motorctl/src/instances.rs"]),
    schema("motorctl-record", "RecordReport", &["motorctl/record/src/record.rs"]),
    schema("motorctl-sim", "InjectedFault", &["motorctl/src/sim.rs"]),
];

impl Schema {
    pub(super) fn path(&self) -> String {
        format!("docs/schema/{}.json", self.name)
    }

    /// Returns the schema with the fields of its type.
    pub(super) fn of_type(&self) -> String {
        let text = |path: &str| std::fs::read_to_string(root().join(path)).expect("a file of the table");
        let structures = Structures::of(self.files.iter().map(|path| text(path)));
        let mut schema = Json::read(&text(&self.path()));
        let printed = syn::parse_str(self.printed).expect("a type");
        structures.describe(&mut schema, &printed, false);
        schema.text()
    }
}

/// The structures of some files, by name.
struct Structures(BTreeMap<String, ItemStruct>);

impl Structures {
    fn of(files: impl Iterator<Item = String>) -> Self {
        let items = files.flat_map(|text| syn::parse_file(&text).expect("it compiles").items);
        let structures = items.filter_map(|item| match item {
            syn::Item::Struct(structure) => Some((structure.ident.to_string(), structure)),
            _ => None,
        });
        Self(structures.collect())
    }

    /// Gives `schema` the form of a type. Constraints that it has stay.
    fn describe(&self, schema: &mut Json, of: &Type, is_optional: bool) {
        match of {
            Type::Reference(reference) => self.describe(schema, &reference.elem, is_optional),
            Type::Array(array) => self.describe_list(schema, &array.elem, is_optional),
            Type::Path(path) => {
                let last = path.path.segments.last().expect("a type has a name");
                match (last.ident.to_string().as_str(), argument(&last.arguments)) {
                    ("Option", Some(some)) => self.describe(schema, some, true),
                    ("Vec", Some(item)) => self.describe_list(schema, item, is_optional),
                    ("String" | "str", None) => set_type(schema, "string", is_optional),
                    ("bool", None) => set_type(schema, "boolean", is_optional),
                    ("f32" | "f64", None) => set_type(schema, "number", is_optional),
                    ("u8" | "u16" | "u32" | "u64" | "usize", None) => {
                        set_type(schema, "integer", is_optional);
                        if !schema.has("minimum") {
                            *schema.member("minimum") = Json::Plain(0.into());
                        }
                    }
                    (name, _) => {
                        let structure = self.0.get(name).unwrap_or_else(|| panic!("{name}: name its file"));
                        self.describe_fields(schema, structure, is_optional);
                    }
                }
            }
            _ => panic!("a type without a form in JSON"),
        }
    }

    fn describe_list(&self, schema: &mut Json, item: &Type, is_optional: bool) {
        set_type(schema, "array", is_optional);
        self.describe(schema.member("items"), item, false);
    }

    fn describe_fields(&self, schema: &mut Json, structure: &ItemStruct, is_optional: bool) {
        set_type(schema, "object", is_optional);
        let Fields::Named(fields) = &structure.fields else { panic!("{}: no names", structure.ident) };
        let (mut properties, mut required) = (Vec::new(), Vec::new());
        for field in &fields.named {
            let name = field.ident.as_ref().expect("a named field").to_string();
            let mut property = std::mem::replace(schema.member("properties").member(&name), Json::EMPTY);
            self.describe(&mut property, &field.ty, false);
            *property.member("description") = documentation(&field.attrs).as_str().into();
            if !has_serde(&field.attrs, "skip_serializing_if") {
                required.push(name.as_str().into());
            }
            properties.push((name, property));
        }
        *schema.member("properties") = Json::Object(properties);
        *schema.member("required") = Json::Array(required);
    }
}

/// The first type in the angle brackets of a name.
fn argument(arguments: &PathArguments) -> Option<&Type> {
    let PathArguments::AngleBracketed(list) = arguments else { return None };
    list.args.iter().find_map(|argument| match argument {
        GenericArgument::Type(of) => Some(of),
        _ => None,
    })
}

/// Sets the type, unless an `enum` lists the values.
fn set_type(schema: &mut Json, name: &str, is_optional: bool) {
    if !schema.has("enum") {
        let names = [name, "null"].map(Json::from).to_vec();
        *schema.member("type") = if is_optional { Json::Array(names) } else { name.into() };
    }
}

/// The sentences of a field.
fn documentation(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| match &attribute.meta {
        syn::Meta::NameValue(pair) if pair.path.is_ident("doc") => match &pair.value {
            syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(line), .. }) => {
                Some(line.value().trim().to_owned())
            }
            _ => None,
        },
        _ => None,
    });
    lines.collect::<Vec<_>>().join(" ")
}

/// Returns whether serde reads this word in the attributes.
fn has_serde(attributes: &[Attribute], word: &str) -> bool {
    attributes.iter().filter(|attribute| attribute.path().is_ident("serde")).any(|attribute| {
        let syn::Meta::List(list) = &attribute.meta else { return false };
        list.tokens.to_string().contains(word)
    })
}

#[test]
fn new_field_appears_and_constraints_stay() {
    let code = "struct A<'a> {
        /// One.
        one: u32,
        /// Two
        /// lines.
        #[serde(skip_serializing_if = \"Option::is_none\")]
        two: Option<Vec<&'a str>>,
    }";
    let structures = Structures::of([code.to_owned()].into_iter());
    let mut schema = Json::read(
        r#"{"title": "t", "properties": {"gone": {}, "one": {"minimum": 10}}, "required": ["gone"]}"#,
    );
    structures.describe(&mut schema, &syn::parse_str("A").unwrap(), false);
    let expected = r#"{
        "title": "t",
        "properties": {
            "one": {"minimum": 10, "type": "integer", "description": "One."},
            "two": {"type": ["array", "null"], "items": {"type": "string"}, "description": "Two lines."}
        },
        "required": ["one"],
        "type": "object"
    }"#;
    assert_eq!(schema, Json::read(expected));
}

// The keys of a joint and of an IMU in the schema of `motorctl status`, from the tables of their
// states. Other keys are written by hand, and stay where they are.

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
