//! The receipt of an emergency stop, as JSON.

use motord_client::Error;
use serde::{Deserialize, Serialize};

/// The outcome of a stop.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Receipt {
    /// The daemon confirmed that it sent the commands that damp the motors.
    pub(crate) sent: bool,
    /// Each motor answered after these commands.
    pub(crate) confirmed: bool,
    /// A sentence.
    pub(crate) message: String,
    /// Joints whose motors did not answer after the stop.
    pub(crate) unconfirmed: Vec<String>,
}

impl Receipt {
    /// Returns the receipt of a stop with this outcome.
    pub(crate) fn of(outcome: Result<(), Error>) -> Self {
        let Err(error) = outcome else {
            let message = "stopped: each motor answered".to_owned();
            return Self { sent: true, confirmed: true, message, unconfirmed: Vec::new() };
        };
        let message = error.to_string();
        let (sent, unconfirmed) = match error {
            Error::MotorsOffline { joints } => (true, joints),
            Error::MotorsUnchecked { .. } => (true, Vec::new()),
            _ => (false, Vec::new()),
        };
        Self { sent, confirmed: false, message, unconfirmed }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_with_silent_motors_was_sent() {
        let joints = vec!["knee".to_owned()];
        let receipt = Receipt::of(Err(Error::MotorsOffline { joints: joints.clone() }));
        assert_eq!((receipt.sent, receipt.confirmed, receipt.unconfirmed), (true, false, joints));
        assert!(Receipt::of(Ok(())).confirmed);
    }
}
