//! Memories of motors that persist across processes.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::Bench;
use motord_simulator::{Dialect, MotorSettings, Store};

fn bench() -> Bench {
    Bench::new(MotorSettings { dialect: Dialect::Gim, ..MotorSettings::default() })
}

#[test]
fn stored_values_survive_restart_and_others_not() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&folder.path().join("memories")).unwrap();
    let mut first = bench();
    first.ask([0x83, 0, 0x11, 0, 36, 0, 0, 0]);
    first.ask([0x82, 0, 0, 0, 0, 0, 0, 0]);
    first.ask([0x83, 0, 0x11, 0, 48, 0, 0, 0]);
    store.save(first.bus.motors()).unwrap();
    let mut second = bench();
    Store::open(&folder.path().join("memories")).unwrap().load(&mut second.bus).unwrap();
    assert_eq!(second.ask([0x84, 0, 0x11, 0, 0, 0, 0, 0])[4], 36);
}

#[test]
fn a_file_that_is_no_memory_is_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("joint.memory"), "int 0x12 seven").unwrap();
    let error = Store::open(folder.path()).unwrap().load(&mut bench().bus).unwrap_err().to_string();
    assert!(error.contains("joint.memory: not the memory of a motor"), "{error}");
}
