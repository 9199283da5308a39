//! Instructions for the operator of a stopped group.

use motord_client::{Cause, DEFAULT_INSTANCE};
use std::borrow::Cow;
use std::fmt;

/// The next steps of the operator after a stop.
#[derive(Debug, Clone, Default)]
pub(crate) struct Advice {
    /// The remedy, a sentence without its full stop.
    pub(crate) remedy: Cow<'static, str>,
    /// Lines to paste into a shell, in order. They end with the reset and move no motor.
    pub(crate) commands: Vec<String>,
    /// The last step, which starts the group again.
    pub(crate) start: String,
}

impl Advice {
    /// Returns the advice after a stop of `group` for a cause of `joint`. A group without an owner
    /// cannot be enabled: its controller must start again.
    pub(crate) fn new(
        cause: Option<Cause>,
        instance: &str,
        group: &str,
        joint: Option<&str>,
        has_owner: bool,
    ) -> Self {
        let motorctl = motorctl(instance);
        let fault = joint.filter(|_| cause == Some(Cause::MotorFault));
        let clear = fault.map(|joint| format!("{motorctl} fault clear {joint}"));
        let remedy = match cause {
            None => "Install the same version of motorctl and motord",
            Some(Cause::MotorFault) if clear.is_some() => "Remove the cause of the fault",
            Some(cause) => cause.advice(),
        };
        Self {
            remedy: remedy.into(),
            commands: clear.into_iter().chain([format!("{motorctl} reset {group}")]).collect(),
            start: if has_owner {
                format!("`{motorctl} enable {group}`")
            } else {
                "start the controller again".to_owned()
            },
        }
    }
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}. Then run ", self.remedy)?;
        self.commands.iter().try_for_each(|command| write!(f, "`{command}`, "))?;
        write!(f, "and {}.", self.start)
    }
}

/// Returns the beginning of a command line for `instance`.
pub(crate) fn motorctl(instance: &str) -> String {
    if instance == DEFAULT_INSTANCE {
        "motorctl".to_owned()
    } else {
        format!("motorctl --instance {instance}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_lines_name_instance_joint_and_group() {
        let advice = Advice::new(Some(Cause::MotorFault), "demo", "legs", Some("fl-knee"), true);
        assert_eq!(advice.start, "`motorctl --instance demo enable legs`");
        assert_eq!(
            advice.commands,
            ["motorctl --instance demo fault clear fl-knee", "motorctl --instance demo reset legs"]
        );
        let advice = Advice::new(Some(Cause::OwnerLost), DEFAULT_INSTANCE, "legs", Some("fl-knee"), false);
        assert_eq!(
            advice.to_string(),
            "Find out why the controller ended or was late. Then run `motorctl reset legs`, and start the controller again."
        );
    }
}
