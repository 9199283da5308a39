//! No circle between the files of a crate.
//!
//! A file imports the file that a path of it leads to. The file of a folder (`mod.rs`, `lib.rs`, `main.rs`) declares,
//! wires and re-exports the files below it: what it takes from them is not counted, what they take from it is.

use crate::paths;
use crate::sources::{self, Source};
use std::collections::{BTreeMap, BTreeSet};

type Module = Vec<String>;

/// The files of a crate by their module, each with the modules that it imports.
pub(crate) type Graph = BTreeMap<Module, BTreeSet<Module>>;

/// The module that the file at `path` below `src` is.
fn module_of(path: &str) -> Module {
    let path = path.trim_end_matches(".rs").trim_end_matches("/mod");
    match path {
        "lib" | "main" => Vec::new(),
        path => path.split('/').map(str::to_owned).collect(),
    }
}

/// The imports between the files of a crate, given by their paths below `src`.
pub(crate) fn graph<'a>(files: impl Iterator<Item = (&'a str, &'a str)>) -> Graph {
    let files: Vec<(Module, &str)> = files.map(|(path, text)| (module_of(path), text)).collect();
    let modules: BTreeSet<Module> = files.iter().map(|(module, _)| module.clone()).collect();
    let file_of =
        |path: Vec<String>| (0..=path.len()).rev().map(|n| path[..n].to_vec()).find(|m| modules.contains(m));
    let mut graph = Graph::new();
    for (module, text) in &files {
        let imported = paths::named_in(text, module).into_iter().filter_map(file_of);
        let others = imported.filter(|other| !other.starts_with(module));
        graph.entry(module.clone()).or_default().extend(others);
    }
    graph
}

/// A circle, if there is one: each file imports the next, the last one the first.
fn circle(graph: &Graph) -> Option<Vec<Module>> {
    graph.keys().find_map(|start| {
        let mut seen = BTreeSet::new();
        way_back(graph, start, start, &mut seen, &mut vec![start.clone()])
    })
}

fn way_back(
    graph: &Graph,
    start: &Module,
    here: &Module,
    seen: &mut BTreeSet<Module>,
    way: &mut Vec<Module>,
) -> Option<Vec<Module>> {
    for next in &graph[here] {
        if next == start {
            return Some(way.clone());
        }
        if seen.insert(next.clone()) {
            way.push(next.clone());
            if let Some(circle) = way_back(graph, start, next, seen, way) {
                return Some(circle);
            }
            way.pop();
        }
    }
    None
}

/// The files below `src` of a crate's folder.
pub(crate) fn below_src<'a>(sources: &'a [Source], folder: &str) -> impl Iterator<Item = (&'a str, &'a str)> {
    let src = format!("{folder}/src/");
    let files = sources.iter().filter_map(move |source| Some((source.path.strip_prefix(&src)?, source)));
    // Executables are crates of their own.
    files.filter(|(path, _)| !path.starts_with("bin/")).map(|(path, source)| (path, source.text.as_str()))
}

#[test]
fn no_files_of_a_crate_import_each_other_in_a_circle() {
    let sources = sources::rust();
    let folders = sources.iter().filter_map(|source| source.path.split_once("/src/"));
    for folder in folders.map(|(folder, _)| folder).collect::<BTreeSet<_>>() {
        let circle = circle(&graph(below_src(&sources, folder)));
        assert_eq!(circle, None, "{folder}: each of these files imports the next one");
    }
}

#[test]
fn a_circle_of_three_files_is_found_and_a_folder_may_use_its_own_files() {
    let folder =
        [("lib.rs", "use crate::a::A;"), ("a/mod.rs", "use crate::a::b::B;"), ("a/b.rs", "use super::A;")];
    assert_eq!(circle(&graph(folder.into_iter())), None);
    let three = [
        ("a.rs", "use crate::b::B;"),
        ("b/mod.rs", "use crate::{c::C, d};"),
        ("c.rs", "fn f(_: super::a::A) {}"),
    ];
    assert_eq!(circle(&graph(three.into_iter())).map(|circle| circle.len()), Some(3));
}
