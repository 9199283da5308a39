//! How well the fault reports of a motor are known.

/// After this many fault requests without a report, a payload that continues the motion may be a
/// report.
pub(super) const UNREPORTED_MAX: u32 = 3;
/// After this many fault requests without a report, even a motor that sent an unambiguous report
/// may answer with another kind of report: its fault may set bits that no document names.
pub(super) const DOUBTED_AFTER: u32 = 10;

/// How well the fault reports of this motor are known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reports {
    /// No unambiguous report has arrived, or none recently. The number counts consecutive fault
    /// requests without an answer in their cycle.
    Unseen(u32),
    /// An unambiguous report has arrived. The number counts later consecutive fault requests
    /// without an answer in their cycle. No other payload is taken for a report until it reaches
    /// [`DOUBTED_AFTER`].
    Seen(u32),
}

impl Reports {
    /// Counts a fault request without an answer in its cycle.
    pub(super) const fn unreported(self) -> Self {
        match self {
            Self::Seen(unreported) if unreported + 1 < DOUBTED_AFTER => Self::Seen(unreported + 1),
            Self::Seen(unreported) | Self::Unseen(unreported) => Self::Unseen(unreported.saturating_add(1)),
        }
    }
}
