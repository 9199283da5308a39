//! motord.
fn main() {}
