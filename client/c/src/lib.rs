//! The client library for C and C++: `include/motord.h`, which cbindgen makes of this crate,
//! describes each function.
//!
//! - [`abi`]: the functions, which check each pointer and let no panic out.
//! - [`handle`]: the objects behind the pointers of a caller.
//! - [`status`]: the results, and the message of the last failure.
//! - [`table`]: which object a pointer of a caller names.
//! - [`arrays`]: values of all joints of a group.
//! - [`joint`]: all values of a joint.
//! - [`generated`]: enumerations, from the tables of a joint's state and of codes.
//!
//! Reading and sending wait for no other thread, log nothing, and allocate nothing after the first
//! messages; a failure allocates.

pub mod abi;
pub mod arrays;
pub mod generated;
#[expect(unsafe_code, reason = "the callers are written in C")]
pub mod handle;
pub mod joint;
pub mod status;
#[expect(unsafe_code, reason = "its objects belong to callers in C")]
pub mod table;
