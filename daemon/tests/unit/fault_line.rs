//! The lines that ask for a fault of the simulator.

use super::*;
use motord_simulator::Fault;
use std::path::Path;

fn said(line: &str) -> Result<Fault, String> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config/quadruped-simulated.toml");
    let settings = motord_configuration::load(&file).unwrap().settings;
    read(line, &settings).map(|verb| verb.fault).map_err(|error| error.to_string())
}

#[test]
fn vendor_fault_may_be_named_or_numbered() {
    assert_eq!(said("fl-knee fault over-voltage"), Ok(Fault::Raise(2)));
    assert_eq!(said("fl-knee fault 0x04"), Ok(Fault::Raise(4)));
}

#[test]
fn unknown_word_suggests_the_nearest() {
    let cases = [
        ("fl-kne off", "no motor or bus \"fl-kne\": did you mean `fl-knee`?"),
        ("front-lft bus-off", "no motor or bus \"front-lft\": did you mean `front-left`?"),
        ("fl-knee delay 2ms", "no fault \"delay\": did you mean `delayed`?"),
        ("fl-knee fault overvoltage", "fl-knee cannot raise \"overvoltage\": did you mean `over-voltage`?"),
        ("fl-knee delayed 2", "bad argument; expected something like 2ms"),
        ("fl-knee", "1 words; expected a target, a verb and at most one argument"),
        ("fl-knee \u{1b}[2J", "no fault \"\\u{1b}[2J\": known are ok, on, off"),
    ];
    for (line, begin) in cases {
        let sentence = said(line).unwrap_err();
        assert!(sentence.starts_with(begin), "{line}: {sentence}");
        assert!(!sentence.contains('\u{1b}'));
    }
}
