//! Instructions for the operator of a stopped group.

use motord_client::Cause;

/// The next steps of the operator after a stop with this `cause`, in a group named `group`.
pub(crate) fn advice(cause: Option<Cause>, group: &str) -> String {
    let remedy = cause.map_or("Install the same version of motorctl and motord", Cause::advice);
    format!("{remedy}. Then run `motorctl reset {group}` and `motorctl enable {group}`.")
}
