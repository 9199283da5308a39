//! Committed files that come from the tables in `shared`: the messages of recordings, so that a
//! build does without the compiler of Protobuf, enumerations of `motord.h`, the stub of the Python
//! package, and schemas of JSON. Schemas of structures come from the code of these.
//!
//! The tests are not in the crates with these files, which do not compile before they have a new
//! field.

mod header;
mod json;
mod json_schema;
mod schema;
mod stub;

use crate::sources::root;
use prost::Message;

/// Compares a file with what it should be. `MOTORD_WRITE_DOCS=1` writes it.
fn assert_current(path: &str, made: &[u8]) {
    let committed = root().join(path);
    if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
        std::fs::write(&committed, made).unwrap();
    }
    let advice = "MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated writes it";
    assert!(
        std::fs::read(committed).ok().as_deref() == Some(made),
        "{path} is not that of its table: {advice}"
    );
}

#[test]
fn generated_messages_are_those_of_schema() {
    assert_current("motorctl/mcap/proto/motord.proto", schema::of_tables().as_bytes());
    let folder = root().join("motorctl/mcap");
    let files = ["motord.proto", "foxglove/Log.proto"];
    let schema = protox::compile(files, [folder.join("proto")]).expect("the schema is valid");
    let made = tempfile::tempdir().unwrap();
    std::fs::write(made.path().join("schema.bin"), schema.encode_to_vec()).unwrap();
    let mut build = prost_build::Config::new();
    build.out_dir(made.path()).compile_fds(schema).expect("the schema is valid");
    for file in ["motord.rs", "foxglove.rs", "schema.bin"] {
        let made = std::fs::read(made.path().join(file)).unwrap();
        assert_current(&format!("motorctl/mcap/generated/{file}"), &made);
    }
}

/// `packaging/c-header` makes the header of them.
#[test]
fn generated_enumerations_are_those_of_tables() {
    assert_current("client/c/src/generated.rs", header::of_tables().unwrap().as_bytes());
}

#[test]
fn generated_stub_is_that_of_its_table() {
    assert_current("client/python/python/motord/_motord.pyi", stub::of_table().as_bytes());
}

#[test]
fn generated_status_schema_is_that_of_tables() {
    assert_current("docs/schema/motorctl-status.json", json_schema::of_tables().as_bytes());
}

#[test]
fn generated_schemas_are_those_of_types() {
    for schema in json_schema::SCHEMAS {
        assert_current(&schema.path(), schema.of_type().as_bytes());
    }
}
