//! The golden frames of the protocols whose ids have a node and a command.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::Faults;
use motord_protocol::cansimple::Id;
use motord_shared::Fault;

/// A row: direction, kind, id, payload, values and source.
pub(crate) struct Row {
    pub(crate) kind: Vec<String>,
    pub(crate) id: Id,
    pub(crate) payload: Vec<u8>,
    pub(crate) values: Vec<f32>,
    pub(crate) line: String,
}

impl Row {
    fn of(cells: &[&str]) -> Self {
        let [_, kind, id, payload, values, _] = cells.try_into().unwrap();
        let byte = |at: usize| u8::from_str_radix(&payload[at..at + 2], 16).unwrap();
        Self {
            kind: kind.split(' ').map(str::to_owned).collect(),
            id: Id::of(u32::from_str_radix(id, 16).unwrap()),
            payload: (0..payload.len()).step_by(2).map(byte).collect(),
            values: values.split_whitespace().map(|value| value.parse().unwrap()).collect(),
            line: cells.join(","),
        }
    }

    /// Compares decoded values with those of the sources.
    pub(crate) fn check(&self, values: &[f32], expected: &[f32]) {
        assert_eq!(values.len(), expected.len(), "{}", self.line);
        for (decoded, expected) in values.iter().zip(expected) {
            assert!((decoded - expected).abs() < 2e-6 * expected.abs().max(1.0), "{decoded}: {}", self.line);
        }
    }
}

/// The rows of a file in this direction, at least `least`.
pub(crate) fn rows(file: &str, direction: &str, least: usize) -> Vec<Row> {
    let rows = file.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let rows: Vec<Row> = rows.filter(|row| row[0] == direction).map(|row| Row::of(&row)).collect();
    assert!(rows.len() >= least);
    rows
}

/// The faults with these names; `unrecognised` is the bit without a name.
pub(crate) fn faults(names: &[String], unnamed: u8) -> Faults {
    let bit = |name: &String| match name.as_str() {
        "unrecognised" => Faults::of_unknown_code(unnamed),
        name => Faults(Fault::ALL.iter().find(|fault| fault.name() == name).unwrap().bit()),
    };
    names.iter().map(bit).fold(Faults::NONE, Faults::and)
}
