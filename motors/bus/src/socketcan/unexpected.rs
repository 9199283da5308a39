//! Frames whose id belongs to no motor of the bus.

use std::os::fd::AsFd;

use socketcan::{CanSocket, SocketOptions};

use super::{Link, OpenError, open_socket, wire};
use crate::filter::IdFilter;
use crate::frame::{FrameId, Inbox};
use crate::kernel::{Batch, FRAME_BYTES, Message};

/// A socket beside that of the bus, for a housekeeping thread that reads periodically.
struct Beside {
    socket: CanSocket,
    batch: Batch,
}

impl Beside {
    /// Most batches that one [`read`](Self::read) reads: more than a receive buffer of the default
    /// 208 KiB holds.
    const BATCHES: usize = 8;

    /// Opens the socket on the interface of `link`, with `filters`, for frames of any format.
    fn open(link: &Link, filters: &[(u32, u32)], options: &[(i32, i32)]) -> Result<Self, OpenError> {
        let socket = open_socket(link.interface, link.index, |socket| {
            socket.set_filters(filters)?;
            socket.set_socket_option_int(libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES, 1)?;
            options.iter().try_for_each(|(level, name)| socket.set_socket_option_int(*level, *name, 1))
        })?;
        Ok(Self { socket, batch: Batch::new(Inbox::CAPACITY, FRAME_BYTES) })
    }

    /// Passes the frames that have arrived to `each`. Does not block or allocate; at most eight
    /// system calls.
    fn read(&mut self, mut each: impl FnMut(Message<'_>)) {
        for _ in 0..Self::BATCHES {
            let count = self.batch.receive(self.socket.as_fd(), self.batch.capacity()).unwrap_or(0);
            self.batch.messages(count).for_each(&mut each);
            if count < self.batch.capacity() {
                break;
            }
        }
    }
}

/// Counts frames with other ids than the expected ones, on a separate socket, so that a flood of
/// them costs the real-time thread nothing. For a housekeeping thread that reads periodically. The
/// kernel counts the frames that its buffer cannot hold.
pub struct UnexpectedIds {
    beside: Beside,
    read: u64,
    /// `SO_RXQ_OVFL`, unwrapped.
    dropped: u64,
    /// Of those that were read.
    extended: u64,
}

impl UnexpectedIds {
    /// Counts every frame on the interface of `link` whose id is not in `expected`, except error
    /// reports. `expected` holds the ids of the motors' replies and of the commands to them. Where
    /// the 29-bit ids among them need too many filters, no data frame with a 29-bit id is counted.
    ///
    /// # Errors
    ///
    /// [`OpenError::NotCan`] when the interface is unplugged, or [`OpenError::System`].
    pub fn open(link: &Link, expected: &[IdFilter]) -> Result<Self, OpenError> {
        let beside = Beside::open(link, &others(expected), &[(libc::SOL_SOCKET, libc::SO_RXQ_OVFL)])?;
        Ok(Self { beside, read: 0, dropped: 0, extended: 0 })
    }

    /// Returns the number of such frames since opening. Does not block or allocate; at most eight
    /// system calls. Frames that the kernel dropped are counted with the next frame that arrives.
    pub fn count(&mut self) -> u64 {
        let Self { beside, read, dropped, extended } = self;
        beside.read(|message| {
            *read += 1;
            *extended += u64::from(wire::is_extended(&message.classic()));
            if let Some(now) = wire::ancillary(message.control()).dropped {
                *dropped += u64::from(now.wrapping_sub(*dropped as u32));
            }
        });
        *read + *dropped
    }

    /// Returns the number of frames with 29-bit ids among those that [`count`](Self::count) has
    /// read.
    #[must_use]
    pub const fn extended(&self) -> u64 {
        self.extended
    }
}

/// Counts frames in CAN FD format with the ids of motors' replies. The bus does not receive them:
/// its socket is a classic one. For a housekeeping thread, while a motor is silent: the kernel
/// copies every reply of the bus to this socket.
pub struct FdReplies {
    beside: Beside,
    count: u64,
}

impl FdReplies {
    /// Opens the socket on the interface of `link`.
    ///
    /// # Errors
    ///
    /// [`OpenError::NotCan`] when the interface is unplugged, or [`OpenError::System`].
    pub fn open(link: &Link, replies: &[IdFilter]) -> Result<Self, OpenError> {
        let filters: Vec<_> = replies.iter().map(|ids| ids.words()).collect();
        Ok(Self { beside: Beside::open(link, &filters, &[])?, count: 0 })
    }

    /// Returns the number of such frames since opening. Does not block or allocate; at most eight
    /// system calls.
    pub fn count(&mut self) -> u64 {
        let Self { beside, count } = self;
        beside.read(|message| *count += u64::from(message.frame_bytes() == FRAME_BYTES));
        *count
    }
}

/// The mask of a filter for one id of 11 bits, which the kernel finds in a table.
const EXACT: u32 = libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG | libc::CAN_SFF_MASK;

/// Most filters that a socket accepts (`CAN_RAW_FILTER_MAX`).
const FILTERS_MAX: usize = 512;

/// Most filters for extended ids. The kernel compares each frame of the bus with each of them.
const EXTENDED_FILTERS_MAX: usize = 128;

/// Returns filters for everything except data frames with the `expected` ids. A frame matches one
/// filter or none. The kernel applies them to every frame of the bus, on a virtual interface within
/// the call that sends it. They must therefore be cheap. The kernel compares each frame with each
/// filter for several ids, but finds the filter for a single id in a table.
fn others(expected: &[IdFilter]) -> Vec<(u32, u32)> {
    let is_expected =
        |id: &u16| FrameId::new(*id).is_some_and(|id| expected.iter().any(|ids| ids.matches(id)));
    let standard: Vec<u32> = (0..=FrameId::MAX.raw() as u16).filter(is_expected).map(u32::from).collect();
    let block = Block::around(&standard);
    // The block takes one inverted filter, which every extended frame meets, and at most one filter
    // for each of its ids.
    if block.len() < FILTERS_MAX && !expected.iter().any(|ids| ids.is_extended()) {
        block.filters_without(&standard)
    } else {
        ranges_without(&standard, extended_without(expected))
    }
}

/// Returns filters for all extended frames except data frames with the `expected` ids; for remote
/// frames only, where that takes too many.
fn extended_without(expected: &[IdFilter]) -> Vec<(u32, u32)> {
    let expected: Vec<_> = expected.iter().filter(|ids| ids.is_extended()).map(|ids| ids.words()).collect();
    let mut filters = Vec::new();
    append_regions(&expected, (libc::CAN_EFF_FLAG, libc::CAN_EFF_FLAG), &mut filters);
    let remote = libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG;
    if filters.len() > EXTENDED_FILTERS_MAX { vec![(remote, remote)] } else { filters }
}

/// Appends filters for the part of a region without the `expected` ids. A region is itself a
/// filter. Each step halves it, at most once for each bit of a frame's id, and first where all
/// expected ids are in one half: these steps are for all of them.
fn append_regions(expected: &[(u32, u32)], (id, mask): (u32, u32), filters: &mut Vec<(u32, u32)>) {
    let mut overlapping = expected.iter().filter(|(other, bits)| (id ^ other) & mask & bits == 0);
    let Some((first, bits)) = overlapping.next() else {
        filters.push((id, mask));
        return;
    };
    let varying = bits & !mask;
    let common = overlapping.fold(varying, |common, (other, bits)| common & bits & !(first ^ other));
    let splitting = if common == 0 { varying } else { common };
    let Some(half) = splitting.checked_ilog2().map(|bit| 1 << bit) else { return };
    append_regions(expected, (id, mask | half), filters);
    append_regions(expected, (id | half, mask | half), filters);
}

/// The ids that equal `id` in all bits except those of `varying`.
struct Block {
    id: u32,
    varying: u32,
}

impl Block {
    /// Returns the smallest block that contains all `expected` ids; all ids when there are none.
    fn around(expected: &[u32]) -> Self {
        let Some(&id) = expected.first() else {
            return Self { id: 0, varying: libc::CAN_SFF_MASK };
        };
        let varying = expected.iter().fold(0, |varying, other| varying | (other ^ id));
        Self { id: id & !varying, varying }
    }

    const fn len(&self) -> usize {
        1 << self.varying.count_ones()
    }

    /// Returns one filter for all ids outside, and one for each unexpected id inside.
    fn filters_without(&self, expected: &[u32]) -> Vec<(u32, u32)> {
        let Self { id, varying } = *self;
        let outside = (id | libc::CAN_INV_FILTER, EXACT & !varying);
        let inside = (0..=libc::CAN_SFF_MASK).filter(|other| other & !varying == id);
        let unexpected = inside.filter(|inside| !expected.contains(inside));
        std::iter::once(outside).chain(unexpected.map(|id| (id, EXACT))).collect()
    }
}

/// Returns the filters for `extended` frames, and filters for ranges of ids without the `expected`
/// ones. The smallest ranges get one filter for each id, while the socket has enough filters.
fn ranges_without(expected: &[u32], extended: Vec<(u32, u32)>) -> Vec<(u32, u32)> {
    let mut ranges = Vec::new();
    append_ranges(expected, 0, libc::CAN_SFF_MASK + 1, &mut ranges);
    ranges.sort_by_key(|&(_, size)| size);
    let mut filters = extended;
    filters.push((libc::CAN_RTR_FLAG, libc::CAN_RTR_FLAG | libc::CAN_EFF_FLAG));
    for (index, &(start, size)) in ranges.iter().enumerate() {
        let others = ranges.len() - index - 1;
        if filters.len() + size as usize + others <= FILTERS_MAX {
            filters.extend((start..start + size).map(|id| (id, EXACT)));
        } else {
            filters.push((start, EXACT & !(size - 1)));
        }
    }
    filters
}

/// Appends the ranges of unexpected ids among the `size` ids from `start`, each as start and size.
/// `size` is a power of two.
fn append_ranges(expected: &[u32], start: u32, size: u32, ranges: &mut Vec<(u32, u32)>) {
    let range = start..start + size;
    if !expected.iter().any(|id| range.contains(id)) {
        ranges.push((start, size));
    } else if size > 1 {
        append_ranges(expected, start, size / 2, ranges);
        append_ranges(expected, start + size / 2, size / 2, ranges);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(raw: &[u16]) -> Vec<IdFilter> {
        raw.iter().map(|id| IdFilter::exact(FrameId::new(*id).unwrap())).collect()
    }

    /// Matches as the kernel does (`can_rcv_filter` of its `net/can/af_can.c`).
    fn meets(frame: u32, (id, mask): (u32, u32)) -> bool {
        let is_inverted = id & libc::CAN_INV_FILTER != 0;
        (frame & mask == id & mask) != is_inverted
    }

    #[test]
    fn every_frame_but_the_expected_meets_one_filter() {
        let few: &[u16] = &[1, 2, 3, 0x101, 0x102, 0x103];
        for expected in [ids(few), ids(&[few, &[0x7FF]].concat()), ids(&[5]), ids(&[])] {
            let filters = others(&expected);
            assert!(filters.len() <= FILTERS_MAX, "{}", filters.len());
            let met = |frame: u32| filters.iter().filter(|filter| meets(frame, **filter)).count();
            for id in 0..=libc::CAN_SFF_MASK {
                let is_expected =
                    expected.iter().any(|known| known.matches(FrameId::new(id as u16).unwrap()));
                assert_eq!(met(id), usize::from(!is_expected), "{id:#x}");
                assert_eq!(met(id | libc::CAN_RTR_FLAG), 1, "{id:#x}");
                assert_eq!(met(id | libc::CAN_EFF_FLAG), 1, "{id:#x}");
                assert_eq!(met(id | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG), 1, "{id:#x}");
            }
        }
    }

    /// Commands and replies of motors with ids of 29 bits, any status in those of the replies,
    /// beside motors with 11 bits.
    #[test]
    fn expected_extended_frame_meets_no_filter() {
        let extended = |raw| FrameId::extended(raw).unwrap();
        for motors in [1, 6, 24] {
            let replies =
                (1..=motors).map(|motor| IdFilter::masked(extended(0x0200_00FD | motor << 8), 0x1F00_FFFF));
            let commands = (1..=motors).map(|motor| IdFilter::exact(extended(0x0100_FD00 | motor)));
            let expected: Vec<_> = replies.chain(commands).chain(ids(&[1, 0x101])).collect();
            let filters = others(&expected);
            assert!(filters.len() <= FILTERS_MAX, "{}", filters.len());
            let met = |frame: u32| filters.iter().filter(|filter| meets(frame, **filter)).count();
            let motors = [0, 1, motors, motors + 1, 0x7F];
            let raws = motors.map(|motor| {
                [
                    0x0200_00FD | motor << 8,
                    0x02A5_00FD | motor << 8,
                    0x0300_00FD | motor << 8,
                    0x0100_FD00 | motor,
                ]
            });
            for id in raws.into_iter().flatten().chain([0, 1, 0x101, 0x1FFF_FFFF]) {
                let is_expected = expected.iter().any(|known| known.matches(extended(id)));
                assert_eq!(met(id | libc::CAN_EFF_FLAG), usize::from(!is_expected), "{id:#x}");
                assert_eq!(met(id | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG), 1, "{id:#x}");
            }
            assert_eq!([0x000, 0x001, 0x101, 0x7FF].map(met), [1, 0, 0, 1]);
        }
    }

    #[test]
    fn extended_ids_beyond_filters_are_not_counted() {
        let spread = (0..400).map(|index: u32| index.wrapping_mul(0x9E37_79B1) >> 3);
        let expected: Vec<_> = spread.map(|raw| IdFilter::exact(FrameId::extended(raw).unwrap())).collect();
        let filters = others(&expected);
        assert!(filters.len() <= FILTERS_MAX, "{}", filters.len());
        let meets_any = |frame: u32| filters.iter().any(|filter| meets(frame, *filter));
        assert!(!meets_any(libc::CAN_EFF_FLAG) && meets_any(0x123));
        assert!(meets_any(libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG));
    }

    /// Three motors, their replies, and the kernel's lookup table for single ids.
    #[test]
    fn motor_frame_is_compared_with_one_filter() {
        let filters = others(&ids(&[1, 2, 3, 0x101, 0x102, 0x103]));
        assert_eq!(filters.iter().filter(|(_, mask)| *mask != EXACT).count(), 1, "{filters:X?}");
    }
}
