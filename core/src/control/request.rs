//! Administrative requests with the codes and sentinels of the wire converted.

use super::answers::Refused;
use super::motor::Kind;
use motord_shared::{AdminRequest, Lease, Operation, Refusal, message};

/// The content of a request. Indices of groups and joints are not checked yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Request {
    Claim(usize),
    Release,
    ForceRelease(usize),
    Enable(Groups),
    Disable(Groups),
    Reset(Groups),
    EmergencyStop,
    Exclude(usize),
    Include(usize),
    Serve(Kind, usize),
}

/// The groups that a request is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Groups {
    All,
    One(usize),
}

/// The process that sends a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Asker {
    pub(super) pid: u32,
    pub(super) right: Right,
}

/// The right that a request claims.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Right {
    /// That of an operator, who owns no group.
    Operator,
    /// That of the owner with this lease. It may be lost.
    Owner(Lease),
    /// The request has a number that no daemon grants as a lease.
    Invalid,
}

impl Asker {
    pub(super) fn of(request: &AdminRequest) -> Self {
        let right = match (request.lease, Lease::from_raw(request.lease)) {
            (0, _) => Right::Operator,
            (_, Some(lease)) => Right::Owner(lease),
            (_, None) => Right::Invalid,
        };
        Self { pid: request.pid, right }
    }

    /// Returns the lease in the request.
    pub(super) const fn lease(&self) -> Option<Lease> {
        match self.right {
            Right::Owner(lease) => Some(lease),
            Right::Operator | Right::Invalid => None,
        }
    }
}

impl Request {
    /// Converts a request.
    ///
    /// # Errors
    ///
    /// When it is malformed, or its operation is unknown or not one of the cycle.
    pub(super) fn read(request: &AdminRequest) -> Result<Self, Refused> {
        let (group, joint) = (request.group as usize, request.joint as usize);
        let groups = if request.group == message::ALL_GROUPS { Groups::All } else { Groups::One(group) };
        let operation = request.operation().map_err(|(reason, number)| match reason {
            Refusal::UnknownOperation => Refused::unknown(reason, number),
            _ => Refused::new(reason),
        })?;
        Ok(match operation {
            Operation::Claim => Self::Claim(group),
            Operation::Release => Self::Release,
            Operation::ForceRelease => Self::ForceRelease(group),
            Operation::Enable => Self::Enable(groups),
            Operation::Disable => Self::Disable(groups),
            Operation::Reset => Self::Reset(groups),
            Operation::EmergencyStop => Self::EmergencyStop,
            Operation::Exclude => Self::Exclude(joint),
            Operation::Include => Self::Include(joint),
            Operation::SetZero => Self::Serve(Kind::SetZero, joint),
            Operation::ClearFault => Self::Serve(Kind::ClearFault, joint),
            Operation::Describe
            | Operation::Telemetry
            | Operation::Histograms
            | Operation::ResetTelemetry => {
                return Err(Refused::unknown(Refusal::UnknownOperation, request.operation));
            }
        })
    }
}
