//! The table of docs/protocol.md: every command, configuration item, parameter, indicator, fault
//! and result code of the vendor's documents. Each row has the line of motorctl that uses it, and
//! the tests that cover it.
//!
//! The table is generated from the crate that implements the documents: no row can be missing.
//! `MOTORD_WRITE_DOCS=1` writes it.

use motord_client::Fault;
use motord_protocol::gim::{
    Access, CONFIGURATION, CommandCode, ConfigurationItem, INDICATORS, PARAMETERS, Refusal,
};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

/// The line of motorctl, the test on CAN, the test on RS485.
type Row = [&'static str; 3];

const COMMANDS_ON_CAN: &str = "every_command_of_the_document_works_over_can";
const IN_MIT: &str = "mit_motor_is_found_jogged_and_zeroed";
const MOVES: &str = "motor_moves_for_bounded_time_and_stops";
const WRITTEN_ON_CAN: &str = "every_configuration_item_is_written_over_can";
const SET_ON_CAN: &str = "every_writable_item_is_set_over_can";
const SET_ON_RS485: &str = "every_writable_item_is_set_by_name";
const LISTED: &str = "every_configuration_item_is_listed_in_full";
const ADDRESS: &str = "ids_and_protocol_are_changed_and_confirmed";
const PTS: &str = "pts_control_is_refused_as_documented";

fn command(code: CommandCode) -> Row {
    use CommandCode as Code;
    match code {
        Code::ResetConfiguration => [
            "motorctl config reset",
            "factory_reset_is_undone_over_can",
            "factory_reset_is_undone_by_dump_and_apply",
        ],
        Code::RefreshConfiguration => {
            ["motorctl config apply FILE", WRITTEN_ON_CAN, "factory_reset_is_undone_by_dump_and_apply"]
        }
        Code::ModifyConfiguration => ["motorctl config set NAME VALUE", SET_ON_CAN, SET_ON_RS485],
        Code::RetrieveConfiguration => ["motorctl config list", WRITTEN_ON_CAN, LISTED],
        Code::StartMotor => ["motorctl start", COMMANDS_ON_CAN, MOVES],
        Code::StopMotor => ["motorctl stop", COMMANDS_ON_CAN, MOVES],
        Code::TorqueControl => ["motorctl torque NM", COMMANDS_ON_CAN, MOVES],
        Code::SpeedControl => ["motorctl speed RAD/S", COMMANDS_ON_CAN, MOVES],
        Code::PositionControl => ["motorctl position RAD", COMMANDS_ON_CAN, MOVES],
        Code::PtsControl => ["motorctl pts", PTS, PTS],
        Code::StopControl => ["motorctl stop --control", COMMANDS_ON_CAN, MOVES],
        Code::ModifyParameter => {
            ["motorctl parameter set NAME VALUE", COMMANDS_ON_CAN, "every_parameter_is_written_and_read_back"]
        }
        Code::RetrieveParameter => {
            ["motorctl parameter get", COMMANDS_ON_CAN, "every_parameter_is_written_and_read_back"]
        }
        Code::GetVersion => ["motorctl version", COMMANDS_ON_CAN, "ping_shows_version_and_address"],
        Code::GetFault => ["motorctl fault get", COMMANDS_ON_CAN, "a_fault_is_read_in_words_and_cleared"],
        Code::AcknowledgeFault => {
            ["motorctl fault clear", COMMANDS_ON_CAN, "a_fault_is_read_in_words_and_cleared"]
        }
        Code::RetrieveIndicator => {
            ["motorctl indicator NAME", COMMANDS_ON_CAN, "every_indicator_is_read_with_its_unit"]
        }
        Code::Calibration => {
            ["motorctl calibrate encoder", COMMANDS_ON_CAN, "a_calibration_waits_for_its_end"]
        }
        Code::UpdateFirmware => {
            ["motorctl firmware-mode", COMMANDS_ON_CAN, "a_motor_in_firmware_mode_is_silent"]
        }
    }
}

fn item(item: &ConfigurationItem) -> Row {
    match item.name {
        "can-id" => ["motorctl id --set-id ID", COMMANDS_ON_CAN, ADDRESS],
        "host-id" => ["motorctl id --set-host-id ID", COMMANDS_ON_CAN, ADDRESS],
        "can-protocol" => ["motorctl protocol mit", IN_MIT, ADDRESS],
        "can-baud-rate" => ["motorctl config set NAME VALUE", SET_ON_CAN, SET_ON_RS485],
        "zero-position" => ["motorctl zero --at RAD", COMMANDS_ON_CAN, "zero_is_moved_to_angle_and_checked"],
        _ if item.access == Access::ReadOnly => ["motorctl config get NAME", COMMANDS_ON_CAN, LISTED],
        _ => ["motorctl config set NAME VALUE", SET_ON_CAN, SET_ON_RS485],
    }
}

/// The commands of the MIT document, which is for CAN only.
const MIT: [(&str, &str); 6] = [
    ("get fault", "motorctl fault get --protocol mit"),
    ("clear fault", "motorctl fault clear --protocol mit"),
    ("start motor", "motorctl jog"),
    ("stop motor", "motorctl stop"),
    ("set zero", "motorctl zero"),
    ("dynamic control", "motorctl jog"),
];

/// Table 9, in the words of the document.
const TABLE_9: [(u8, &str); 8] = [
    (0x00, "No Fault"),
    (0x01, "FoC Frequency Too High"),
    (0x02, "Over Voltage"),
    (0x04, "Under Voltage"),
    (0x08, "Over Temperature"),
    (0x10, "Start Failure"),
    (0x40, "Over Current"),
    (0x80, "Software Exception"),
];

fn row(text: &mut String, number: &str, name: &str, [line, can, rs485]: Row) {
    writeln!(text, "| {number} | {name} | `{line}` | `{can}` | `{rs485}` |").unwrap();
}

fn head(text: &mut String, title: &str, number: &str) {
    write!(text, "\n### {title}\n\n| {number} | name | use | proved on CAN | proved on RS485 |\n|---|---|---|---|---|\n")
        .unwrap();
}

/// The tables, as they stand in the document.
fn tables() -> String {
    let mut text = String::new();
    head(&mut text, "Commands (GIM, Table 4 and 3.2.18)", "byte");
    for code in CommandCode::ALL {
        row(&mut text, &format!("0x{:02X}", code as u8), code.name(), command(code));
    }
    text += "\n### Commands of MIT\n\n| name | use | proved on CAN |\n|---|---|---|\n";
    for (name, line) in MIT {
        writeln!(text, "| {name} | `{line}` | `{IN_MIT}` |").unwrap();
    }
    head(&mut text, "Configuration items (GIM, Tables 6 and 7)", "type, id");
    for row_of_7 in &CONFIGURATION {
        let number = format!("{}, 0x{:02X}", row_of_7.value_type as u8, row_of_7.conf_id);
        row(&mut text, &number, row_of_7.name, item(row_of_7));
    }
    head(&mut text, "Parameters (GIM, Table 8)", "id");
    for parameter in &PARAMETERS {
        row(
            &mut text,
            &format!("0x{:02X}", parameter.id),
            parameter.name,
            command(CommandCode::ModifyParameter),
        );
    }
    head(&mut text, "Indicators (GIM, Table 10)", "id");
    for indicator in &INDICATORS {
        let proof = ["motorctl indicator NAME", COMMANDS_ON_CAN, "every_indicator_is_read_with_its_unit"];
        row(&mut text, &format!("0x{:02X}", indicator.id), indicator.name, proof);
    }
    codes(&mut text);
    text
}

/// Calibrations, faults and result codes.
fn codes(text: &mut String) {
    head(text, "Calibrations (GIM, Table 11)", "type");
    for (number, name, line) in
        [(0, "phase order", "motorctl calibrate phase"), (1, "encoder", "motorctl calibrate encoder")]
    {
        row(
            text,
            &format!("0x{number:02X}"),
            name,
            [line, COMMANDS_ON_CAN, "a_calibration_waits_for_its_end"],
        );
    }
    head(text, "Faults (GIM, Table 9; MIT, 1.2)", "number");
    for (bit, name) in TABLE_9 {
        let proof = [
            "motorctl fault get",
            "every_documented_fault_is_cleared_over_can",
            "every_documented_fault_is_named_and_cleared",
        ];
        row(text, &format!("0x{bit:02X}"), name, proof);
    }
    head(text, "Result codes (GIM, Table 5)", "RES");
    let proof = [
        "motorctl config set NAME VALUE",
        "every_result_code_is_shown_over_can",
        "every_result_code_is_shown_in_words",
    ];
    row(text, "0x00", "success", proof);
    for code in [0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x0B] {
        let refusal = Refusal::check(code).unwrap_err().to_string();
        let word = refusal.trim_start_matches("the motor refused: ").split(" (").next().unwrap().to_owned();
        row(text, &format!("0x{code:02X}"), &word, proof);
    }
}

const BEGIN: &str = "<!-- written by motorctl/tests/commands/protocol_table.rs -->\n";

#[test]
fn protocol_tables_are_complete_and_present() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/protocol.md");
    let document = std::fs::read_to_string(&path).unwrap();
    let (before, present) = document.split_once(BEGIN).expect("the page has the tables");
    if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
        std::fs::write(&path, format!("{before}{BEGIN}{}", tables())).unwrap();
    } else {
        assert_eq!(
            present,
            tables(),
            "MOTORD_WRITE_DOCS=1 cargo test -p motorctl --test commands protocol_table writes them"
        );
    }
}

#[test]
fn every_table_line_is_a_motorctl_command() {
    let tables = tables();
    let lines: BTreeSet<&str> = tables.split('`').filter(|text| text.starts_with("motorctl ")).collect();
    assert!(lines.len() > 20, "{lines:?}");
    for line in lines {
        let words =
            line.split(' ').skip(1).take_while(|word| word.starts_with(|c: char| c.is_ascii_lowercase()));
        let output = Command::new(env!("CARGO_BIN_EXE_motorctl")).args(words).arg("--help").output().unwrap();
        assert!(output.status.success(), "{line}");
        let help = String::from_utf8(output.stdout).unwrap();
        for option in line.split(' ').filter(|word| word.starts_with("--")) {
            assert!(help.contains(option), "{line}: {option}");
        }
    }
}

/// Goal: each row names tests that exist, the one on CAN among those of `wire_vcan.rs`, the one on
/// RS485 among those of `wire.rs`.
#[test]
fn every_table_test_runs_motorctl_on_wire() {
    let on_can = include_str!("../wire_vcan.rs");
    let on_rs485 = include_str!("wire.rs");
    for row in tables().lines().filter(|row| row.contains("`motorctl ") && !row.contains(PTS)) {
        let proofs: Vec<&str> = row.split('`').skip(3).step_by(2).collect();
        for (proof, tests) in proofs.iter().zip([on_can, on_rs485]) {
            assert!(tests.contains(&format!("fn {proof}()")), "{row}");
        }
        assert!(!proofs.is_empty(), "{row}");
    }
    assert!(on_rs485.contains(PTS));
}

#[test]
fn table_faults_are_those_of_the_document() {
    let known: u32 = TABLE_9.iter().map(|(bit, _)| u32::from(*bit)).sum();
    let named = Fault::ALL.iter().map(|fault| fault.bit()).filter(|bit| *bit <= 0xFF).sum::<u32>();
    assert_eq!(known, named);
}
