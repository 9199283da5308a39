//! Compares the codec with golden frames of every profile, in both directions. The last column
//! names their source.
//!
//! Each profile has a file `golden/NAME.csv`. To a motor: the bytes of a command with these values.
//! From a motor: the values of these bytes. Values are physical. Temperatures and faults are
//! separated by spaces.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test that cannot set itself up has failed")]

use motord_protocol::mit::{Asked, Command, Impedance, Reply, State};
use motord_protocol::profile::{FaultReport, Healthy, shipped};
use motord_protocol::{FAMILIES, Faults, Model, Profile, Scales};
use motord_shared::Fault;
use std::path::Path;

const HEADER: &str = "direction,kind,model,hex,id,position,velocity,kp,kd,torque,temperatures,faults,source";

struct Row {
    columns: Vec<String>,
}

impl Row {
    fn text(&self, name: &str) -> &str {
        let index = HEADER.split(',').position(|column| column == name).unwrap();
        &self.columns[index]
    }

    fn number(&self, name: &str) -> f32 {
        self.text(name).parse().unwrap_or_else(|_| panic!("{name} of {:?}", self.columns))
    }

    fn bytes(&self) -> Vec<u8> {
        let digits = self.text("hex").as_bytes();
        digits.chunks(2).map(|pair| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
    }

    fn scales(&self) -> Scales {
        Model::by_name(self.text("model")).unwrap().scales().unwrap()
    }
}

/// Returns whether the states of a motor are codes, of which there are golden frames.
fn has_codes(profile: &Profile) -> bool {
    let is_coded = |name: &&str| FAMILIES.iter().any(|(family, it)| family == name && it.family().has_codes);
    profile.protocols.iter().any(is_coded)
}

fn rows(profile: &Profile) -> Vec<Row> {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let path = directory.join(profile.name).with_extension("csv");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let (header, rows) = text.split_once('\n').unwrap();
    assert_eq!(header, HEADER, "{}", path.display());
    let row = |line: &str| Row { columns: line.split(',').map(|column| column.trim().to_owned()).collect() };
    rows.lines().map(row).collect()
}

fn command(row: &Row) -> Command {
    match row.text("kind") {
        "start" => Command::Start,
        "stop" => Command::Stop,
        "zero" => Command::SetZero,
        "clear" => Command::ClearFault,
        "ask" => Command::GetFault,
        "control" => Command::Control(Impedance {
            position: row.number("position"),
            velocity: row.number("velocity"),
            kp: row.number("kp"),
            kd: row.number("kd"),
            torque: row.number("torque"),
        }),
        other => panic!("{other} is no command"),
    }
}

fn assert_state(row: &Row, state: &State) {
    let close = |value: f32, name: &str| {
        let expected = row.number(name);
        assert!(
            (value - expected).abs() < 1e-4 * expected.abs().max(1.0),
            "{name} is {value}: {:?}",
            row.columns
        );
    };
    close(state.position, "position");
    close(state.velocity, "velocity");
    close(state.torque, "torque");
    let expected: Vec<f32> =
        row.text("temperatures").split_whitespace().map(|number| number.parse().unwrap()).collect();
    let reported: Vec<f32> = state.temperatures.into_iter().flatten().collect();
    assert_eq!(reported, expected, "{:?}", row.columns);
}

fn assert_faults(row: &Row, faults: Faults) {
    let names: Vec<_> = Fault::of_bits(faults.0).map(Fault::name).collect();
    assert_eq!(names.join(" "), row.text("faults"), "{:?}", row.columns);
}

fn assert_reply(profile: &Profile, row: &Row) {
    let asked = match row.text("kind") {
        "state" => Asked::State,
        "fault" => Asked::Fault,
        "cleared" => Asked::Clear,
        other => panic!("{other} is no reply"),
    };
    let bytes = row.bytes();
    let reply = profile.decode(&bytes, asked, &row.scales()).unwrap();
    assert_eq!(f32::from(reply.id()), row.number("id"), "{:?}", row.columns);
    assert!(profile.is_from(reply.id(), &bytes));
    match reply {
        Reply::State(state) => {
            assert_state(row, &state);
            assert_faults(row, profile.faults_of(&state).unwrap_or_default());
            assert!(!profile.is_fault_report(&bytes), "{:?}", row.columns);
        }
        Reply::Fault { faults, .. } => assert_faults(row, faults),
        Reply::Cleared { .. } => {}
    }
    let (written, known) = profile.encode_over(&reply, [0; 8]);
    assert_eq!(written[..known], bytes[..known], "{:?}", row.columns);
}

#[test]
fn golden_frames_of_profiles_round_trip_as_sourced() {
    for profile in Profile::all().filter(|profile| has_codes(profile)) {
        let rows = rows(profile);
        for row in &rows {
            match row.text("direction") {
                "to-motor" => {
                    let bytes = profile.encode(&command(row), &row.scales()).unwrap();
                    assert_eq!(bytes[..], row.bytes(), "{:?}", row.columns);
                }
                "to-host" => assert_reply(profile, row),
                other => panic!("{other} is no direction"),
            }
            assert!(!row.text("source").is_empty(), "{:?}", row.columns);
        }
        assert!(rows.len() >= 8, "{}", profile.name);
    }
}

#[test]
fn every_nonzero_number_is_a_fault() {
    for profile in Profile::all() {
        match &profile.faults {
            FaultReport::Asked(reply) => {
                for bit in (0..8 * reply.bytes).map(|index| 1_u32 << index) {
                    assert!(!reply.faults(bit).is_none(), "{} {bit:#x}", profile.name);
                }
                assert!(reply.faults(0).is_none());
            }
            FaultReport::InEveryReply(status) => {
                let codes = 0..=u8::MAX >> status.shift;
                let sound: Vec<u8> = codes.filter(|code| status.faults(*code).is_none()).collect();
                let healthy = match status.healthy {
                    Healthy::Mode { off, on } => vec![off, on],
                    Healthy::Code(code) => vec![code],
                };
                assert_eq!(sound, healthy, "{}", profile.name);
            }
            FaultReport::Never => {}
        }
    }
}

#[test]
fn names_of_profiles_and_models_are_unique() {
    let mut names: Vec<_> = Profile::all().map(|profile| profile.name).collect();
    let models = Profile::all().flat_map(|profile| profile.models);
    names.extend(models.map(|model| model.name));
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count);
}

#[test]
fn shipped_motors_speak_known_protocols() {
    for (profile, _) in shipped() {
        let is_known = |name: &&str| FAMILIES.iter().any(|(known, _)| known == name);
        assert!(profile.protocols.iter().all(is_known), "{}", profile.name);
        assert!(!profile.protocols.is_empty(), "{}", profile.name);
    }
}
