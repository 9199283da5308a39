//! The architecture test: rules that the compiler does not check. Each rule is a function over
//! text. One test applies it to the workspace, another to a bad example that it must reject.

#![cfg(test)]

mod circles;
mod docs;
mod explanations;
mod generated;
mod imports;
mod links;
mod paths;
mod programs;
mod rooms;
mod seams;
mod sizes;
mod sources;
mod unsafe_code;
mod words;
