//! `unsafe` stands only in the listed files.

use crate::sources;
use proc_macro2::{TokenStream, TokenTree};

/// System calls that no safe crate offers, pointers of callers in C, and the allocators and
/// counters of tests.
const UNSAFE: &[&str] = &[
    "benches/tests/allocations.rs",
    "client/c/src/abi/claim.rs",
    "client/c/src/abi/client.rs",
    "client/c/src/abi/publisher.rs",
    "client/c/src/abi/state.rs",
    "client/c/src/handle.rs",
    "client/c/src/table.rs",
    "client/c/tests/misuse.rs",
    "client/tests/daemon/forks.rs",
    "daemon/deadman/src/kernel.rs",
    "daemon/realtime/src/kernel.rs",
    "motors/bus/src/kernel.rs",
    "motors/bus/tests/socketcan/counting.rs",
    "shared/ports/src/fork_gate.rs",
    "shared/ports/src/iceoryx.rs",
    "shared/ports/src/mapping.rs",
];

/// Returns whether the code has the keyword. Comments, strings and names of lints do not count.
fn is_unsafe(code: TokenStream) -> bool {
    code.into_iter().any(|token| match token {
        TokenTree::Ident(name) => name == "unsafe",
        TokenTree::Group(group) => is_unsafe(group.stream()),
        _ => false,
    })
}

#[test]
fn unsafe_code_stands_in_listed_files_only() {
    let mut found = Vec::new();
    for source in sources::rust() {
        if is_unsafe(source.text.parse().unwrap()) {
            found.push(source.path);
        }
    }
    assert_eq!(found, UNSAFE);
}

/// Goal: the table of the document names each of the files, and no other.
#[test]
fn unsafe_files_are_in_table_of_document() {
    let documents = sources::files(&["docs/security.md"]);
    let (_, part) = documents[0].text.split_once("## Unsafe code").unwrap();
    let part = part.split("\n## ").next().unwrap();
    let rows = part.lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next());
    let mut named: Vec<&str> = rows.collect();
    named.sort_unstable();
    named.dedup();
    assert_eq!(named, UNSAFE);
}

#[test]
fn unsafe_is_found_in_code_not_words() {
    for code in
        ["fn f() { unsafe { g() } }", "pub unsafe fn f() {}", "m!(unsafe{x})", "unsafe impl A for B {}"]
    {
        assert!(is_unsafe(code.parse().unwrap()), "{code}");
    }
    let words = "#![forbid(unsafe_code)] /// unsafe { }\n const A: &str = \"unsafe fn\";";
    assert!(!is_unsafe(words.parse().unwrap()));
}
