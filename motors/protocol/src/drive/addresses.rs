//! The ids of a motor on a bus of frames.

use crate::profile::Ids;
use motord_bus::{FrameId, IdFilter, IdSet};

/// The ids by which a motor and its host address each other on a bus of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Addresses {
    /// The id of a command to the motor: the highest, where its commands have several.
    pub command_id: FrameId,
    /// The ids of all frames that command the motor. One from elsewhere is another master's.
    pub commands: IdSet,
    /// The ids of the frames that the motor sends.
    pub replies: IdSet,
    /// All ids that the motor sends or may read as commands, where they are more than these. No other
    /// node of its bus may use one.
    pub node: Option<IdFilter>,
    /// Ids of 11 bits by which all motors of its family are commanded together.
    pub shared: &'static [u16],
}

impl Addresses {
    /// A motor that is commanded at its `id`, and replies with its host id.
    #[must_use]
    pub fn by_id(id: u8, host_id: FrameId) -> Self {
        Self {
            command_id: FrameId::from(id),
            commands: IdFilter::exact(FrameId::from(id)).into(),
            replies: IdFilter::exact(host_id).into(),
            node: None,
            shared: &[],
        }
    }

    /// Returns the ids of all frames that the motor may read as commands.
    #[must_use]
    pub fn receives(&self) -> IdSet {
        self.node.map_or(self.commands, IdSet::from)
    }

    /// Returns the ids of the frames that a motor of a vendor with these `ids` reads as commands to
    /// it. Those of other modes have 11 bits, like the commands that they are an offset from.
    pub fn obeyed(self, ids: &Ids) -> impl Iterator<Item = FrameId> {
        let standard = u16::try_from(self.command_id.raw()).ok().filter(|_| !self.command_id.is_extended());
        let others = ids.also_receives.iter().filter_map(move |offset| FrameId::new(standard? + offset));
        let shared = self.shared.iter().filter_map(|id| FrameId::new(*id));
        core::iter::once(self.command_id).chain(others).chain(shared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::DAMIAO;

    #[test]
    fn commands_of_29_bits_have_no_other_modes() {
        let short = |raw| FrameId::new(raw).unwrap();
        let addresses = Addresses::by_id(5, short(0x15));
        let obeyed: Vec<_> = addresses.obeyed(&DAMIAO.ids).collect();
        assert_eq!(obeyed, [0x005, 0x105, 0x205, 0x305].map(short));
        let addresses = Addresses { command_id: FrameId::extended(5).unwrap(), ..addresses };
        assert_eq!(addresses.obeyed(&DAMIAO.ids).collect::<Vec<_>>(), [addresses.command_id]);
    }
}
