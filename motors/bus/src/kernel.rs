//! `sendmmsg` and `recvmmsg`, and requests to serial ports. All `unsafe` of this crate is in this
//! file.
//!
//! The safe wrappers of nix 0.31 are not sufficient:
//! - nix has none for these requests to serial ports.
//! - Its `MultiHeaders` cannot be sent to another thread.
//! - Its `recvmmsg` does not restore the length of the control buffers after a call has shortened
//!   it, so receive stamps would be cut off.
//!
//! The C library's `sendmmsg` and `recvmmsg` are cancellation points of a thread. The cancellation
//! takes more instructions than the rest of the call, so this file makes these two system calls
//! directly.

use core::cell::Cell;
use core::ptr;
use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};

use nix::errno::Errno;

/// Bytes of the largest frame that a raw socket delivers (CAN FD).
pub(crate) const FRAME_BYTES: usize = size_of::<libc::canfd_frame>();
/// Bytes of a classic frame.
pub(crate) const CLASSIC_BYTES: usize = size_of::<libc::can_frame>();
/// `CMSG_SPACE` of `SCM_TIMESTAMPNS` (a time of 16 bytes) and of `SO_RXQ_OVFL` (4 bytes).
const CONTROL_BYTES: usize = (16 + 16) + (16 + 8);
const WORD: usize = size_of::<u64>();

/// Returns the kernel's error code of an error of the standard library.
pub(crate) fn errno(error: &io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or(libc::EIO))
}

/// Frames and control buffers are arrays of words, because `cmsghdr` has their alignment.
type Frame = [u64; FRAME_BYTES / WORD];
type Control = [u64; CONTROL_BYTES / WORD];

/// Message headers for the kernel, with the memory that they point to. Built once, used for every
/// call.
///
/// The memory consists of [`Cell`]s. The kernel writes to it through the pointers in the headers,
/// and this code reads it by value. No `Vec` here ever grows, so no memory moves when the batch
/// does.
pub(crate) struct Batch {
    frames: Vec<Cell<Frame>>,
    controls: Vec<Cell<Control>>,
    /// Only the kernel reads them.
    _vectors: Vec<libc::iovec>,
    headers: Vec<libc::mmsghdr>,
    /// Number of headers that the kernel has written to since they were prepared to receive.
    used: usize,
}

// SAFETY: the pointers that make `Batch` not `Send` point into the heap blocks of its own `Vec`s.
// They move with the batch, and no other code has them.
unsafe impl Send for Batch {}

impl Batch {
    /// Returns a batch of up to `capacity` messages. To send, each has exactly `frame_bytes` bytes;
    /// to receive, at most as many.
    pub(crate) fn new(capacity: usize, frame_bytes: usize) -> Self {
        let frames = vec![Cell::new(Frame::default()); capacity];
        let controls = vec![Cell::new(Control::default()); capacity];
        let iov_len = frame_bytes.min(FRAME_BYTES);
        let mut vectors: Vec<_> =
            frames.iter().map(|frame| libc::iovec { iov_base: frame.as_ptr().cast(), iov_len }).collect();
        let first: *mut libc::iovec = vectors.as_mut_ptr();
        let vectors_of = (0..capacity).map(|index| first.wrapping_add(index));
        let headers = vectors_of.zip(&controls).map(|(vector, control)| header(vector, control)).collect();
        Self { frames, controls, _vectors: vectors, headers, used: capacity }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.headers.len()
    }

    /// Returns the bytes of message `index` for the next [`send`](Self::send).
    #[inline]
    pub(crate) fn put(&mut self, index: usize, frame: [u8; CLASSIC_BYTES]) {
        let (words, _) = frame.as_chunks();
        let cells = self.frames[index].as_array_of_cells();
        cells.iter().zip(words).for_each(|(cell, word)| cell.set(u64::from_ne_bytes(*word)));
    }

    /// Sends the first `count` messages, and returns how many the kernel took. Never blocks; one
    /// system call.
    pub(crate) fn send(&mut self, socket: BorrowedFd<'_>, count: usize) -> Result<usize, Errno> {
        let count = count.min(self.capacity());
        // SAFETY: `headers` holds at least `count` headers. Each points to one initialised iovec,
        // and that to `iov_len` initialised bytes of `frames`, all alive and unmoved during the
        // life of `self`. There are no control bytes: their length is 0. The kernel writes only
        // `msg_len`, in memory that is borrowed mutably here.
        let sent = unsafe {
            libc::syscall(
                libc::SYS_sendmmsg,
                socket.as_raw_fd(),
                self.headers.as_mut_ptr(),
                count,
                libc::MSG_DONTWAIT,
            )
        };
        Errno::result(sent).map(|sent| sent as usize)
    }

    /// Receives up to `limit` messages, and returns how many arrived. Never blocks; one system
    /// call.
    pub(crate) fn receive(&mut self, socket: BorrowedFd<'_>, limit: usize) -> Result<usize, Errno> {
        let limit = limit.min(self.capacity());
        for header in self.headers.iter_mut().take(self.used) {
            header.msg_hdr.msg_controllen = CONTROL_BYTES;
        }
        // SAFETY: `headers` holds at least `limit` headers. Each points to one iovec, which points
        // to `iov_len` bytes of a cell in `frames`. Each also points to at most the `CONTROL_BYTES`
        // of a cell in `controls`. These are alive and unmoved during the life of `self`, and
        // writable behind a shared reference because they are cells. No reference into a cell
        // exists. Any bytes are valid for both types. No timeout is passed.
        let received = unsafe {
            libc::syscall(
                libc::SYS_recvmmsg,
                socket.as_raw_fd(),
                self.headers.as_mut_ptr(),
                limit,
                libc::MSG_DONTWAIT,
                ptr::null_mut::<libc::timespec>(),
            )
        };
        let received = Errno::result(received).map(|received| received as usize);
        // The kernel also writes to the header of the message that failed.
        self.used = received.map_or(1, |received| received + 1).min(self.capacity());
        received
    }

    /// Returns the first `count` messages of the last [`receive`](Self::receive). `count` must be
    /// at most the number that it returned.
    #[inline]
    pub(crate) fn messages(&self, count: usize) -> impl Iterator<Item = Message<'_>> {
        let memory = self.frames.iter().zip(&self.controls);
        self.headers[..count].iter().zip(memory).map(|(header, (frame, control))| {
            let words = header.msg_hdr.msg_controllen.min(CONTROL_BYTES) / WORD;
            Message {
                frame: frame.as_array_of_cells(),
                frame_bytes: (header.msg_len as usize).min(FRAME_BYTES),
                control: &control.as_array_of_cells()[..words],
            }
        })
    }
}

/// A header without control bytes. The kernel changes the length of the control buffer, but not its
/// address.
fn header(vector: *mut libc::iovec, control: &Cell<Control>) -> libc::mmsghdr {
    let msg_hdr = libc::msghdr {
        msg_name: ptr::null_mut(),
        msg_namelen: 0,
        msg_iov: vector,
        msg_iovlen: 1,
        msg_control: control.as_ptr().cast(),
        msg_controllen: 0,
        msg_flags: 0,
    };
    libc::mmsghdr { msg_hdr, msg_len: 0 }
}

/// One received message, as the kernel wrote it.
pub(crate) struct Message<'a> {
    frame: &'a [Cell<u64>; FRAME_BYTES / WORD],
    frame_bytes: usize,
    control: &'a [Cell<u64>],
}

impl<'a> Message<'a> {
    /// Returns the number of bytes of the frame.
    pub(crate) const fn frame_bytes(&self) -> usize {
        self.frame_bytes
    }

    /// Returns the first bytes of the frame, which are all bytes of a classic frame.
    #[inline]
    pub(crate) fn classic(&self) -> [u8; CLASSIC_BYTES] {
        let [first, second, ..] = self.frame;
        let mut bytes = [0; CLASSIC_BYTES];
        bytes[..WORD].copy_from_slice(&first.get().to_ne_bytes());
        bytes[WORD..].copy_from_slice(&second.get().to_ne_bytes());
        bytes
    }

    /// Returns the control messages, one after another.
    pub(crate) const fn control(&self) -> &'a [Cell<u64>] {
        self.control
    }
}

/// Returns the number of bytes written to a serial port that have not left it (`TIOCOUTQ`). Always
/// 0 for a pseudo terminal. Never blocks; one system call.
///
/// # Errors
///
/// Those of the driver; `EIO` for an unplugged adapter.
pub(crate) fn unsent(port: BorrowedFd<'_>) -> Result<usize, Errno> {
    let mut bytes: libc::c_int = 0;
    // SAFETY: `TIOCOUTQ` writes one int to the given address, which is that of a live int.
    let result = unsafe { libc::ioctl(port.as_raw_fd(), libc::TIOCOUTQ, &raw mut bytes) };
    Errno::result(result).map(|_| usize::try_from(bytes).unwrap_or(0))
}

/// `struct serial_struct` of `linux/serial.h`.
#[derive(Default)]
#[repr(C)]
struct SerialStruct {
    kind: i32,
    line: i32,
    port: u32,
    irq: i32,
    flags: i32,
    xmit_fifo_size: i32,
    custom_divisor: i32,
    baud_base: i32,
    close_delay: u16,
    io_type: u8,
    reserved: u8,
    hub6: i32,
    closing_wait: u16,
    closing_wait2: u16,
    iomem_base: usize,
    iomem_reg_shift: u16,
    port_high: u32,
    iomap_base: usize,
}

/// `ASYNC_LOW_LATENCY` of `linux/tty_flags.h`.
const LOW_LATENCY: i32 = 1 << 13;

/// Requests the driver to deliver bytes without delay (`ASYNC_LOW_LATENCY`). Otherwise an FTDI
/// adapter waits up to 16 ms for more bytes.
///
/// # Errors
///
/// `ENOTTY` when the driver has no such mode.
pub(crate) fn set_low_latency(port: BorrowedFd<'_>) -> Result<(), Errno> {
    let mut serial = SerialStruct::default();
    // SAFETY: `TIOCGSERIAL` writes one `serial_struct` to the given address, which is that of a
    // live one.
    let result = unsafe { libc::ioctl(port.as_raw_fd(), libc::TIOCGSERIAL, &raw mut serial) };
    Errno::result(result)?;
    if serial.flags & LOW_LATENCY != 0 {
        return Ok(());
    }
    serial.flags |= LOW_LATENCY;
    // SAFETY: `TIOCSSERIAL` reads one `serial_struct` from the given address, which is that of a
    // live one.
    let result = unsafe { libc::ioctl(port.as_raw_fd(), libc::TIOCSSERIAL, &raw const serial) };
    Errno::result(result).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::AsFd;
    use std::os::unix::net::UnixDatagram;

    fn message(first: u8) -> [u8; CLASSIC_BYTES] {
        let mut frame = [0; CLASSIC_BYTES];
        frame[0] = first;
        frame
    }

    #[test]
    fn batch_carries_messages_in_order_up_to_size() {
        let (near, far) = UnixDatagram::pair().unwrap();
        let (mut outgoing, mut incoming) = (Batch::new(4, 16), Batch::new(4, FRAME_BYTES));
        for index in 0..4 {
            outgoing.put(index, message(index as u8 + 1));
        }
        assert_eq!(outgoing.send(near.as_fd(), 9), Ok(4), "a batch never exceeds its memory");
        let mut incoming_moved = std::thread::spawn(move || {
            assert_eq!(incoming.receive(far.as_fd(), 3), Ok(3));
            assert_eq!(incoming.messages(3).count(), 3);
            incoming.messages(3).zip(1..).for_each(|(message, first)| {
                assert_eq!((message.frame_bytes(), message.classic()[0]), (16, first));
                assert!(message.control().is_empty());
            });
            (incoming, far)
        })
        .join()
        .unwrap();
        assert_eq!(incoming_moved.0.receive(incoming_moved.1.as_fd(), 3), Ok(1));
        assert_eq!(incoming_moved.0.messages(1).map(|message| message.classic()[0]).collect::<Vec<_>>(), [4]);
        assert_eq!(incoming_moved.0.receive(incoming_moved.1.as_fd(), 3), Err(Errno::EAGAIN));
    }

    #[test]
    fn full_queue_accepts_part_without_blocking() {
        let (near, _far) = UnixDatagram::pair().unwrap();
        let mut outgoing = Batch::new(64, 16);
        let refused = (0..100).find_map(|_| outgoing.send(near.as_fd(), 64).err());
        assert_eq!(refused, Some(Errno::EAGAIN));
    }
}
