//! The rules of the house that a compiler does not know. Each rule is a function over text: one test applies it to the
//! workspace, another one to a bad example that it must refuse.

#![cfg(test)]

mod circles;
mod comments;
mod docs;
mod explanations;
mod functions;
mod imports;
mod paths;
mod rooms;
mod sizes;
mod sources;
mod unsafe_code;
mod words;
