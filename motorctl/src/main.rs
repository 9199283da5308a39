//! motorctl.
fn main() {}
