//! Documents name only tests, functions and files that exist.

use crate::sources::{self, Source};
use proc_macro2::{TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};

/// A name in code marks with at least this many words is the name of a function.
const FUNCTION_MIN: usize = 4;

/// A name with one of these endings is a file's.
const ENDINGS: &[&str] = &[".rs", ".sh", ".toml", ".service", ".md", ".csv", ".conf", ".rules", ".network"];

/// Prefixes of names that belong to other programs.
const ELSEWHERE: &[&str] = &[
    // Linux.
    "can_ethtool_op_get_ts_info_hwts",
    "drivers/net/can/dev/dev.c",
    // Other people's programs, docs/motors.md.
    "damiao.rs",
    "parse_motor_state_data",
    "protocol.rs",
    // Files and metadata of trainings, docs/python.md.
    "observation_terms_",
    "params/",
    // A person's own program, docs/stacks.md.
    "sway/",
    // Files of a robot.
    "motord.lock.toml",
    "motord.setup.toml",
    "motord.toml",
    "robot.toml",
    "arm.toml",
    // Files that a build makes.
    "target/debian",
    // Metrics and quantities, docs/latency.md.
    "motord_",
    "node_textfile_mtime_seconds",
    "reply_latency/",
    // Benchmarks, benches/README.md.
    "cycle/host/",
];

/// The checks of a transport: a macro makes a test of each, for each transport.
const CONFORMANCE: &str = "motors/bus/src/conformance.rs";

/// Stands for any name in a path, docs/extending.md.
const PLACEHOLDER: &str = "VENDOR";

/// Names of functions, and whether each has the attribute `#[test]`.
type Functions = BTreeMap<String, bool>;

/// The functions in Rust code, also inside of macros.
fn functions(code: TokenStream, names: &mut Functions) {
    let (mut follows_fn, mut is_test) = (false, false);
    for token in code {
        if let TokenTree::Ident(name) = &token
            && follows_fn
        {
            *names.entry(name.to_string()).or_default() |= std::mem::take(&mut is_test);
        }
        let word = token.to_string();
        (follows_fn, is_test) = (word == "fn", is_test || word == "[test]");
        if let TokenTree::Group(group) = token {
            functions(group.stream(), names);
        }
    }
}

/// The texts in code marks of a document, without its blocks of code.
fn marked(document: &str) -> impl Iterator<Item = &str> {
    let prose = document.split("```").step_by(2);
    prose.flat_map(|prose| prose.split('`').skip(1).step_by(2))
}

/// The words of a document that are Rust files, with or without code marks.
fn rust_files(document: &str) -> impl Iterator<Item = &str> {
    document.split(|letter: char| !is_of_path(letter)).filter(|word| word.ends_with(".rs"))
}

fn is_of_path(letter: char) -> bool {
    letter.is_ascii_alphanumeric() || "/._-".contains(letter)
}

fn is_function(name: &str) -> bool {
    let is_plain = |letter: char| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_';
    name.chars().all(is_plain) && name.split('_').filter(|word| !word.is_empty()).count() >= FUNCTION_MIN
}

/// The functions of a Python file, by the lines that begin them.
fn python_functions(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter_map(|line| Some(line.strip_prefix("def ")?.split_once('(')?.0))
}

/// Returns whether `name` is a path of the workspace. Absolute paths are of the machine.
fn is_path(name: &str) -> bool {
    let has_form = name.contains('/') || ENDINGS.iter().any(|ending| name.ends_with(ending));
    has_form && !name.starts_with('/') && name.chars().all(is_of_path)
}

/// The functions of a document that have a Rust file beside them: "`function` (file.rs)".
fn placed(document: &str) -> impl Iterator<Item = (&str, &str)> {
    document.split('`').zip(document.split('`').skip(1)).filter_map(|(name, after)| {
        let (file, _) = after.strip_prefix(" (")?.split_once(')')?;
        (is_function(name) && file.ends_with(".rs")).then_some((name, file))
    })
}

/// The functions and files that a document may name.
struct House {
    /// Every function, with the files that have one of this name.
    functions: BTreeMap<String, BTreeSet<String>>,
    /// The functions that are tests.
    tests: BTreeSet<String>,
    /// Every file, relative to the workspace.
    files: BTreeSet<String>,
}

impl House {
    fn new(sources: &[Source]) -> Self {
        let (mut functions, mut tests) = (BTreeMap::<_, BTreeSet<_>>::new(), BTreeSet::new());
        for rust in sources.iter().filter(|source| source.path.ends_with(".rs")) {
            let mut names = Functions::new();
            self::functions(rust.text.parse().unwrap(), &mut names);
            for (name, is_test) in names {
                tests.extend((is_test || rust.path == CONFORMANCE).then(|| name.clone()));
                functions.entry(name).or_default().insert(rust.path.clone());
            }
        }
        for python in sources.iter().filter(|source| source.path.ends_with(".py")) {
            for name in python_functions(&python.text) {
                tests.extend(name.starts_with("test_").then(|| name.to_owned()));
                functions.entry(name.to_owned()).or_default().insert(python.path.clone());
            }
        }
        Self { functions, tests, files: sources.iter().map(|source| source.path.clone()).collect() }
    }

    /// Returns whether `path` exists, from the workspace, from `folder`, or as the end of a path.
    fn has(&self, path: &str, folder: &str) -> bool {
        let path = path.trim_end_matches('/').trim_start_matches("../");
        let is_at =
            |at: &str| self.files.iter().any(|file| file == at || file.starts_with(&format!("{at}/")));
        is_at(path)
            || is_at(&format!("{folder}/{path}"))
            || self.files.iter().any(|file| file.ends_with(&format!("/{path}")))
    }

    /// The names in a document that do not exist.
    fn missing(&self, document: &Source) -> Vec<String> {
        let folder = document.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let names: BTreeSet<&str> = marked(&document.text).chain(rust_files(&document.text)).collect();
        let is_missing = |name: &&str| {
            is_function(name) && !self.functions.contains_key(*name)
                || is_path(name) && !self.has(name, folder)
        };
        let is_ours = |name: &&str| {
            !name.contains(PLACEHOLDER) && !ELSEWHERE.iter().any(|start| name.starts_with(start))
        };
        names.into_iter().filter(is_ours).filter(is_missing).map(str::to_owned).collect()
    }

    /// The functions in a document that are no tests.
    fn without_test<'a>(&self, document: &'a str) -> Vec<&'a str> {
        marked(document).filter(|name| is_function(name) && !self.tests.contains(*name)).collect()
    }

    /// The functions in a document that stand in another file than the one beside them.
    fn misplaced<'a>(&self, document: &'a str) -> Vec<(&'a str, &'a str)> {
        let is_in = |name: &str, file: &str| {
            let mut files = self.functions.get(name).into_iter().flatten();
            files.any(|path| path == file || path.ends_with(&format!("/{file}")))
        };
        placed(document).filter(|(name, file)| !is_in(name, file)).collect()
    }
}

/// CHANGELOG.md is exempt: it names removed things.
#[test]
fn documented_tests_and_files_exist() {
    let sources = sources::files(&[""]);
    let house = House::new(&sources);
    for document in &sources {
        if document.path.ends_with(".md") && document.path != "CHANGELOG.md" {
            assert_eq!(house.missing(document), [""; 0], "{} names what is not there", document.path);
            assert_eq!(house.misplaced(&document.text), [], "{}: in another file", document.path);
        }
        if document.path == "docs/faults.md" {
            assert_eq!(house.without_test(&document.text), [""; 0], "a fault is proved by a test");
        }
    }
}

#[test]
fn missing_tests_and_files_are_found() {
    let source = |path: &str, text: &str| Source { path: path.into(), text: text.into() };
    let rust = "m! { #[test] fn a_lost_motor_is_stopped() {} fn a_helper_of_the_tests() {} }";
    let house = House::new(&[source("bus/src/limit.rs", rust), source("verify/rigs/common.sh", "")]);
    let missing = |text: &str| house.missing(&source("verify/rigs/README.md", text));
    assert_eq!(
        house.without_test("`a_lost_motor_is_stopped`, `a_helper_of_the_tests`"),
        ["a_helper_of_the_tests"]
    );
    let good = "`a_lost_motor_is_stopped` (limit.rs) in `bus/src/limit.rs`, `bus/`, `common.sh`, `/dev/null`";
    assert_eq!(missing(good), [""; 0]);
    let bad = "`a_lost_motor_is_damped` (bounds.rs); `bus/limit.rs`, `guest.sh`, `core/src`, see mit.rs";
    let seen = ["a_lost_motor_is_damped", "bounds.rs", "bus/limit.rs", "core/src", "guest.sh", "mit.rs"];
    assert_eq!(missing(bad), seen);
    assert_eq!(house.misplaced(good), []);
    let elsewhere = "`a_lost_motor_is_stopped` (bus.rs)";
    assert_eq!(house.misplaced(elsewhere), [("a_lost_motor_is_stopped", "bus.rs")]);
    assert_eq!(missing("`a_name`\n```\n`a_name_of_four_words`\n```\n"), [""; 0]);
}
