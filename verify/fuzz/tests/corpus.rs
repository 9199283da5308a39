//! Runs every input of the corpus, on the stable toolchain and without a fuzzer, so that earlier
//! findings stay fixed.

use motord_fuzz::TARGETS;
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

#[test]
fn corpus_inputs_keep_promises_of_their_target() {
    for (name, target) in TARGETS {
        let mut inputs = 0;
        for file in fs::read_dir(corpus().join(name)).unwrap_or_else(|error| panic!("{name}: {error}")) {
            let file = file.unwrap().path();
            let bytes = fs::read(&file).unwrap();
            std::panic::catch_unwind(|| target(&bytes)).unwrap_or_else(|_| panic!("{}", file.display()));
            inputs += 1;
        }
        assert!(inputs > 0, "{name} has a corpus");
        println!("{name}: {inputs} inputs");
    }
}

#[test]
fn target_survives_empty_input_and_one_byte() {
    for (_, target) in TARGETS {
        target(&[]);
        (0..=u8::MAX).for_each(|byte| target(&[byte]));
    }
}

#[test]
fn every_corpus_has_a_target() {
    let folders =
        fs::read_dir(corpus()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let targets = TARGETS.iter().map(|(name, _)| (*name).to_owned());
    assert_eq!(folders.collect::<BTreeSet<_>>(), targets.collect::<BTreeSet<_>>());
}
