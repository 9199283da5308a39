//! Counts the frames that the kernel keeps from the cycle because no motor of the bus has their id,
//! or because of their format.

use motord_bus::socketcan::{FdReplies, InterfaceName, Link, UnexpectedIds};
use motord_bus::{FrameId, IdFilter};
use motord_core::cycle::Counters;
use motord_protocol::drive::Addresses;
use motord_protocol::register;
use motord_settings::settings::{MotorSettings, Settings};
use std::sync::atomic::Ordering;

/// The CAN interfaces of a configuration, with the sockets that count their unexpected ids.
pub(super) struct UnexpectedCounts(Vec<Interface>);

struct Interface {
    bus: usize,
    name: InterfaceName,
    /// The ids that motors of this bus answer with and are commanded by.
    expected: Vec<IdFilter>,
    /// `None` while the interface is missing.
    unexpected_ids: Option<UnexpectedIds>,
    /// The count until the interface went away.
    before: u64,
    /// The ids that motors of this bus answer with.
    replies: Vec<IdFilter>,
    watch: Watch,
}

/// The search for answers in other formats on a bus with a silent motor.
#[derive(Default)]
enum Watch {
    /// No motor became silent since the last search.
    #[default]
    Idle,
    /// A motor became silent.
    Wanted,
    /// Open until the next step; with the number of frames with 29-bit ids before.
    Open(FdReplies, u64),
}

/// Frames in formats that motord does not use, on a bus with a silent motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct OtherFormats {
    pub(super) bus: usize,
    /// In CAN FD format, with the id of a motor's reply.
    pub(super) fd: u64,
    /// With 29-bit ids.
    pub(super) extended: u64,
}

impl UnexpectedCounts {
    /// Nothing is open yet.
    pub(super) fn new(settings: &Settings) -> Self {
        let interfaces = settings.buses.iter().enumerate().filter_map(|(bus, described)| {
            let interface = described.interface()?;
            let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
            let replies = motors.clone().flat_map(|motor| motor.addresses().replies.filters()).collect();
            // A socket receives what other sockets of this computer send: the requests of the cycle
            // to registers.
            let requests = motors.clone().filter(|motor| motor.profile.has_registers).take(1);
            let requests = requests.filter_map(|_| FrameId::new(register::REQUEST_ID)).map(IdFilter::exact);
            let expected = motors.flat_map(ids).chain(requests).collect();
            let name = interface.parse().ok()?;
            let watch = Watch::Idle;
            Some(Interface { bus, name, expected, unexpected_ids: None, before: 0, replies, watch })
        });
        Self(interfaces.collect())
    }

    /// Opens a socket on every interface that has none. An interface that cannot be opened is
    /// logged by the opening of its bus, not here.
    pub(super) fn open(&mut self) {
        for interface in self.0.iter_mut().filter(|interface| interface.unexpected_ids.is_none()) {
            let link = Link::read(interface.name);
            interface.unexpected_ids =
                link.and_then(|link| UnexpectedIds::open(&link, &interface.expected)).ok();
        }
    }

    /// Closes the socket of `bus`, whose interface is gone: the kernel takes one that comes back
    /// for another interface.
    pub(super) fn close(&mut self, bus: usize) {
        for interface in self.0.iter_mut().filter(|interface| interface.bus == bus) {
            interface.before +=
                interface.unexpected_ids.take().map_or(0, |mut unexpected_ids| unexpected_ids.count());
        }
    }

    /// Requests a search for answers in other formats on `bus`, of which a motor is silent.
    pub(super) fn search(&mut self, bus: usize) {
        for interface in self.0.iter_mut().filter(|interface| interface.bus == bus) {
            if matches!(interface.watch, Watch::Idle) {
                interface.watch = Watch::Wanted;
            }
        }
    }

    /// Begins the requested searches, ends those that the last call began, and passes what they
    /// found to `found`. A silent motor is asked ten times a second.
    pub(super) fn step_searches(&mut self, mut found: impl FnMut(OtherFormats)) {
        for interface in &mut self.0 {
            let extended = interface.unexpected_ids.as_ref().map_or(0, UnexpectedIds::extended);
            interface.watch = match std::mem::take(&mut interface.watch) {
                Watch::Idle => Watch::Idle,
                Watch::Wanted => {
                    let link = Link::read(interface.name);
                    let opened = link.and_then(|link| FdReplies::open(&link, &interface.replies));
                    opened.map_or(Watch::Idle, |replies| Watch::Open(replies, extended))
                }
                Watch::Open(mut replies, before) => {
                    let (fd, extended) = (replies.count(), extended.saturating_sub(before));
                    // They were counted nowhere.
                    interface.before += fd;
                    if fd > 0 || extended > 0 {
                        found(OtherFormats { bus: interface.bus, fd, extended });
                    }
                    Watch::Idle
                }
            };
        }
    }

    /// Stores the counts up to now, modulo 2³².
    pub(super) fn store(&mut self, counters: &Counters) {
        for interface in &mut self.0 {
            let now = interface.unexpected_ids.as_mut().map_or(0, UnexpectedIds::count);
            counters.unexpected_ids[interface.bus].store((interface.before + now) as u32, Ordering::Relaxed);
        }
    }
}

fn ids(motor: &MotorSettings) -> impl Iterator<Item = IdFilter> {
    let Addresses { commands, replies, .. } = motor.addresses();
    commands.filters().chain(replies.filters())
}
