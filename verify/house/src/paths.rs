//! The paths in a Rust file that begin with `crate` or `super`, in `use`, in code and inside of macros.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::BTreeSet;

/// The absolute paths, without `crate`, that the file of `module` names outside of its unit tests.
pub(crate) fn named_in(text: &str, module: &[String]) -> BTreeSet<Vec<String>> {
    let mut paths = BTreeSet::new();
    scan(text.parse().unwrap(), module, &mut paths);
    paths
}

fn scan(tokens: TokenStream, module: &[String], paths: &mut BTreeSet<Vec<String>>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let mut at = 0;
    while at < tokens.len() {
        if let Some(length) = unit_tests(&tokens[at..]) {
            at += length;
            continue;
        }
        if let Some(prefix) = start(&tokens[at..], module) {
            at += 1;
            follow(&tokens, &mut at, prefix, module, paths);
            continue;
        }
        if let TokenTree::Group(group) = &tokens[at] {
            scan(group.stream(), module, paths);
        }
        at += 1;
    }
}

/// How many tokens `#[cfg(test)] mod tests { … }` takes, if it is here.
fn unit_tests(tokens: &[TokenTree]) -> Option<usize> {
    let texts: Vec<String> = tokens.iter().take(3).map(ToString::to_string).collect();
    let is_test = matches!(&texts[..], [hash, cfg, module]
        if hash == "#" && cfg.replace(' ', "") == "[cfg(test)]" && module == "mod");
    is_test.then_some(5)
}

/// The module that a path begins at, if the first token is `crate` or `super` and `::` follows.
fn start(tokens: &[TokenTree], module: &[String]) -> Option<Vec<String>> {
    let [TokenTree::Ident(first), colon, ..] = tokens else { return None };
    if colon.to_string() != ":" {
        return None;
    }
    match first.to_string().as_str() {
        "crate" => Some(Vec::new()),
        "super" => Some(module[..module.len().saturating_sub(1)].to_vec()),
        _ => None,
    }
}

/// Follows `::name`, `::{…}` and `::*` after the prefix.
fn follow(
    tokens: &[TokenTree],
    at: &mut usize,
    mut prefix: Vec<String>,
    module: &[String],
    paths: &mut BTreeSet<Vec<String>>,
) {
    while is_colon(tokens.get(*at)) && is_colon(tokens.get(*at + 1)) {
        match tokens.get(*at + 2) {
            Some(TokenTree::Ident(name)) if name == "super" => drop(prefix.pop()),
            Some(TokenTree::Ident(name)) => prefix.push(name.to_string()),
            Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                branches(group.stream(), &prefix, module, paths);
                *at += 3;
                return;
            }
            _ => break,
        }
        *at += 3;
    }
    paths.insert(prefix);
}

/// Each branch of a `use` tree's `{…}`.
fn branches(tokens: TokenStream, prefix: &[String], module: &[String], paths: &mut BTreeSet<Vec<String>>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    for branch in tokens.split(|token| token.to_string() == ",") {
        if let [TokenTree::Ident(first), ..] = branch {
            let mut path = prefix.to_vec();
            if first != "self" {
                path.push(first.to_string());
            }
            follow(branch, &mut 1, path, module, paths);
        }
    }
}

fn is_colon(token: Option<&TokenTree>) -> bool {
    token.is_some_and(|token| token.to_string() == ":")
}

#[test]
fn paths_are_found_in_uses_in_code_and_in_macros_but_not_in_unit_tests() {
    let text = "use crate::{a::{B, self}, c::D}; use super::e; fn f() { assert!(crate::g::h(1)); }
        #[cfg(test)] mod tests { use crate::never; } pub(crate) fn i() {}";
    let path = |path: &str| -> Vec<String> { path.split("::").map(str::to_owned).collect() };
    let module = path("x::y");
    assert_eq!(named_in(text, &module), ["a::B", "a", "c::D", "x::e", "g::h"].map(path).into());
}
