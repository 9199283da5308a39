//! Names the shared library for programs that link it, and exports the functions of `motord.h`
//! only.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // The number changes with every change after which a built program does not work any more.
    println!("cargo::rustc-cdylib-link-arg=-Wl,-soname,libmotord.so.0");
    println!("cargo::rustc-cdylib-link-arg=-Wl,--exclude-libs,ALL");
}
