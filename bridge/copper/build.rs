//! Tells Copper's macros where they are built.

fn main() {
    cu29_build::setup();
}
