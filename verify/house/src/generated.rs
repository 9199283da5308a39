//! The messages of recordings in `motorctl/mcap/generated/`.
//!
//! They are committed, so that a build of motord does without the compiler of Protobuf. The test is
//! not in that crate, which does not compile before they have a new field.

use crate::sources::root;
use prost::Message;

/// `MOTORD_WRITE_DOCS=1` writes them.
#[test]
fn generated_messages_are_those_of_schema() {
    let folder = root().join("motorctl/mcap");
    let files = ["motord.proto", "foxglove/Log.proto"];
    let schema = protox::compile(files, [folder.join("proto")]).expect("the schema is valid");
    let made = tempfile::tempdir().unwrap();
    std::fs::write(made.path().join("schema.bin"), schema.encode_to_vec()).unwrap();
    let mut build = prost_build::Config::new();
    build.out_dir(made.path()).compile_fds(schema).expect("the schema is valid");
    for file in ["motord.rs", "foxglove.rs", "schema.bin"] {
        let committed = folder.join("generated").join(file);
        let made = std::fs::read(made.path().join(file)).unwrap();
        if std::env::var_os("MOTORD_WRITE_DOCS").is_some() {
            std::fs::write(&committed, &made).unwrap();
        }
        let advice = "MOTORD_WRITE_DOCS=1 cargo test -p motord-house generated writes it";
        assert!(std::fs::read(committed).ok() == Some(made), "{file} is not that of the schema: {advice}");
    }
}
