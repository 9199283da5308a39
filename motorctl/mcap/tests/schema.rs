//! The message of a joint in `proto/motord.proto` comes from the table of its state.

use motord_shared::{Field, JointState, Kind};

/// Longest line of the schema.
const COLUMNS: usize = 100;

const SCHEMA: &str = include_str!("../proto/motord.proto");

/// Returns the field as a comment and a declaration.
fn declared(field: &Field, (name, number): (&str, u32)) -> String {
    let unit = if field.unit.is_empty() { String::new() } else { format!(" Unit: {}.", field.unit) };
    let absence = match field.kind {
        Kind::Measured => " Absent before the motor has reported it.",
        Kind::Optional => " Absent where the motor does not report it.",
        Kind::Set(_) => " Bits.",
        _ => "",
    };
    let mut text = String::from("  //");
    let mut width = text.len();
    for word in format!("{}{unit}{absence}", field.doc).split(' ') {
        if width + 1 + word.chars().count() > COLUMNS {
            text.push_str("\n  //");
            width = 4;
        }
        text.extend([" ", word]);
        width += 1 + word.chars().count();
    }
    format!("{text}\n  {} {name} = {number};\n", field.kind.proto())
}

/// Returns the message of a joint in the schema.
fn committed() -> &'static str {
    let begin = SCHEMA.find("message Joint {").expect("the schema has a joint");
    let length = SCHEMA[begin..].find("}\n").expect("a message ends") + 2;
    &SCHEMA[begin..begin + length]
}

#[test]
fn joint_schema_is_generated_from_its_table() {
    let fields = JointState::FIELDS.iter();
    let mut rows: Vec<_> = fields.filter_map(|field| Some((field.proto?, field))).collect();
    rows.sort_by_key(|((_, number), _)| *number);
    let mut expected = String::from("message Joint {\n  // Number of the cycle.\n  uint64 cycle = 1;\n");
    for (proto, field) in rows {
        if proto.1 == 7 {
            expected.push_str(
                "  // The setpoint in use, before all limits. Absent while the joint's group has none.\n  Setpoint setpoint = 6;\n",
            );
        }
        expected.push_str(&declared(field, proto));
    }
    expected.push_str("}\n");
    let found = committed();
    assert!(found == expected, "write this into proto/motord.proto:\n{expected}\ninstead of:\n{found}");
}

/// Recordings of older versions stay readable: a name keeps its number and its type.
#[test]
fn fields_of_a_recorded_joint_keep_their_numbers() {
    let numbers = [
        ("cycle", "uint64", 1),
        ("position", "optional float", 2),
        ("velocity", "optional float", 3),
        ("torque", "optional float", 4),
        ("temperature", "optional float", 5),
        ("setpoint", "Setpoint", 6),
        ("applied", "Command", 7),
        ("mode", "string", 8),
        ("faults", "uint32", 9),
        ("limits", "uint32", 10),
        ("fresh", "bool", 11),
        ("age_cycles", "uint32", 12),
        ("missed", "uint32", 13),
        ("late", "uint32", 14),
        ("implausible", "uint32", 15),
        ("reply_latency_ns", "uint32", 16),
        ("receive_ns", "uint64", 17),
        ("foreign_commands", "uint32", 18),
    ];
    for (name, kind, number) in numbers {
        assert!(committed().contains(&format!("  {kind} {name} = {number};\n")), "{name}");
    }
}
