//! The enumerations of `motord.h` that come from the tables of a joint's state and of codes.

use motord_shared::{Fault, JointState, Limit};
use std::fmt::{Error, Write};

const HEAD: &str = "\
//! Enumerations of `motord.h`, from the tables of a joint's state and of codes. Generated:
//! `MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated` writes it.
";

/// Quantities that are not measured: name, number and meaning.
const OTHERS: [(&str, u32, &str); 9] = [
    ("temperature", 3, "Temperature of the motor, °C."),
    ("applied-position", 4, "Position of the applied command, rad."),
    ("applied-velocity", 5, "Velocity of the applied command, rad/s."),
    ("applied-torque", 6, "Torque of the applied command, N·m."),
    ("applied-kp", 7, "Stiffness of the applied command, N·m/rad."),
    ("applied-kd", 8, "Damping of the applied command, N·m·s/rad."),
    ("age", 9, "Time from the motor's last reply to now, s; NaN before its first."),
    ("supply-voltage", 10, "Voltage of the supply as the motor last reported it, V."),
    ("supply-current", 11, "Current from the supply as the motor last reported it, A."),
];

/// A variant of an enumeration.
struct Variant {
    name: String,
    value: String,
    meaning: String,
}

impl Variant {
    /// `words` are separated by `-`.
    fn new(words: &str, value: String, meaning: &str) -> Self {
        Self { name: words.split('-').map(capitalised).collect(), value, meaning: meaning.to_owned() }
    }

    fn bit(words: &str, bit: u32, meaning: &str) -> Self {
        Self::new(words, format!("1 << {bit}"), meaning)
    }
}

fn capitalised(word: &str) -> String {
    let (first, rest) = word.split_at(1);
    first.to_uppercase() + rest
}

/// The quantities, in the order of their numbers.
fn quantities() -> Vec<Variant> {
    let others =
        OTHERS.map(|(name, number, meaning)| (number, Variant::new(name, number.to_string(), meaning)));
    let measured = JointState::FIELDS.iter().filter_map(|field| {
        let meaning = format!("{}, {}.", capitalised(&field.name.replace('_', " ")), field.unit);
        let number = field.quantity?;
        Some((number, Variant::new(&field.name.replace('_', "-"), number.to_string(), &meaning)))
    });
    let mut all: Vec<_> = measured.chain(others).collect();
    all.sort_by_key(|(number, _)| *number);
    let numbers = all.iter().map(|(number, _)| *number);
    assert!(numbers.eq(0..all.len() as u32), "the numbers of quantities have no gap");
    all.into_iter().map(|(_, quantity)| quantity).collect()
}

fn declare(text: &mut String, name: &str, meaning: &str, variants: &[Variant]) -> Result<(), Error> {
    let derives = "#[derive(Debug, Clone, Copy, PartialEq, Eq)]\n#[repr(C)]";
    writeln!(text, "\n/// {meaning}\n{derives}\npub enum {name} {{")?;
    for Variant { name, value, meaning } in variants {
        writeln!(text, "    /// {meaning}\n    {name} = {value},")?;
    }
    writeln!(text, "}}")
}

/// The file with the enumerations.
pub(super) fn of_tables() -> Result<String, Error> {
    let mut text = HEAD.to_owned();
    let quantities = quantities();
    declare(&mut text, "Quantity", "A quantity of a joint.", &quantities)?;
    writeln!(text, "\nimpl Quantity {{\n    /// All, in the order of their numbers.")?;
    writeln!(text, "    pub(crate) const ALL: &[Self] = &[")?;
    for Variant { name, .. } in &quantities {
        writeln!(text, "        Self::{name},")?;
    }
    writeln!(text, "    ];\n}}")?;
    let faults = Fault::ALL.iter().map(|fault| Variant::bit(fault.name(), fault.code(), fault.sentence()));
    let meaning = "A fault that a motor reports: a bit of `faults` of a `motord_joint`.";
    declare(&mut text, "FaultBit", meaning, &faults.collect::<Vec<_>>())?;
    let limits = Limit::ALL.iter().map(|limit| Variant::bit(limit.name(), limit.code(), limit.sentence()));
    let meaning = "A limit that changed a command: a bit of `limits` of a `motord_joint`.";
    declare(&mut text, "LimitBit", meaning, &limits.collect::<Vec<_>>())?;
    Ok(text)
}
