//! Runs the example of `docs/embedding.md`.

#[path = "../examples/embed.rs"]
mod embed;

#[test]
fn example_cycle_in_another_program_runs() {
    embed::main().unwrap();
}
