//! Every link of a document leads to a file or heading that exists: in the workspace, and in the
//! tree that the package installs.

use crate::sources;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The documents and files of the package are below this folder.
const INSTALLED: &str = "usr/share/doc/motord/";

/// Files by their path, with `/`. Documents have a text, which other files do not need.
type Tree = BTreeMap<String, Option<String>>;

/// The text outside of its blocks of code.
fn prose(document: &str) -> String {
    let mut inside = false;
    let lines = document.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        inside ^= is_fence;
        !inside && !is_fence
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The targets of the links and images of a document that are on this computer.
fn targets(document: &str) -> Vec<String> {
    let prose = prose(document);
    let inline =
        prose.split("](").skip(1).filter_map(|after| after.split_once(')')).map(|(target, _)| target);
    let is_below = |line: &&str| line.starts_with('[') && line.contains("]: ");
    let definitions =
        prose.lines().filter(is_below).filter_map(|line| line.split_once("]: ")).map(|(_, target)| target);
    let is_remote = |target: &str| target.contains("://") || target.starts_with("mailto:");
    inline.chain(definitions).map(str::trim).filter(|target| !is_remote(target)).map(str::to_owned).collect()
}

/// The anchors of a document's headings, as GitHub and GitLab form them.
fn anchors(document: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for line in prose(document).lines() {
        let title = line.trim_start_matches('#');
        if !line.starts_with('#') || !title.starts_with(' ') {
            continue;
        }
        let slug = slug(title.trim());
        let again = (1..).map(|number| format!("{slug}-{number}"));
        let free = std::iter::once(slug.clone()).chain(again).find(|anchor| !found.contains(anchor));
        found.extend(free);
    }
    found
}

fn slug(title: &str) -> String {
    let in_anchor = |letter: char| match letter {
        ' ' => Some('-'),
        '-' | '_' => Some(letter),
        _ => letter.is_alphanumeric().then_some(letter),
    };
    title.to_lowercase().chars().filter_map(in_anchor).collect()
}

/// The path of `target` in a document in `folder`, without `.` and `..`. `None` leaves the tree.
fn resolved(folder: &str, target: &str) -> Option<String> {
    let mut path: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in target.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(path.pop()?),
            part => path.push(part),
        }
    }
    Some(path.join("/"))
}

/// The links of the tree's documents that lead nowhere: document and target.
fn broken(tree: &Tree) -> Vec<String> {
    let documents = tree.iter().filter_map(|(path, text)| Some((path, text.as_ref()?)));
    let links =
        documents.flat_map(|(path, text)| targets(text).into_iter().map(move |target| (path, target)));
    links
        .filter(|(path, target)| !leads(tree, path, target))
        .map(|(path, target)| format!("{path}: {target}"))
        .collect()
}

/// Returns whether the link `target` of the document `path` leads to a file or folder of the tree,
/// and to one of its headings.
fn leads(tree: &Tree, path: &str, target: &str) -> bool {
    let (file, anchor) = target.split_once('#').map_or((target, None), |(file, anchor)| (file, Some(anchor)));
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
    let Some(file) = (if file.is_empty() { Some(path.to_owned()) } else { resolved(folder, file) }) else {
        return false;
    };
    match (tree.get(&file), anchor) {
        (Some(Some(text)), Some(anchor)) => anchors(text).contains(anchor),
        (Some(_), None) => true,
        (Some(None), Some(_)) => false,
        (None, _) => tree
            .range(format!("{file}/")..)
            .next()
            .is_some_and(|(path, _)| path.starts_with(&format!("{file}/"))),
    }
}

/// The tree of the files below `root`.
fn tree_of(root: &Path) -> Tree {
    let relative = |path: PathBuf| {
        let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
        let text = name.ends_with(".md").then(|| std::fs::read_to_string(&path).unwrap());
        (name, text)
    };
    sources::below(root).into_iter().map(relative).collect()
}

/// The tree that the package installs from files of the workspace, from the assets in
/// daemon/Cargo.toml. What `packaging/build` creates is not in it.
fn installed(workspace: &Tree) -> Tree {
    let manifest = std::fs::read_to_string(sources::root().join("daemon/Cargo.toml")).unwrap();
    let manifest: toml::Table = manifest.parse().unwrap();
    let mut tree = Tree::new();
    for asset in manifest["package"]["metadata"]["deb"]["assets"].as_array().unwrap() {
        let [from, to] = [0, 1].map(|end| asset[end].as_str().unwrap());
        let Some(from) = from.strip_prefix("../") else { continue };
        let (start, end) = from.split_once('*').unwrap_or((from, ""));
        for (path, text) in workspace.iter().filter(|(path, _)| is_of_pattern(path, from, start, end)) {
            let name = path.rsplit('/').next().unwrap();
            let destination = if to.ends_with('/') { format!("{to}{name}") } else { to.to_owned() };
            tree.insert(destination, text.clone());
        }
    }
    tree
}

/// Returns whether `path` is `pattern`, or begins and ends as it does, in the same folder.
fn is_of_pattern(path: &str, pattern: &str, start: &str, end: &str) -> bool {
    let is_between = || {
        let middle = path.strip_prefix(start)?.strip_suffix(end)?;
        Some(!middle.contains('/'))
    };
    path == pattern || pattern.contains('*') && is_between() == Some(true)
}

#[test]
fn links_of_documents_lead_somewhere() {
    let broken = broken(&tree_of(&sources::root()));
    assert!(broken.is_empty(), "{} links lead nowhere:\n{}", broken.len(), broken.join("\n"));
}

#[test]
fn links_lead_somewhere_without_source_tree() {
    let tree = installed(&tree_of(&sources::root()));
    assert!(tree.contains_key(&format!("{INSTALLED}README.md")), "{:?}", tree.keys());
    let broken = broken(&tree);
    assert!(
        broken.is_empty(),
        "{} links of the installed documents lead nowhere. Write a path of the source tree in code marks, without a link, or add \
         the file to the assets in daemon/Cargo.toml:\n{}",
        broken.len(),
        broken.join("\n")
    );
}

#[test]
#[ignore = "needs an unpacked package: packaging/check runs it with MOTORD_INSTALLED"]
fn links_of_unpacked_package_lead_somewhere() {
    let root =
        std::env::var_os("MOTORD_INSTALLED").expect("MOTORD_INSTALLED is the folder of the unpacked package");
    let tree = tree_of(Path::new(&root));
    let links: usize = tree.values().flatten().map(|text| targets(text).len()).sum();
    assert!(links > 0, "there are no documents below {}", Path::new(&root).display());
    let broken = broken(&tree);
    println!("{} of {links} links of the installed documents lead nowhere", broken.len());
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn links_and_anchors_are_resolved_like_paths() {
    let page = "# A `b` (c)\n## Twice\n## Twice\n[x](../README.md#two-words) [y](#a-b-c) ![z](p.svg) [w](https://a.b/c)\n\
        ```\n[code](nowhere)\n# no-heading\n```\n[f](../docs) [t](#twice-1)\n";
    let tree = |page: &str| {
        let documents =
            [("README.md", Some("# Two words\n".to_owned())), ("docs/page.md", Some(page.to_owned()))];
        documents
            .into_iter()
            .chain([("docs/p.svg", None)])
            .map(|(path, text)| (path.to_owned(), text))
            .collect()
    };
    assert_eq!(broken(&tree(page)), [""; 0]);
    let bad = "[a](nowhere.md) [b](#no-heading) [c](../README.md#three) [d](../../out.md) [e](p.svg#x)\n[g]: gone.md\n";
    let missing = ["nowhere.md", "#no-heading", "../README.md#three", "../../out.md", "p.svg#x", "gone.md"];
    assert_eq!(broken(&tree(bad)), missing.map(|target| format!("docs/page.md: {target}")));
}
