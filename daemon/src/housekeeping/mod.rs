//! Work that keeps a running daemon reachable. None of it is urgent; all of it runs on the
//! telemetry thread.
//!
//! | type | job |
//! |---|---|
//! | [`DeadClients`] | removes clients that died, so that others find a slot |
//! | [`DirectoryGuard`] | stops the robot when no client can reach the daemon any more |
//! | [`ConfigWatch`] | reports a configuration file that changed since the start |

mod config_watch;
mod dead_clients;
mod directory_guard;

pub use config_watch::ConfigWatch;
pub use dead_clients::DeadClients;
pub use directory_guard::DirectoryGuard;
