//! The seams: few files tell families of motors and transports apart, and the cycle names no vendor
//! of an IMU and no transport.

use crate::sources::{self, Source};
use crate::words;
use proc_macro2::{TokenStream, TokenTree};
use std::collections::BTreeSet;

/// A type whose variants only few files name, and the largest number of these files.
const VARIANTS: &[(&str, usize)] = &[("MotorProtocol", MOTOR_PROTOCOL), ("BusKind", BUS_KIND)];

/// Files that name a variant of `MotorProtocol`.
const MOTOR_PROTOCOL: usize = 4;
/// Files that name a variant of `BusKind`.
const BUS_KIND: usize = 4;

/// Where code names neither a vendor of an IMU nor a transport.
const NEUTRAL: &[&str] = &["core/src/cycle/", "core/src/drive/"];

/// Vendors of IMUs and transports, as parts of a name in lower case without `_`.
const REFUSED: &[&str] = &["hipnuc", "damiao", "xsens", "socketcan", "buskind"];

/// The word that is refused as a whole name only: a serial number is another thing.
const SERIAL: &str = "serial";

/// Returns whether code names a path through `name`, as in `BusKind::Serial`.
fn names_variant(code: TokenStream, name: &str) -> bool {
    let tokens: Vec<TokenTree> = code.into_iter().collect();
    let is_colon = |at: usize| tokens.get(at).is_some_and(|token: &TokenTree| token.to_string() == ":");
    tokens.iter().enumerate().any(|(at, token)| match token {
        TokenTree::Group(group) => names_variant(group.stream(), name),
        token => token.to_string() == name && is_colon(at + 1) && is_colon(at + 2),
    })
}

/// The files that name a variant of `name`.
fn files_with<'a>(sources: &'a [Source], name: &str) -> Vec<&'a str> {
    let of_name = sources.iter().filter(|source| source.text.contains(name));
    let named = of_name.filter(|source| names_variant(source.text.parse().unwrap(), name));
    named.map(|source| source.path.as_str()).collect()
}

/// The refused names in code.
fn refused(code: &str) -> BTreeSet<String> {
    let is_refused = |name: &String| {
        let flat = name.replace('_', "").to_lowercase();
        flat == SERIAL || REFUSED.iter().any(|word| flat.contains(word))
    };
    words::identifiers(code).into_iter().filter(is_refused).collect()
}

#[test]
fn few_files_name_families_and_transports() {
    let sources = sources::rust();
    for (name, most) in VARIANTS {
        let files = files_with(&sources, name);
        println!("{name}: {} files, at most {most}", files.len());
        assert!(files.len() <= *most, "{name}:: in {} files, at most {most}: {files:#?}", files.len());
    }
}

#[test]
fn cycle_names_no_imu_vendor_or_transport() {
    let sources = sources::rust();
    let is_neutral = |source: &&Source| NEUTRAL.iter().any(|prefix| source.path.starts_with(prefix));
    for source in sources.iter().filter(is_neutral) {
        assert_eq!(refused(&source.text), BTreeSet::new(), "{}", source.path);
    }
}

#[test]
fn variants_and_refused_names_are_found() {
    let source = |path: &str, text: &str| Source { path: path.into(), text: text.into() };
    let sources = [
        source("a.rs", "fn f(kind: BusKind) -> bool { matches!(kind, BusKind::Serial { .. }) }"),
        source("b.rs", "// BusKind::Serial\nuse settings::BusKind; fn f(_: &BusKind) {}"),
    ];
    assert_eq!(files_with(&sources, "BusKind"), ["a.rs"]);
    let code = "// Xsens\nfn read_hipnuc(line: serial::Line, kind: SocketCan, serial_number: u32) {}";
    assert_eq!(refused(code), ["SocketCan", "read_hipnuc", "serial"].map(str::to_owned).into());
}
