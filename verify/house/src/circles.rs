//! No circle between the files of a crate, nor between its folders.
//!
//! A file imports the file that defines the item of each path it uses: the test follows re-exports.
//! The file of a folder (`mod.rs`, `lib.rs`, `main.rs`) counts like any other; its own re-exports
//! do not. A folder imports what its files import from beside the folder.

use crate::paths;
use crate::sources::{self, Source};
use std::collections::{BTreeMap, BTreeSet};

/// A module by its path in the crate; empty for the root.
pub(crate) type Module = Vec<String>;

/// The files of a crate by their module, each with the modules that it imports.
pub(crate) type Graph = BTreeMap<Module, BTreeSet<Module>>;

/// The longest chain of re-exports that is followed.
const REEXPORTS_MAX: usize = 8;

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
    let children = |module: &Module| -> BTreeSet<String> {
        let below =
            modules.iter().filter(|other| other.len() == module.len() + 1 && other.starts_with(module));
        below.filter_map(|child| child.last().cloned()).collect()
    };
    let found: Vec<_> = files
        .iter()
        .map(|(module, text)| (module, paths::named_in(text, module, &children(module))))
        .collect();
    let bindings: BTreeMap<&Module, _> =
        found.iter().map(|(module, found)| (*module, &found.bindings)).collect();
    let mut graph = Graph::new();
    for (module, found) in &found {
        let imported = found.paths.iter().filter_map(|path| defining(path, &modules, &bindings));
        let others = imported.filter(|other| other != *module);
        graph.entry((*module).clone()).or_default().extend(others);
    }
    graph
}

/// The module that defines what `path` leads to; `None` for an item of another crate.
fn defining(
    path: &[String],
    modules: &BTreeSet<Module>,
    bindings: &BTreeMap<&Module, &BTreeMap<String, Option<Vec<String>>>>,
) -> Option<Module> {
    let mut path = path.to_vec();
    for _ in 0..REEXPORTS_MAX {
        let module = (0..=path.len()).rev().map(|n| path[..n].to_vec()).find(|m| modules.contains(m))?;
        let binding = path.get(module.len()).and_then(|name| bindings[&module].get(name));
        match binding {
            None => return Some(module),
            Some(None) => return None,
            Some(Some(target)) if *target == path => return Some(module),
            Some(Some(target)) => path.clone_from(target),
        }
    }
    None
}

/// The files that import themselves by way of others, with the imports that lead back.
fn circles(graph: &Graph) -> Vec<(&Module, Vec<&Module>)> {
    let leads_back = |module: &Module, next: &&Module| reached(graph, next).contains(module);
    let back = |module| graph[module].iter().filter(|next| leads_back(module, next)).collect::<Vec<_>>();
    graph.keys().map(|module| (module, back(module))).filter(|(_, back)| !back.is_empty()).collect()
}

/// The modules that `start` imports, directly or by way of others, and `start`.
fn reached<'a>(graph: &'a Graph, start: &'a Module) -> BTreeSet<&'a Module> {
    let mut reached = BTreeSet::from([start]);
    let mut open = vec![start];
    while let Some(module) = open.pop() {
        open.extend(graph[module].iter().filter(|next| reached.insert(next)));
    }
    reached
}

/// The imports between the members of each folder: a member that is a folder imports what its files
/// do.
fn folders(graph: &Graph) -> Graph {
    let mut folders = Graph::new();
    for (module, import) in
        graph.iter().flat_map(|(module, imports)| imports.iter().map(move |i| (module, i)))
    {
        let common = module.iter().zip(import).take_while(|(a, b)| a == b).count();
        if let (Some(from), Some(to)) = (module.get(..=common), import.get(..=common)) {
            folders.entry(to.to_vec()).or_default();
            folders.entry(from.to_vec()).or_default().insert(to.to_vec());
        }
    }
    folders
}

/// The graph of the imports of each crate, by its folder.
fn crates() -> BTreeMap<String, Graph> {
    let sources = sources::rust();
    let crates: BTreeSet<&str> =
        sources.iter().filter_map(|source| Some(source.path.split_once("/src/")?.0)).collect();
    let of_crate = |folder: &&str| {
        // Unit tests import what they test.
        let files = below_src(&sources, folder).filter(|(path, _)| !path.ends_with("tests.rs"));
        ((*folder).to_owned(), graph(files))
    };
    crates.iter().map(of_crate).collect()
}

/// Prints the circles of a crate, and returns their members.
fn members(folder: &str, graph: &Graph) -> BTreeSet<String> {
    let circles = circles(graph);
    for (module, back) in &circles {
        println!("{folder}: {module:?} -> {back:?}");
    }
    circles.into_iter().map(|(module, _)| module.join("::")).collect()
}

/// The files below `src` of a crate's folder.
pub(crate) fn below_src<'a>(sources: &'a [Source], folder: &str) -> impl Iterator<Item = (&'a str, &'a str)> {
    let src = format!("{folder}/src/");
    let files = sources.iter().filter_map(move |source| Some((source.path.strip_prefix(&src)?, source)));
    // Each executable is a separate crate.
    files.filter(|(path, _)| !path.starts_with("bin/")).map(|(path, source)| (path, source.text.as_str()))
}

#[test]
fn files_of_a_crate_import_without_circles() {
    for (folder, graph) in crates() {
        assert_eq!(members(&folder, &graph), BTreeSet::new(), "{folder}");
    }
}

#[test]
fn folders_of_a_crate_import_without_circles() {
    for (folder, graph) in crates() {
        assert_eq!(members(&folder, &folders(&graph)), BTreeSet::new(), "{folder}");
    }
}

#[test]
fn circles_are_found_but_own_files_allowed() {
    let graph_of = |files: &[(&'static str, &'static str)]| graph(files.iter().copied());
    let folder = [
        ("lib.rs", "mod a; pub use a::A; fn f() -> a::A { a::b::B }"),
        ("a/mod.rs", "mod b; use b::B; struct A;"),
        ("a/b.rs", "use std::a::time; struct B;"),
    ];
    assert_eq!(circles(&graph_of(&folder)), []);
    let three = [
        ("a.rs", "use crate::b::B;"),
        ("b/mod.rs", "use crate::{c::C, d};"),
        ("c.rs", "fn f(_: super::a::A) {}"),
    ];
    assert_eq!(circles(&graph_of(&three)).len(), 3);
    let reexported =
        [("lib.rs", "mod a; mod b; pub use a::A; pub use b::B;"), ("a.rs", "use crate::B;"), ("b.rs", "")];
    assert_eq!(circles(&graph_of(&reexported)), []);
    let parent = [("lib.rs", "mod a; fn f() { a::g() } fn h() {}"), ("a.rs", "fn g() { crate::h() }")];
    assert_eq!(circles(&graph_of(&parent)).len(), 2);
}

#[test]
fn circle_between_folders_is_found() {
    let crossed = [
        ("a/b.rs", "use crate::c::d::D;"),
        ("a/e.rs", "struct E;"),
        ("c/d.rs", "struct D;"),
        ("c/f.rs", "use crate::a::e::E;"),
    ];
    let graph = graph(crossed.into_iter());
    assert_eq!(circles(&graph), []);
    assert_eq!(circles(&folders(&graph)).len(), 2);
}
