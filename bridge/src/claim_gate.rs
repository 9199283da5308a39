//! The claim of a group as the network threads see it, and the writer that it is bound to.

use crate::refusal::Refusal;
use std::sync::atomic::{AtomicU64, Ordering};

/// The number of the claim that the motor thread holds; 0 for none. A command carries the number
/// under which it was accepted, so that none outlives its claim.
#[derive(Debug, Default)]
pub(crate) struct ClaimGate {
    current: AtomicU64,
    last: AtomicU64,
}

impl ClaimGate {
    /// Opens the gate for a new claim, and returns its number.
    pub(crate) fn open(&self) -> u64 {
        let number = self.last.fetch_add(1, Ordering::Relaxed) + 1;
        self.current.store(number, Ordering::Release);
        number
    }

    /// Closes the gate: the claim has ended.
    pub(crate) fn close(&self) {
        self.current.store(0, Ordering::Release);
    }

    /// Returns the number of the claim; `None` without one.
    pub(crate) fn claim(&self) -> Option<u64> {
        Some(self.current.load(Ordering::Acquire)).filter(|number| *number != 0)
    }
}

/// The GUID of a DDS writer.
pub(crate) type Writer = [u8; 16];

/// The writer whose commands count. A claim is bound to the first writer whose valid command
/// arrives after it. DDS numbers the messages of a writer.
#[derive(Debug, Default)]
pub(crate) struct Binding {
    claim: u64,
    /// With the number of its newest command.
    writer: Option<(Writer, i64)>,
}

impl Binding {
    /// Checks whether the command `number` of `writer` may count under `claim`, and returns the number
    /// of the claim.
    pub(crate) fn admit(&mut self, claim: Option<u64>, writer: Writer, number: i64) -> Result<u64, Refusal> {
        let claim = claim.ok_or(Refusal::NoClaim)?;
        if self.claim != claim {
            *self = Self { claim, writer: None };
        }
        match self.writer {
            Some((bound, _)) if bound != writer => Err(Refusal::ForeignWriter),
            Some((_, newest)) if number <= newest => Err(Refusal::Reordered),
            _ => Ok(claim),
        }
    }

    /// Binds the claim to `writer`, whose command `number` was valid. Returns `true` for a new binding.
    pub(crate) fn bind(&mut self, writer: Writer, number: i64) -> bool {
        self.writer.replace((writer, number)).is_none_or(|(bound, _)| bound != writer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Writer = [1; 16];
    const B: Writer = [2; 16];

    #[test]
    fn nothing_counts_without_a_claim() {
        let (gate, mut binding) = (ClaimGate::default(), Binding::default());
        assert_eq!(binding.admit(gate.claim(), A, 1), Err(Refusal::NoClaim));
        gate.open();
        gate.close();
        assert_eq!(binding.admit(gate.claim(), A, 1), Err(Refusal::NoClaim));
    }

    #[test]
    fn first_valid_writer_excludes_the_others() {
        let (gate, mut binding) = (ClaimGate::default(), Binding::default());
        gate.open();
        assert_eq!(binding.admit(gate.claim(), A, 1), Ok(1));
        assert_eq!(binding.admit(gate.claim(), B, 1), Ok(1), "no valid command was seen yet");
        assert!(binding.bind(B, 1) && !binding.bind(B, 2));
        assert_eq!(binding.admit(gate.claim(), A, 9), Err(Refusal::ForeignWriter));
        assert_eq!(binding.admit(gate.claim(), B, 3), Ok(1));
    }

    #[test]
    fn command_after_newer_one_is_refused() {
        let (gate, mut binding) = (ClaimGate::default(), Binding::default());
        gate.open();
        assert_eq!(binding.admit(gate.claim(), A, 5), Ok(1));
        binding.bind(A, 5);
        for number in [4, 5] {
            assert_eq!(binding.admit(gate.claim(), A, number), Err(Refusal::Reordered));
        }
        assert_eq!(binding.admit(gate.claim(), A, 6), Ok(1));
    }

    #[test]
    fn new_claim_ends_the_binding() {
        let (gate, mut binding) = (ClaimGate::default(), Binding::default());
        gate.open();
        binding.bind(A, 7);
        gate.close();
        assert_eq!((gate.open(), binding.admit(gate.claim(), B, 1)), (2, Ok(2)));
    }
}
