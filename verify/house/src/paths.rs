//! The paths in a Rust file that begin with `crate`, `super`, `self` or a child module, in `use`,
//! in code and inside of macros.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};

/// The paths and bindings of a file, outside of its unit tests. Paths are absolute, without
/// `crate`.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Found {
    /// The paths that the file uses; its re-exports are not among them.
    pub(crate) paths: BTreeSet<Vec<String>>,
    /// The names that `use` binds, each with its path; `None` for an item of another crate.
    pub(crate) bindings: BTreeMap<String, Option<Vec<String>>>,
}

/// The module of a file, and the modules of the files below it.
struct Scope<'a> {
    module: &'a [String],
    children: &'a BTreeSet<String>,
}

/// Reads the file of `module`.
pub(crate) fn named_in(text: &str, module: &[String], children: &BTreeSet<String>) -> Found {
    let mut found = Found::default();
    let scope = Scope { module, children };
    scan(text.parse().unwrap(), &scope, &mut found);
    found
}

fn scan(tokens: TokenStream, scope: &Scope, found: &mut Found) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let mut at = 0;
    while at < tokens.len() {
        if let Some(length) = unit_tests(&tokens[at..]) {
            at += length;
        } else if let Some(length) = import(&tokens, at, scope, found) {
            at += length;
        } else if let Some(prefix) = start(&tokens, at, scope) {
            at += 1;
            let mut names = Vec::new();
            follow(&tokens, &mut at, prefix, &mut names);
            found.paths.extend(names.into_iter().map(|(_, path)| path));
        } else {
            if let TokenTree::Group(group) = &tokens[at] {
                scan(group.stream(), scope, found);
            }
            at += 1;
        }
    }
}

/// The number of tokens of `#[cfg(test)] mod tests { … }` or `#[cfg(test)] mod tests;`, if it
/// begins here.
fn unit_tests(tokens: &[TokenTree]) -> Option<usize> {
    let texts: Vec<String> = tokens.iter().take(3).map(ToString::to_string).collect();
    let is_test = matches!(&texts[..], [hash, cfg, module]
        if hash == "#" && cfg.replace(' ', "") == "[cfg(test)]" && module == "mod");
    is_test.then_some(5)
}

/// The number of tokens of a `use` item, if one begins here. Binds its names; a private item also
/// uses them.
fn import(tokens: &[TokenTree], at: usize, scope: &Scope, found: &mut Found) -> Option<usize> {
    if text(tokens.get(at)) != "use" {
        return None;
    }
    let length = tokens[at..].iter().position(|token| token.to_string() == ";")?;
    let item = &tokens[at + 1..at + length];
    let is_public = at > 0 && (text(tokens.get(at - 1)) == "pub" || is_restriction(tokens, at - 1));
    let mut names = Vec::new();
    let prefix = start(item, 0, scope);
    let is_ours = prefix.is_some();
    let first = prefix.unwrap_or_else(|| vec![text(item.first())]);
    follow(item, &mut 1, first, &mut names);
    for (name, path) in names {
        if is_ours && !is_public {
            found.paths.insert(path.clone());
        }
        found.bindings.insert(name, is_ours.then_some(path));
    }
    Some(length + 1)
}

/// Returns whether the token at `at` is the `(crate)` of `pub(crate)`.
fn is_restriction(tokens: &[TokenTree], at: usize) -> bool {
    matches!(&tokens[at], TokenTree::Group(_)) && at > 0 && text(tokens.get(at - 1)) == "pub"
}

fn text(token: Option<&TokenTree>) -> String {
    token.map(ToString::to_string).unwrap_or_default()
}

/// The module that a path begins at, if one of the crate begins at this token.
fn start(tokens: &[TokenTree], at: usize, scope: &Scope) -> Option<Vec<String>> {
    let TokenTree::Ident(first) = &tokens[at] else { return None };
    let is_inside = at > 0 && is_colon(tokens.get(at - 1)) && at > 1 && is_colon(tokens.get(at - 2));
    if is_inside || !(is_colon(tokens.get(at + 1)) && is_colon(tokens.get(at + 2))) {
        return None;
    }
    match first.to_string().as_str() {
        "crate" => Some(Vec::new()),
        "self" => Some(scope.module.to_vec()),
        "super" => Some(scope.module[..scope.module.len().saturating_sub(1)].to_vec()),
        child if scope.children.contains(child) => Some([scope.module, &[child.to_owned()]].concat()),
        _ => None,
    }
}

/// Follows `::name`, `::{…}`, `::*` and `as name` after the prefix. Adds each path with the name
/// that it binds.
fn follow(
    tokens: &[TokenTree],
    at: &mut usize,
    mut prefix: Vec<String>,
    found: &mut Vec<(String, Vec<String>)>,
) {
    while is_colon(tokens.get(*at)) && is_colon(tokens.get(*at + 1)) {
        match tokens.get(*at + 2) {
            Some(TokenTree::Ident(name)) if name == "super" => drop(prefix.pop()),
            Some(TokenTree::Ident(name)) => prefix.push(name.to_string()),
            Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                branches(group.stream(), &prefix, found);
                *at += 3;
                return;
            }
            _ => break,
        }
        *at += 3;
    }
    let is_renamed = text(tokens.get(*at)) == "as";
    let name =
        if is_renamed { text(tokens.get(*at + 1)) } else { prefix.last().cloned().unwrap_or_default() };
    found.push((name, prefix));
}

/// Each branch of a `use` tree's `{…}`.
fn branches(tokens: TokenStream, prefix: &[String], found: &mut Vec<(String, Vec<String>)>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    for branch in tokens.split(|token| token.to_string() == ",") {
        if let [TokenTree::Ident(first), ..] = branch {
            let mut path = prefix.to_vec();
            if first != "self" {
                path.push(first.to_string());
            }
            follow(branch, &mut 1, path, found);
        }
    }
}

fn is_colon(token: Option<&TokenTree>) -> bool {
    token.is_some_and(|token| token.to_string() == ":")
}

#[test]
fn paths_are_found_in_uses_code_and_macros() {
    let text = "use crate::{a::{B, self}, c::D}; use super::e; fn f() { assert!(crate::g::h(1)); z::k(); std::z::l() }
        #[cfg(test)] mod tests { use crate::never; } pub(crate) use self::z::Z as Y; use std::io;";
    let path = |path: &str| -> Vec<String> { path.split("::").map(str::to_owned).collect() };
    let found = named_in(text, &path("x::y"), &BTreeSet::from(["z".to_owned()]));
    assert_eq!(found.paths, ["a::B", "a", "c::D", "x::e", "g::h", "x::y::z::k"].map(path).into());
    assert_eq!(found.bindings["Y"], Some(path("x::y::z::Z")));
    assert_eq!(found.bindings["io"], None);
}
