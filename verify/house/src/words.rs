//! One word per thing: retired words are rejected. A doc comment begins with its subject.

use crate::sources::{self, Source};
use proc_macro2::{TokenStream, TokenTree};
use std::collections::BTreeSet;

/// Where a retired word is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Where {
    /// In names of code: the word is plain English in a sentence.
    Names,
    /// In names, comments, texts of the program and documents.
    Everywhere,
    /// As a phrase in sentences: each of its words is fine alone.
    Sentences,
}
use Where::{Everywhere, Names, Sentences};

/// The retired word, its successor, and where it is refused. A plural counts as its singular.
const RETIRED: &[(&str, &str, Where)] = &[
    ("roster", "robot description", Everywhere),
    ("errand", "service request", Everywhere),
    ("tether", "child guard", Everywhere),
    ("workshop", "reconnector", Everywhere),
    ("vocabulary", "codes", Everywhere),
    ("stray", "unexpected id, or unsupported frame", Everywhere),
    ("stranger", "unexpected id", Everywhere),
    ("executor", "stopper", Everywhere),
    ("ward", "supervised daemon", Everywhere),
    ("witness", "invariant checker", Everywhere),
    ("storm", "fault-injection run", Everywhere),
    // A place in shared memory or in a list is plain English.
    ("place on the grid", "tick", Sentences),
    ("places on the grid", "ticks", Sentences),
    ("skipped place", "missed tick", Sentences),
    // "The motor will stop": the verb is English.
    ("will", "safe frames", Names),
    // A duty cycle is another thing.
    ("duty", "stopper", Names),
    ("wish", "scheduling request", Names),
    // Plain English in a sentence.
    ("told", "commanded, or reported", Names),
    // The table `[exchange]` of a configuration is a promise to users.
    ("exchange", "ipc thread, or transaction", Names),
    // "Room for one more" is plain English.
    ("room", "reserved space", Names),
    // "A look at the log" is plain English.
    ("look", "read", Names),
    ("usual", "expected reply time", Names),
    // A home directory is another thing.
    ("home", "work directory", Names),
    ("rough", "client fuzz", Names),
    // Each of these is plain English in a sentence.
    ("asker", "requester", Names),
    ("askers", "requesters", Names),
    ("doubt", "the reason of the doubt", Names),
    ("hear", "receive", Names),
    ("hears", "receives", Names),
    ("heard", "received, or last_seen", Names),
    ("judge", "check, or classify", Names),
    ("judged", "checked", Names),
    ("news", "events, or messages", Names),
    ("nobody", "the process that is missing", Names),
    ("owed", "pending, or unserved", Names),
    ("owes", "the reply that is pending", Names),
    ("patience", "timeout", Names),
    ("place", "slot, index, directory, or location", Names),
    ("places", "slots, or indices", Names),
    ("said", "printed, or reported", Names),
    ("sought", "last_search", Names),
    ("suffer", "inject", Names),
    ("vain", "failures, or incomplete", Names),
];

/// Most words of a function's name.
const WORDS_MAX: usize = 8;

/// Names with a retired word: of other people's libraries, of public interfaces, and idioms of Rust
/// and Unix.
const KEPT: &[&str] = &[
    "compare_exchange",
    "Home",
    // Of clients, and of the telemetry in JSON.
    "is_heard",
    "NotHeard",
    "polled_in_vain",
    // An argument of a Python method.
    "places",
    // As in `core::ptr::drop_in_place`.
    "drop_in_place",
    "abandon_in_place",
    // The user 65534.
    "NOBODY",
];

/// A name with at least this many words counts as a sentence.
const SENTENCE_MIN: usize = 5;

/// The names in Rust code, also inside of macros.
pub(crate) fn identifiers(code: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    walk(code.parse().unwrap(), &mut |token| {
        if let TokenTree::Ident(name) = token {
            names.insert(name.to_string());
        }
    });
    names
}

fn walk(tokens: TokenStream, see: &mut impl FnMut(&TokenTree)) {
    for token in tokens {
        match &token {
            TokenTree::Group(group) => walk(group.stream(), see),
            token => see(token),
        }
    }
}

/// The words of a name, in lower case: `BusSlot` and `bus_slot` are both `bus` and `slot`.
pub(crate) fn parts(name: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut was_lower = false;
    for letter in name.chars() {
        if letter == '_' || letter.is_uppercase() && was_lower {
            parts.push(String::new());
        }
        was_lower = letter.is_lowercase() || letter.is_ascii_digit();
        if letter != '_' {
            parts.last_mut().unwrap().extend(letter.to_lowercase());
        }
    }
    parts
}

/// The sentences of a Rust file: its comments and strings. Of any other file: all of it.
fn sentences(source: &Source) -> String {
    if !source.path.ends_with(".rs") {
        return source.text.clone();
    }
    let comments = source.text.lines().filter_map(|line| Some(line.split_once("//")?.1));
    let mut text: String = comments.map(|comment| format!("{comment}\n")).collect();
    walk(source.text.parse().unwrap(), &mut |token| {
        if let TokenTree::Literal(literal) = token {
            text.push_str(&literal.to_string());
            text.push('\n');
        }
    });
    text
}

fn singular(word: &str) -> &str {
    word.strip_suffix('s').unwrap_or(word)
}

/// The retired words in a file.
fn retired(source: &Source) -> Vec<&'static str> {
    let is_rust = source.path.ends_with(".rs");
    let mut identifiers = if is_rust { identifiers(&source.text) } else { BTreeSet::new() };
    identifiers.retain(|name| !KEPT.contains(&name.as_str()));
    let (long, short): (Vec<_>, Vec<_>) =
        identifiers.iter().map(|name| parts(name)).partition(|parts| parts.len() >= SENTENCE_MIN);
    let names: BTreeSet<String> = short.into_iter().flatten().collect();
    let sentences = sentences(source).to_lowercase();
    let words = sentences.split(|letter: char| !letter.is_alphabetic());
    let spoken = words.chain(long.iter().flatten().map(String::as_str)).map(singular);
    let spoken: BTreeSet<&str> = spoken.chain(names.iter().map(|name| singular(name))).collect();
    let phrases = sentences.split_whitespace().collect::<Vec<_>>().join(" ");
    let is_used = |(word, _, scope): &&(&'static str, &str, Where)| match scope {
        Names => names.contains(*word),
        Everywhere => spoken.contains(word),
        Sentences => phrases.contains(word),
    };
    RETIRED.iter().filter(is_used).map(|(word, _, _)| *word).collect()
}

/// The files of the workspace, without this crate and CHANGELOG.md, which name retired words.
fn written() -> Vec<Source> {
    let mut files =
        sources::files(&[".rs", ".md", ".toml", ".service", ".ci/run", ".ci/full", ".ci/common.sh"]);
    files.extend(sources::files(&[""]).into_iter().filter(|file| file.path.starts_with("verify/rigs/")));
    files.retain(|file| !file.path.starts_with("verify/house/") && file.path != "CHANGELOG.md");
    files
}

#[test]
fn no_retired_word_returns() {
    for source in written() {
        let found = retired(&source);
        let then = RETIRED.iter().filter(|(word, ..)| found.contains(word)).map(|(_, then, _)| then);
        assert_eq!(found, [""; 0], "{}: write {:?}", source.path, then.collect::<Vec<_>>());
    }
}

#[test]
fn retired_word_is_found_only_where_refused() {
    let source = |path: &str, text: &str| Source { path: path.into(), text: text.into() };
    let found = |text: &str| retired(&source("bus/src/a.rs", text));
    assert_eq!(found("/// The will of\n/// a motor. What will it do?\nfn f() {}"), [""; 0]);
    assert_eq!(found("struct BusWill;"), ["will"]);
    assert_eq!(found("fn f() { assert!(a.will_of(b)); }"), ["will"]);
    assert_eq!(found("#[test] fn a_motor_will_stop_on_its_own() {}"), [""; 0]);
    assert_eq!(found("fn f() { a.compare_exchange(0, b, c, d); }"), [""; 0]);
    assert_eq!(found("struct BusExchange; // A document has `[exchange]`."), ["exchange"]);
    assert_eq!(found("const OLD: &str = \"exchange\";"), [""; 0]);
    assert_eq!(found("// Three strays.\nfn f() {}"), ["stray"]);
    assert_eq!(found("fn f() { println!(\"a Stranger\") }"), ["stranger"]);
    assert_eq!(found("// A place on\n// the grid.\n"), ["place on the grid"]);
    assert_eq!(found("// Towards the storage, rewards.\n"), [""; 0]);
    assert_eq!(retired(&source("docs/a.md", "Each roster.")), ["roster"]);
}

/// The names of functions with more than [`WORDS_MAX`] words.
fn too_long(code: TokenStream) -> Vec<String> {
    let mut found = Vec::new();
    let mut follows_fn = false;
    walk(code, &mut |token| {
        let name = token.to_string();
        if follows_fn && parts(&name).len() > WORDS_MAX {
            found.push(name.clone());
        }
        follows_fn = name == "fn";
    });
    found
}

#[test]
fn function_names_have_at_most_eight_words() {
    for source in sources::rust() {
        assert_eq!(too_long(source.text.parse().unwrap()), [""; 0], "{}", source.path);
    }
}

#[test]
fn a_name_of_nine_words_is_found() {
    let code = "fn a_b_c_d_e_f_g_h() {} m! { fn a_b_c_d_e_f_g_h_i() {} }";
    assert_eq!(too_long(code.parse().unwrap()), ["a_b_c_d_e_f_g_h_i"]);
}

/// The lines of a Rust file that begin a doc comment with "What".
fn vague(text: &str) -> Vec<usize> {
    let is_vague =
        |line: &str| ["/// What ", "//! What "].iter().any(|start| line.trim_start().starts_with(start));
    text.lines().enumerate().filter(|(_, line)| is_vague(line)).map(|(at, _)| at + 1).collect()
}

#[test]
fn no_doc_line_begins_with_what() {
    for source in sources::rust() {
        assert_eq!(vague(&source.text), [0_usize; 0], "{}: name the subject", source.path);
    }
}

#[test]
fn vague_doc_line_is_found() {
    let bad = concat!("/// The", " time.\n    /// What", " it does.\n//! What", " this is.\n// What now?\n");
    assert_eq!(vague(bad), [2, 3]);
}
