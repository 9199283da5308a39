//! Runs every input of the corpus, on the stable toolchain and without a fuzzer, so that earlier
//! findings stay fixed. With `MOTORD_PACK_CORPUS=FOLDER` it first writes the archives:
//! docs/fuzzing.md.

use motord_fuzz::TARGETS;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::{env, fs};

/// The inputs of one target, by name.
type Inputs = BTreeMap<String, Vec<u8>>;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn archive(target: &str) -> PathBuf {
    corpus().join(target).with_extension("txt")
}

/// Returns an archive: a line for each input, of its name, a tab, and its bytes. A backslash, and
/// bytes that ASCII cannot print, are escaped as in Rust.
fn render(inputs: &Inputs) -> String {
    let text = |bytes: &[u8]| bytes.escape_ascii().to_string().replace(r#"\""#, r#"""#).replace(r"\'", "'");
    inputs.iter().map(|(name, bytes)| format!("{name}\t{}\n", text(bytes))).collect()
}

/// Reads an archive. Panics where it is not one.
fn parse(archive: &str) -> Inputs {
    let line = |line: &str| {
        let (name, text) = line.split_once('\t').expect("a name and a tab");
        (name.to_owned(), unescape(text).unwrap_or_else(|| panic!("{name}: an unfinished escape")))
    };
    archive.lines().map(line).collect()
}

fn unescape(text: &str) -> Option<Vec<u8>> {
    let mut rest = text.bytes();
    let mut bytes = Vec::new();
    while let Some(byte) = rest.next() {
        let escaped = if byte == b'\\' { rest.next()? } else { 0 };
        bytes.push(match escaped {
            0 => byte,
            b'n' => b'\n',
            b'r' => b'\r',
            b't' => b'\t',
            b'x' => {
                let digits = [rest.next()?, rest.next()?];
                u8::from_str_radix(str::from_utf8(&digits).ok()?, 16).ok()?
            }
            b'\\' => b'\\',
            _ => return None,
        });
    }
    Some(bytes)
}

/// Returns whether an input always stays: a finding, or one that a person named. libFuzzer names
/// the others by the 40 digits of their hash.
fn is_kept(name: &str) -> bool {
    name.len() != 40
}

/// Writes the archive of each target that has a folder in `packed`: the inputs of this folder, and
/// those of the archive that always stay.
fn pack(packed: &Path) {
    for (target, _) in TARGETS {
        let Ok(folder) = fs::read_dir(packed.join(target)) else { continue };
        let mut inputs = parse(&fs::read_to_string(archive(target)).unwrap_or_default());
        inputs.retain(|name, _| is_kept(name));
        inputs.extend(folder.map(Result::unwrap).map(|file| {
            let name = file.file_name().into_string().expect("a name without odd bytes");
            (name, fs::read(file.path()).expect("a file that can be read"))
        }));
        let kept = inputs.iter().filter(|(name, _)| is_kept(name));
        let kept: BTreeSet<_> = kept.map(|(_, bytes)| bytes.clone()).collect();
        inputs.retain(|name, bytes| is_kept(name) || !kept.contains(bytes));
        fs::write(archive(target), render(&inputs)).expect("the corpus can be written");
    }
}

#[test]
fn corpus_inputs_keep_promises_of_their_target() {
    if let Some(folder) = env::var_os("MOTORD_PACK_CORPUS") {
        pack(Path::new(&folder));
    }
    for (name, target) in TARGETS {
        let text = fs::read_to_string(archive(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let inputs = parse(&text);
        assert_eq!(render(&inputs), text, "{name}: not as `MOTORD_PACK_CORPUS` writes it");
        assert!(!inputs.is_empty(), "{name} has a corpus");
        for (input, bytes) in &inputs {
            std::panic::catch_unwind(|| target(bytes)).unwrap_or_else(|_| panic!("{name}: {input}"));
        }
        println!("{name}: {} inputs", inputs.len());
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
fn every_archive_has_a_target() {
    let names =
        fs::read_dir(corpus()).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let targets = TARGETS.iter().map(|(name, _)| format!("{name}.txt"));
    assert_eq!(names.collect::<BTreeSet<_>>(), targets.collect::<BTreeSet<_>>());
}

#[test]
fn archive_keeps_any_bytes() {
    let inputs = Inputs::from([
        ("bytes".to_owned(), (0..=u8::MAX).collect()),
        ("empty".to_owned(), Vec::new()),
        ("spaces".to_owned(), b" \t\\x41\\\"'\\n\" ".to_vec()),
    ]);
    assert_eq!(parse(&render(&inputs)), inputs);
}
