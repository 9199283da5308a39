//! The functions of `motord.h`.

#[expect(unsafe_code, reason = "the callers are written in C")]
mod claim;
#[expect(unsafe_code, reason = "the callers are written in C")]
mod client;
#[expect(unsafe_code, reason = "the callers are written in C")]
mod publisher;
#[expect(unsafe_code, reason = "the callers are written in C")]
mod state;

pub use claim::*;
pub use client::*;
pub use publisher::*;
pub use state::*;
