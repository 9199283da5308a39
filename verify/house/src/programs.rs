//! A test that runs a program which may be missing asks for it first, with `lacks`, and is skipped
//! with a note.

use crate::sources;

/// Programs that POSIX requires.
const EVERYWHERE: &[&str] = &["sh", "sleep", "mkfifo"];

/// The names in `Command::new("NAME")` of a file that may be missing, and that no `lacks` of the
/// file names.
fn unasked(text: &str) -> Vec<&str> {
    let started = text.split("Command::new(\"").skip(1).filter_map(|after| Some(after.split_once('"')?.0));
    let asked: Vec<&str> =
        text.split("lacks(&[").skip(1).filter_map(|after| Some(after.split_once(']')?.0)).collect();
    let is_asked = |name: &str| asked.iter().any(|names| names.contains(&format!("\"{name}\"")));
    started.filter(|name| !EVERYWHERE.contains(name) && !is_asked(name)).collect()
}

/// The code of a file that starts processes in `cargo test`. Tests on CAN interfaces are ignored
/// without a rig.
fn tests(source: &sources::Source) -> &str {
    let sources::Source { path, text } = source;
    if path.contains("vcan") || !text.contains("process::") {
        return "";
    }
    let is_test = path.contains("/tests/") || path.starts_with("verify/harness/");
    if is_test { text } else { text.split_once("\nmod tests {").map_or("", |(_, tests)| tests) }
}

#[test]
fn tests_ask_for_programs_before_use() {
    for source in sources::rust() {
        let unasked = unasked(tests(&source));
        assert!(unasked.is_empty(), "{}: skip the test where `lacks(&{unasked:?})`", source.path);
    }
}

#[test]
fn unasked_program_is_found() {
    let text = r#"lacks(&["unshare", "bash"]); Command::new("unshare"); Command::new("sh"); Command::new("jq"); Command::new(path)"#;
    assert_eq!(unasked(text), ["jq"]);
}
