//! The messages of a joint and of an IMU in `motord.proto`, from the tables of their states.

use motord_shared::{Field, ImuState, JointState, Kind};

/// Longest line of the schema.
const COLUMNS: usize = 100;

const SCHEMA: &str = include_str!("../../../../motorctl/mcap/proto/motord.proto");

/// Returns the field as a comment and a declaration.
fn declared(field: &Field, (name, number): (&str, u32), is_imu: bool) -> String {
    let unit = if field.unit.is_empty() { String::new() } else { format!(" Unit: {}.", field.unit) };
    let absence = match field.kind {
        Kind::Measured => " Absent before the motor has reported it.",
        Kind::Vector(_) => " Absent before the first sample.",
        Kind::Optional if field.name == "temperature" && is_imu => " Absent where it is not reported.",
        Kind::Optional => " Absent where the motor does not report it.",
        Kind::Set(_) | Kind::FlagSet(..) => " Bits.",
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

/// Returns a message of the schema.
fn committed(message: &str) -> &'static str {
    let begin = SCHEMA.find(&format!("message {message} {{")).expect("the schema has this message");
    let length = SCHEMA[begin..].find("}\n").expect("a message ends") + 2;
    &SCHEMA[begin..begin + length]
}

/// The fields with a number in Protobuf, in the order of these numbers.
fn rows(fields: &'static [Field]) -> Vec<(&'static Field, (&'static str, u32))> {
    let mut rows: Vec<_> = fields.iter().filter_map(|field| Some((field, field.proto?))).collect();
    rows.sort_by_key(|(_, (_, number))| *number);
    rows
}

fn imu() -> String {
    let mut message = String::from("message Imu {\n  // Number of the cycle.\n  uint64 cycle = 1;\n");
    for (field, proto) in rows(ImuState::FIELDS) {
        message.push_str(&declared(field, proto, true));
    }
    message + "}\n"
}

fn joint() -> String {
    let mut message = String::from("message Joint {\n  // Number of the cycle.\n  uint64 cycle = 1;\n");
    for (field, proto) in rows(JointState::FIELDS) {
        if proto.1 == 7 {
            message.push_str(
                "  // The setpoint in use, before all limits. Absent while the joint's group has none.\n  Setpoint setpoint = 6;\n",
            );
        }
        message.push_str(&declared(field, proto, false));
    }
    message + "}\n"
}

/// The schema, with the messages of the tables.
pub(super) fn of_tables() -> String {
    SCHEMA.replace(committed("Imu"), &imu()).replace(committed("Joint"), &joint())
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
        ("clamped", "uint32", 19),
    ];
    for (name, kind, number) in numbers {
        assert!(committed("Joint").contains(&format!("  {kind} {name} = {number};\n")), "{name}");
    }
}
