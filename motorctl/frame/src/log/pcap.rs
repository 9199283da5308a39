//! Captures of tcpdump and Wireshark: pcap and pcapng, of link type SocketCAN, or Linux cooked (`-i any`).
//!
//! Source: tcpdump.org, `LINKTYPE_CAN_SOCKETCAN`, whose ids are in network order, and `LINKTYPE_LINUX_SLL` and
//! `LINKTYPE_LINUX_SLL2`, whose ids are in the byte order of the machine that captured (libpcap, `swap_socketcan_header`).

use super::entry::{Entry, Source};
use motord_bus::{Content, Duration, ErrorFrame, Format, Frame, FrameId, Unsupported};
use pcap_parser::traits::PcapNGPacketBlock;
use pcap_parser::{Block, InterfaceDescriptionBlock, Linktype, PcapBlockOwned, PcapError, create_reader};
use std::io::{self, Read};

/// Longest block of a capture. One of CAN has about 100 bytes.
const BLOCK_BYTES_MAX: usize = 64 * 1024;
/// Most interfaces of a section. More are not described, and their packets refused.
const INTERFACES_MAX: usize = 1024;
/// First bytes of a capture: pcap of microseconds and of nanoseconds, of both byte orders, and pcapng.
const MAGICS: [[u8; 4]; 5] = [
    [0xD4, 0xC3, 0xB2, 0xA1],
    [0xA1, 0xB2, 0xC3, 0xD4],
    [0x4D, 0x3C, 0xB2, 0xA1],
    [0xA1, 0xB2, 0x3C, 0x4D],
    [0x0A, 0x0D, 0x0D, 0x0A],
];
/// `CAN_EFF_FLAG`, `CAN_RTR_FLAG` and `CAN_ERR_FLAG` of `linux/can.h`.
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
/// Flags of CAN FD: BRS, ESI, and that the frame is CAN FD.
const BRS: u8 = 1;
const ESI: u8 = 2;
const FDF: u8 = 4;
/// `ETH_P_CAN` and `ETH_P_CANFD`.
const PROTOCOLS: [[u8; 2]; 2] = [[0, 0x0C], [0, 0x0D]];
/// `LINKTYPE_CAN_SOCKETCAN`, which the library does not name.
const CAN_SOCKETCAN: Linktype = Linktype(227);

/// Reason for which a capture, or a packet of it, cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum InvalidCapture {
    #[error("link type {0} has no CAN frames: capture a CAN interface")]
    LinkType(i32),
    #[error("the packet is no frame: it ends early, or its interface is not described")]
    Packet,
    #[error("the capture is damaged from here on")]
    Damaged,
    #[error("the capture ends inside a packet")]
    Ends,
}

/// Returns `true` when a file that begins with `bytes` is a capture.
pub(crate) fn is_capture(bytes: &[u8]) -> bool {
    bytes.first_chunk().is_some_and(|first| MAGICS.contains(first))
}

/// Calls `each` with the number of each packet, from 1 on, and its frame. Packets of other protocols are skipped.
/// Memory is bounded.
///
/// # Errors
///
/// Those of `input` and of `each`.
pub(crate) fn read(
    input: impl Read + Send,
    mut each: impl FnMut(u64, Result<Entry<'_>, InvalidCapture>) -> io::Result<()>,
) -> io::Result<()> {
    let mut capture = Capture::default();
    let mut reader = match create_reader(BLOCK_BYTES_MAX, input) {
        Ok(reader) => reader,
        Err(PcapError::ReadError) => return Err(io::Error::other("the capture cannot be read")),
        Err(_) => return each(0, Err(InvalidCapture::Damaged)),
    };
    loop {
        let used = match reader.next() {
            Ok((used, block)) => {
                let number = capture.packets + 1;
                if let Some(entry) = capture.block(&block) {
                    each(number, entry)?;
                }
                Some(used)
            }
            Err(PcapError::Eof) => return Ok(()),
            Err(PcapError::Incomplete(_)) => None,
            Err(PcapError::UnexpectedEof) => return each(capture.packets + 1, Err(InvalidCapture::Ends)),
            Err(_) => return each(capture.packets + 1, Err(InvalidCapture::Damaged)),
        };
        match used {
            Some(used) => reader.consume(used),
            None => {
                let before = (reader.data().len(), reader.reader_exhausted());
                reader.refill().map_err(|_| io::Error::other("the capture cannot be read"))?;
                // Nothing arrived, and no end either.
                if before == (reader.data().len(), reader.reader_exhausted()) {
                    return each(capture.packets + 1, Err(InvalidCapture::Ends));
                }
            }
        }
    }
}

/// The interfaces and the count of packets so far.
#[derive(Debug, Default)]
struct Capture {
    interfaces: Vec<Interface>,
    /// Byte order of the machine that captured.
    order: ByteOrder,
    /// Nanoseconds of a unit of the fraction of a pcap.
    fraction: u32,
    packets: u64,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
enum ByteOrder {
    #[default]
    Little,
    Big,
}

impl ByteOrder {
    const fn of(is_big: bool) -> Self {
        if is_big { Self::Big } else { Self::Little }
    }
}

#[derive(Debug)]
struct Interface {
    link: Linktype,
    /// Only pcapng has names.
    name: Option<String>,
    /// Units of a time in a second, and seconds that are added.
    resolution: u64,
    offset: i64,
}

impl Capture {
    /// Reads a block. `None` for one without a frame.
    fn block<'a>(&'a mut self, block: &PcapBlockOwned<'_>) -> Option<Result<Entry<'a>, InvalidCapture>> {
        match block {
            PcapBlockOwned::LegacyHeader(header) => {
                self.fraction = if header.is_nanosecond_precision() { 1 } else { 1000 };
                self.order = ByteOrder::of(header.is_bigendian());
                let link = header.network;
                self.interfaces = vec![Interface { link, name: None, resolution: 1, offset: 0 }];
                None
            }
            PcapBlockOwned::Legacy(packet) => {
                let nanos = u64::from(packet.ts_usec) * u64::from(self.fraction);
                let at = Duration::from_secs(packet.ts_sec.into()) + Duration::from_nanos(nanos);
                self.packet(0, |_| Some(at), packet.data)
            }
            PcapBlockOwned::NG(Block::SectionHeader(section)) => {
                self.order = ByteOrder::of(section.big_endian());
                self.interfaces.clear();
                None
            }
            PcapBlockOwned::NG(Block::InterfaceDescription(interface)) => {
                self.describe(interface);
                None
            }
            PcapBlockOwned::NG(Block::EnhancedPacket(packet)) => {
                let ticks = u64::from(packet.ts_high) << 32 | u64::from(packet.ts_low);
                self.packet(packet.if_id, |interface| interface.at(ticks), packet.packet_data())
            }
            PcapBlockOwned::NG(Block::SimplePacket(packet)) => self.packet(0, |_| None, packet.packet_data()),
            PcapBlockOwned::NG(_) => None,
        }
    }

    fn describe(&mut self, block: &InterfaceDescriptionBlock<'_>) {
        if self.interfaces.len() < INTERFACES_MAX {
            self.interfaces.push(Interface {
                link: block.linktype,
                name: block.if_name().and_then(Result::ok).map(str::to_owned),
                resolution: block.ts_resolution().unwrap_or(1_000_000),
                offset: block.ts_offset(),
            });
        }
    }

    fn packet<'a>(
        &'a mut self,
        index: u32,
        at: impl Fn(&Interface) -> Option<Duration>,
        data: &[u8],
    ) -> Option<Result<Entry<'a>, InvalidCapture>> {
        self.packets += 1;
        let Some(interface) = self.interfaces.get(index as usize) else {
            return Some(Err(InvalidCapture::Packet));
        };
        let content = interface.content(data, self.order)?;
        let source = match &interface.name {
            _ if interface.is_cooked() => Source::Any,
            Some(name) => Source::Interface(name),
            None => Source::Channel(index.saturating_add(1)),
        };
        Some(content.map(|content| Entry { at: at(interface), source, content }))
    }
}

impl Interface {
    /// The time of `ticks`, since 1970.
    fn at(&self, ticks: u64) -> Option<Duration> {
        let (whole, rest) = (ticks.checked_div(self.resolution)?, ticks.checked_rem(self.resolution)?);
        let nanos = u128::from(rest) * 1_000_000_000 / u128::from(self.resolution);
        Some(Duration::new(whole.checked_add_signed(self.offset)?, u32::try_from(nanos).ok()?))
    }

    /// Returns `true` where packets of all interfaces have one description.
    fn is_cooked(&self) -> bool {
        matches!(self.link, Linktype::LINUX_SLL | Linktype::LINUX_SLL2)
    }

    /// The frame in a packet. `None` for another protocol.
    fn content(&self, data: &[u8], order: ByteOrder) -> Option<Result<Content, InvalidCapture>> {
        // Where the protocol is in the header of a cooked packet, and where that header ends.
        let (protocol, end) = match self.link {
            CAN_SOCKETCAN => return Some(socketcan(data, ByteOrder::Big, false)),
            Linktype::LINUX_SLL => (14, 16),
            Linktype::LINUX_SLL2 => (0, 20),
            Linktype(other) => return Some(Err(InvalidCapture::LinkType(other))),
        };
        let Some((header, frame)) = data.split_at_checked(end) else {
            return Some(Err(InvalidCapture::Packet));
        };
        let protocol = header.get(protocol..protocol + 2)?;
        PROTOCOLS
            .iter()
            .any(|known| known == protocol)
            .then(|| socketcan(frame, order, protocol == PROTOCOLS[1]))
    }
}

/// Reads a frame as SocketCAN has it, with its id in this byte order.
fn socketcan(data: &[u8], order: ByteOrder, is_fd: bool) -> Result<Content, InvalidCapture> {
    let &[id0, id1, id2, id3, length, flags, _, _, ref rest @ ..] = data else {
        return Err(InvalidCapture::Packet);
    };
    let id = [id0, id1, id2, id3];
    let word = match order {
        ByteOrder::Little => u32::from_le_bytes(id),
        ByteOrder::Big => u32::from_be_bytes(id),
    };
    let payload = rest.get(..usize::from(length)).ok_or(InvalidCapture::Packet)?;
    if word & ERROR != 0 {
        let data = payload.first_chunk().copied().unwrap_or_default();
        return Ok(Content::Error(ErrorFrame { class: word & !(EXTENDED | REMOTE | ERROR), data }));
    }
    if word & REMOTE != 0 {
        return Ok(Content::Unsupported(Unsupported::Remote));
    }
    let id = if word & EXTENDED != 0 {
        FrameId::extended(word & !EXTENDED)
    } else {
        u16::try_from(word).ok().and_then(FrameId::new)
    };
    let is_fd = is_fd || flags & FDF != 0 || payload.len() > Frame::CLASSIC_LEN_MAX;
    let fd = Format::Fd { switches_rate: flags & BRS != 0, error_passive: flags & ESI != 0 };
    let format = if is_fd { fd } else { Format::Classic };
    let frame = Frame::with_format(id.ok_or(InvalidCapture::Packet)?, format, payload);
    Ok(frame.map_or(Content::Unsupported(Unsupported::Length), Content::Frame))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Read = (u64, Result<(Option<Duration>, String, Content), InvalidCapture>);

    fn entries(bytes: &[u8]) -> Vec<Read> {
        let mut entries = Vec::new();
        let outcome = read(bytes, |number, entry| {
            let plain = entry.map(|entry| (entry.at, format!("{:?}", entry.source), entry.content));
            entries.push((number, plain));
            Ok(())
        });
        assert!(outcome.is_ok());
        entries
    }

    /// A frame 044#2A36.
    const PACKET: [u8; 10] = [0, 0, 0, 0x44, 2, 0, 0, 0, 0x2A, 0x36];

    fn content() -> Content {
        Content::Frame(Frame::new(FrameId::from(0x44), &[0x2A, 0x36]).unwrap())
    }

    fn pcap(link: u32, packets: &[&[u8]]) -> Vec<u8> {
        let mut bytes = [0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0].to_vec();
        for word in [0, 0, 65535, link] {
            bytes.extend(u32::to_le_bytes(word));
        }
        for packet in packets {
            for word in [1_700_000_000, 250_000, packet.len() as u32, packet.len() as u32] {
                bytes.extend(u32::to_le_bytes(word));
            }
            bytes.extend(*packet);
        }
        bytes
    }

    fn block(kind: u32, body: &[u8]) -> Vec<u8> {
        let length = (body.len() as u32 + 12).to_le_bytes();
        [&kind.to_le_bytes()[..], &length, body, &length].concat()
    }

    /// A capture of one packet of an interface can1, at 1 700 000 000.25 s.
    fn pcapng() -> Vec<u8> {
        let section = [&[0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0][..], &[0xFF; 8]].concat();
        let interface = [&[227, 0, 0, 0][..], &[0; 4], &[2, 0, 4, 0], b"can1", &[0; 4]].concat();
        let ticks = 1_700_000_000_250_000_u64;
        let mut packet = 0_u32.to_le_bytes().to_vec();
        for word in [(ticks >> 32) as u32, ticks as u32, 10, 10] {
            packet.extend(word.to_le_bytes());
        }
        packet.extend([&PACKET[..], &[0; 2]].concat());
        [block(0x0A0D_0D0A, &section), block(1, &interface), block(6, &packet)].concat()
    }

    #[test]
    fn captures_of_both_formats_are_read() {
        let at = Some(Duration::from_millis(1_700_000_000_250));
        let of_channel = |content| (at, "Channel(1)".into(), content);
        assert_eq!(entries(&pcap(227, &[&PACKET])), [(1, Ok(of_channel(content())))]);
        let of_name = (at, "Interface(\"can1\")".into(), content());
        assert_eq!(entries(&pcapng()), [(1, Ok(of_name))]);
        assert!(is_capture(&pcap(227, &[])) && is_capture(&pcapng()) && !is_capture(b"(1.0"));
    }

    /// Packets of `tcpdump -i any` (4.99, on x86_64) for `cansend vcan0 044#2A36`, of either link type.
    const COOKED: [u8; 32] = [
        0, 0, 0, 1, 1, 0x18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x0C, 0x44, 0, 0, 0, 2, 0, 0, 0, 0x2A, 0x36, 0, 0, 0,
        0, 0, 0,
    ];
    const COOKED_2: [u8; 36] = [
        0, 0x0C, 0, 0, 0, 0, 0, 4, 1, 0x18, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x44, 0, 0, 0, 2, 0, 0, 0, 0x2A,
        0x36, 0, 0, 0, 0, 0, 0,
    ];

    #[test]
    fn cooked_captures_have_ids_of_their_machine() {
        let of = |link, packets: &[&[u8]]| entries(&pcap(link, packets));
        let read = |number| {
            let at = Some(Duration::from_millis(1_700_000_000_250));
            [(number, Ok((at, "Any".into(), content())))]
        };
        let other = [&[0; 14][..], &[8, 0], &[0x45; 20]].concat();
        assert_eq!(of(113, &[&other, &COOKED]), read(2));
        assert_eq!(of(276, &[&COOKED_2]), read(1));
        let of_big_endian = [&COOKED[..16], &PACKET].concat();
        let interface = Interface { link: Linktype::LINUX_SLL, name: None, resolution: 1, offset: 0 };
        assert_eq!(interface.content(&of_big_endian, ByteOrder::Big), Some(Ok(content())));
    }

    #[test]
    fn special_frames_of_captures_are_named() {
        let of = |packet: &[u8]| entries(&pcap(227, &[packet])).remove(0).1.map(|(_, _, content)| content);
        let extended = Frame::new(FrameId::extended(0x44).unwrap(), &[1]).unwrap();
        assert_eq!(of(&[0x80, 0, 0, 0x44, 1, 0, 0, 0, 1]), Ok(Content::Frame(extended)));
        assert_eq!(of(&[0x40, 0, 0, 0x44, 0, 0, 0, 0]), Ok(Content::Unsupported(Unsupported::Remote)));
        let off = ErrorFrame { class: ErrorFrame::BUS_OFF, data: [0; 8] };
        assert_eq!(of(&[&[0x20, 0, 0, 0x40, 8, 0, 0, 0][..], &[0; 8]].concat()), Ok(Content::Error(off)));
        let fd = Frame::with_format(FrameId::from(0x44), Format::FD_BRS, &[7]).unwrap();
        assert_eq!(of(&[0, 0, 0, 0x44, 1, 5, 0, 0, 7]), Ok(Content::Frame(fd)));
        assert_eq!(of(&PACKET[..9]), Err(InvalidCapture::Packet));
        assert_eq!(entries(&pcap(1, &[&PACKET])), [(1, Err(InvalidCapture::LinkType(1)))]);
    }

    #[test]
    fn cut_capture_is_read_up_to_its_end() {
        let whole = pcap(227, &[&PACKET, &PACKET]);
        let cut = entries(&whole[..whole.len() - 1]);
        assert!(cut[0].1.is_ok());
        assert_eq!(cut[1..], [(2, Err(InvalidCapture::Ends))]);
        let huge = [&pcap(227, &[])[..], &[0xFF; 100_000]].concat();
        assert_eq!(entries(&huge), [(1, Err(InvalidCapture::Damaged))]);
    }

    proptest! {
        #[test]
        fn damaged_captures_do_not_panic(
            is_new in any::<bool>(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8),
            tail in prop::collection::vec(any::<u8>(), 0..80),
        ) {
            let mut bytes = if is_new { pcapng() } else { pcap(227, &[&PACKET, &PACKET]) };
            for (index, byte) in changes {
                let position = index.index(bytes.len());
                bytes[position] = byte;
            }
            bytes.extend(tail);
            let _read = entries(&bytes);
        }
    }
}
