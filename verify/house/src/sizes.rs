//! No file has more than 600 lines, and no function more than 50.

use crate::sources;
use syn::visit::{self, Visit};

/// Lines of a file.
const FILE_LINES_MAX: usize = 600;

/// Files with more lines than [`FILE_LINES_MAX`].
fn long_files<'a>(files: impl Iterator<Item = (&'a str, &'a str)>) -> Vec<(&'a str, usize)> {
    let lines = files.map(|(path, text)| (path, text.matches('\n').count()));
    lines.filter(|(_, lines)| *lines > FILE_LINES_MAX).collect()
}

#[test]
fn no_file_has_more_than_600_lines() {
    let sources = sources::rust();
    let files = sources.iter().map(|source| (source.path.as_str(), source.text.as_str()));
    assert_eq!(long_files(files), []);
}

#[test]
fn a_file_of_601_lines_is_found() {
    let files = [("a.rs", "\n".repeat(600)), ("b.rs", "\n".repeat(601))];
    assert_eq!(long_files(files.iter().map(|(path, text)| (*path, text.as_str()))), [("b.rs", 601)]);
}

/// Lines from the signature to the closing brace.
const FUNCTION_LINES_MAX: usize = 50;

#[derive(Default)]
struct Functions {
    too_long: Vec<(String, usize)>,
}

impl Functions {
    fn check(&mut self, signature: &syn::Signature, body: &syn::Block) {
        let end = body.brace_token.span.close().end().line;
        let lines = end - signature.fn_token.span.start().line + 1;
        if lines > FUNCTION_LINES_MAX {
            self.too_long.push((signature.ident.to_string(), lines));
        }
    }
}

impl Visit<'_> for Functions {
    fn visit_item_fn(&mut self, function: &syn::ItemFn) {
        self.check(&function.sig, &function.block);
        visit::visit_item_fn(self, function);
    }

    fn visit_impl_item_fn(&mut self, function: &syn::ImplItemFn) {
        self.check(&function.sig, &function.block);
        visit::visit_impl_item_fn(self, function);
    }

    fn visit_trait_item_fn(&mut self, function: &syn::TraitItemFn) {
        if let Some(body) = &function.default {
            self.check(&function.sig, body);
        }
        visit::visit_trait_item_fn(self, function);
    }
}

/// The functions of a Rust file that are too long, and their lines.
fn long_functions(text: &str) -> Vec<(String, usize)> {
    let mut functions = Functions::default();
    functions.visit_file(&syn::parse_file(text).unwrap());
    functions.too_long
}

#[test]
fn no_function_has_more_than_50_lines() {
    let mut found = Vec::new();
    for source in sources::rust() {
        found
            .extend(long_functions(&source.text).into_iter().map(|function| (source.path.clone(), function)));
    }
    assert_eq!(found, []);
}

#[test]
fn a_function_of_51_lines_is_found() {
    let function = |lines: usize| format!("impl A {{ fn f() {{{}}} }}", "\n".repeat(lines - 1));
    assert_eq!(long_functions(&function(50)), []);
    assert_eq!(long_functions(&function(51)), [("f".to_owned(), 51)]);
}
