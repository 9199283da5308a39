//! The results of commands. Source: GIM document Table 5.

use core::fmt;

/// The result of a command, or the reason why the motor refused it.
pub type Outcome<T> = Result<T, Refusal>;

/// Reason for which a motor refused a command: every RES byte except 0, which is success.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Refusal {
    /// 0x01: failure, without a reason. A motor may also send it while it has a fault, or before it
    /// was started.
    Failure,
    /// 0x02: unknown command.
    UnknownCommand,
    /// 0x03: unknown id.
    UnknownId,
    /// 0x04: the register can only be read.
    ReadOnly,
    /// 0x05: unknown register.
    UnknownRegister,
    /// 0x06: string format.
    StringFormat,
    /// 0x07: data format.
    DataFormat,
    /// 0x0B: the register can only be written.
    WriteOnly,
    /// A byte that Table 5 does not list, as received; never 0.
    Unlisted(u8),
}

impl Refusal {
    /// Reads the RES byte.
    ///
    /// # Errors
    ///
    /// The refusal, when the byte is not 0.
    pub const fn check(res: u8) -> Outcome<()> {
        Err(match res {
            0x00 => return Ok(()),
            0x01 => Self::Failure,
            0x02 => Self::UnknownCommand,
            0x03 => Self::UnknownId,
            0x04 => Self::ReadOnly,
            0x05 => Self::UnknownRegister,
            0x06 => Self::StringFormat,
            0x07 => Self::DataFormat,
            0x0B => Self::WriteOnly,
            res => Self::Unlisted(res),
        })
    }

    /// Returns the RES byte.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Failure => 0x01,
            Self::UnknownCommand => 0x02,
            Self::UnknownId => 0x03,
            Self::ReadOnly => 0x04,
            Self::UnknownRegister => 0x05,
            Self::StringFormat => 0x06,
            Self::DataFormat => 0x07,
            Self::WriteOnly => 0x0B,
            Self::Unlisted(res) => res,
        }
    }
}

impl Refusal {
    /// Returns the vendor's term.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::Failure => "failure",
            Self::UnknownCommand => "unknown command",
            Self::UnknownId => "unknown id",
            Self::ReadOnly => "read-only register",
            Self::UnknownRegister => "unknown register",
            Self::StringFormat => "string format",
            Self::DataFormat => "data format",
            Self::WriteOnly => "write-only register",
            Self::Unlisted(_) => "reason not in the vendor's list",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the motor refused: {} (RES {:#04X})", self.reason(), self.code())
    }
}

impl core::error::Error for Refusal {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nonzero_result_byte_is_refusal_with_code() {
        assert_eq!(Refusal::check(0), Ok(()));
        for res in 1..=u8::MAX {
            assert_eq!(Refusal::check(res).map_err(Refusal::code), Err(res));
        }
    }
}
