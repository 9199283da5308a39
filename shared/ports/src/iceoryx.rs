//! The `unsafe` code that iceoryx2 requires: messages as payloads, a lock for ports, and copies to
//! and from shared memory.

use core::fmt::Debug;
use core::marker::PhantomData;
use core::mem::{MaybeUninit, offset_of};
use core::ops::Deref;
use core::ptr::{NonNull, drop_in_place, null_mut};
use core::sync::atomic::{AtomicPtr, AtomicUsize, Ordering, fence};
use iceoryx2::prelude::{FileDescriptorBased, ZeroCopySend};
use iceoryx2::response_mut::ResponseMut;
use iceoryx2::response_mut_uninit::ResponseMutUninit;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::Service;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::arc_sync_policy::{ArcSyncPolicy, ArcSyncPolicyCreationError, LockGuard};
use motord_shared::limits::ANSWER_BYTES_MAX;
use motord_shared::message::{AdminAnswer, AdminReply, Message};
use motord_shared::plain::{Plain, Sparse};
use parking_lot::{ReentrantMutex, ReentrantMutexGuard};
use std::os::fd::BorrowedFd;

/// A message as iceoryx2 transfers it, under the name of its layout.
#[derive(Debug, Clone, Copy, Default)]
#[repr(transparent)]
pub struct Payload<T: Message>(pub T);

// SAFETY: only motord-shared implements `Message`, for `repr(C)` structures that consist of
// numbers: no pointer, no reference and no resource. The name carries the version of the layout.
unsafe impl<T: Message> ZeroCopySend for Payload<T> {
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

/// A lock around each port, and around each borrowed sample. It is reentrant, as iceoryx2 requires.
///
/// iceoryx2's own lock is a mutex of the C library, created and destroyed with every message
/// (`docs/adr/0032`). Memory for this one is used again: after the first messages, none allocates.
#[derive(Debug)]
pub struct PortLock<T: Send + Debug + Abandonable>(NonNull<Shared<T>>, PhantomData<Shared<T>>);

/// The shared part of the clones of a lock.
#[derive(Debug)]
struct Shared<T> {
    holders: AtomicUsize,
    content: ReentrantMutex<T>,
}

// SAFETY: as for an `Arc` of the lock, whose content only its holder reaches.
unsafe impl<T: Send + Debug + Abandonable> Send for PortLock<T> {}
// SAFETY: as above.
unsafe impl<T: Send + Debug + Abandonable> Sync for PortLock<T> {}

impl<T: Send + Debug + Abandonable> PortLock<T> {
    fn shared(&self) -> &Shared<T> {
        // SAFETY: the memory lives as long as one of its holders.
        unsafe { self.0.as_ref() }
    }
}

impl<T: Send + Debug + Abandonable> Clone for PortLock<T> {
    fn clone(&self) -> Self {
        self.shared().holders.fetch_add(1, Ordering::Relaxed);
        Self(self.0, PhantomData)
    }
}

impl<T: Send + Debug + Abandonable> Drop for PortLock<T> {
    fn drop(&mut self) {
        if self.shared().holders.fetch_sub(1, Ordering::Release) > 1 {
            return;
        }
        // Makes the writes of the other holders visible.
        fence(Ordering::Acquire);
        // SAFETY: no other holder is left, and this one does not use it again.
        unsafe { drop_in_place(self.0.as_ptr()) };
        Block::free(self.0);
    }
}

impl<T: Send + Debug + Abandonable> Abandonable for PortLock<T> {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller has the only reference to it.
        let lock = unsafe { this.as_mut() };
        if lock.shared().holders.load(Ordering::Acquire) > 1 {
            // SAFETY: the lock is neither used nor dropped after this.
            unsafe { drop_in_place(lock) };
            return;
        }
        // SAFETY: there is no other holder.
        let shared = unsafe { lock.0.as_mut() };
        // SAFETY: the value is unreachable from here on, because the lock is not used again.
        unsafe { T::abandon_in_place(NonNull::from_mut(shared.content.get_mut())) };
    }
}

impl<T: Send + Debug + Abandonable> ArcSyncPolicy<T> for PortLock<T> {
    type LockGuard<'parent>
        = PortGuard<'parent, T>
    where
        Self: 'parent,
        T: 'parent;

    fn new(value: T) -> Result<Self, ArcSyncPolicyCreationError> {
        let shared = Shared { holders: AtomicUsize::new(1), content: ReentrantMutex::new(value) };
        Ok(Self(Block::filled(shared), PhantomData))
    }

    fn lock(&self) -> Self::LockGuard<'_> {
        PortGuard(self.shared().content.lock())
    }
}

/// Memory for the lock of a borrowed sample, which is as large for every port.
#[repr(C, align(64))]
struct Block([MaybeUninit<u8>; 192]);

/// Blocks to use again. A process borrows a sample of each of its ports at a time at most.
static BLOCKS: [AtomicPtr<Block>; 8] = [const { AtomicPtr::new(null_mut()) }; 8];

impl Block {
    const fn holds<T>() -> bool {
        size_of::<T>() <= size_of::<Self>() && align_of::<T>() <= align_of::<Self>()
    }

    /// Moves a value to a block, or to memory of its own where it does not fit. Takes no lock.
    fn filled<T>(value: T) -> NonNull<T> {
        if !Self::holds::<T>() {
            return NonNull::from_mut(Box::leak(Box::new(value)));
        }
        let used = BLOCKS.iter().map(|slot| slot.swap(null_mut(), Ordering::Acquire)).find_map(NonNull::new);
        let block = used
            .unwrap_or_else(|| NonNull::from_mut(Box::leak(Box::new(Self([MaybeUninit::uninit(); 192])))));
        // SAFETY: a block of this caller, which is large enough and aligned.
        unsafe { block.cast::<T>().write(value) };
        block.cast()
    }

    /// Keeps or frees the memory of [`filled`](Self::filled), whose value was dropped. Takes no
    /// lock.
    fn free<T>(value: NonNull<T>) {
        if !Self::holds::<T>() {
            // SAFETY: `filled` made it of a box, whose content needs no drop any more.
            drop(unsafe { Box::from_raw(value.cast::<MaybeUninit<T>>().as_ptr()) });
            return;
        }
        let block = value.cast::<Self>().as_ptr();
        let keep = |slot: &AtomicPtr<Self>| {
            slot.compare_exchange(null_mut(), block, Ordering::Release, Ordering::Relaxed).is_ok()
        };
        if !BLOCKS.iter().any(keep) {
            // SAFETY: `filled` made it of a box, and no place keeps it.
            drop(unsafe { Box::from_raw(block) });
        }
    }
}

/// Holds a [`PortLock`] for its lifetime.
#[derive(Debug)]
pub struct PortGuard<'parent, T: Debug>(ReentrantMutexGuard<'parent, T>);

impl<T: Debug> Deref for PortGuard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}

impl<'parent, T: Send + Debug + Abandonable> LockGuard<'parent, T> for PortGuard<'parent, T> {}

/// A message in memory that other processes may write at any time: every member of the group maps
/// it.
///
/// Nothing here makes a reference to the message. A number that decides how much is copied is read
/// once, volatile, and limited to its array: no later change of it moves a bound. All other bytes
/// are copied as they are, and every value of them is a `Message`.
///
/// Two risks remain. iceoryx2 returns references to its payloads, from which this type takes the
/// address. A copy that another process disturbs is a data race by the words of the language. It is
/// a copy of bytes in a call or in a loop, from which the compiler draws no conclusion, and it may
/// hold parts of two messages. iceoryx2's own headers and queues are in the same memory.
struct Exposed<T>(NonNull<T>);

/// Arrays of a message.
const ARRAYS_MAX: usize = 5;

impl<T: Sparse> Exposed<T> {
    /// Returns the number of used entries of each array, as stored, and limited to the array.
    fn counts(&self) -> [(u32, usize); ARRAYS_MAX] {
        const { assert!(T::ARRAYS.len() <= ARRAYS_MAX) };
        let mut counts = [(0, 0); ARRAYS_MAX];
        for (count, array) in counts.iter_mut().zip(T::ARRAYS) {
            // SAFETY: the place of an aligned `u32` of the message.
            let stored = unsafe { self.byte(array.count).cast::<u32>().read_volatile() };
            *count = (stored, (stored as usize).min(array.most));
        }
        counts
    }

    fn byte(&self, offset: usize) -> *mut u8 {
        self.0.as_ptr().cast::<u8>().wrapping_add(offset)
    }

    /// Copies bytes to the same place of `to`, another message.
    fn copy_bytes(&self, to: &Self, offset: usize, length: usize) {
        let length = length.min(size_of::<T>().saturating_sub(offset));
        // SAFETY: the bytes are in both messages, which differ.
        unsafe { self.byte(offset).copy_to_nonoverlapping(to.byte(offset), length) };
    }

    /// Writes a field of the message at its place.
    fn put<F: Plain>(&self, offset: usize, field: F) {
        debug_assert!(offset + size_of::<F>() <= size_of::<T>());
        // SAFETY: the place of a field of this type.
        unsafe { self.byte(offset).cast::<F>().write(field) };
    }

    fn clear_bytes(&self, offset: usize, length: usize) {
        let length = length.min(size_of::<T>().saturating_sub(offset));
        // SAFETY: the bytes are in the message, and may be zero.
        unsafe { self.byte(offset).write_bytes(0, length) };
    }

    /// Copies the used part to `to`, and clears the entries that only `to` used. `counts` are the
    /// entries used here. Most of a message is unused: to copy it would waste time.
    fn copy_to(&self, to: &Self, counts: &[(u32, usize); ARRAYS_MAX]) {
        let before = to.counts();
        let mut done = 0;
        for ((array, (_, now)), (_, before)) in T::ARRAYS.iter().zip(counts).zip(before) {
            self.copy_bytes(to, done, array.start - done);
            self.copy_bytes(to, array.start, now * array.entry);
            to.clear_bytes(array.start + now * array.entry, before.saturating_sub(*now) * array.entry);
            done = array.start + array.most * array.entry;
        }
        self.copy_bytes(to, done, size_of::<T>() - done);
    }

    /// Writes `message`.
    fn write(&mut self, message: &T) {
        let from = Self(NonNull::from_ref(message));
        from.copy_to(self, &from.counts());
    }

    /// Reads into `message`, whose counts are those by which entries were copied.
    fn read(&self, message: &mut T) {
        let (to, counts) = (Self(NonNull::from_mut(message)), self.counts());
        self.copy_to(&to, &counts);
        for (array, (stored, _)) in T::ARRAYS.iter().zip(counts) {
            // Another one may have been copied meanwhile.
            to.put(array.count, stored);
        }
    }

    /// Writes to the used cache lines of the arrays, so that the cache of this processor holds
    /// them. Destroys entries, and keeps their numbers.
    fn fetch(&mut self) {
        const LINE_BYTES: usize = 64;
        for (array, (_, used)) in T::ARRAYS.iter().zip(self.counts()) {
            for offset in (0..used * array.entry).step_by(LINE_BYTES) {
                // SAFETY: in the array.
                unsafe { self.byte(array.start + offset).write_volatile(0) };
            }
        }
        // SAFETY: the first byte of the message, and no count.
        unsafe { self.byte(0).write_volatile(0) };
    }
}

/// Returns the file descriptor of a port.
pub(crate) fn descriptor_of(port: &impl FileDescriptorBased) -> BorrowedFd<'_> {
    // SAFETY: it is borrowed, and not closed.
    let descriptor = unsafe { port.file_descriptor().native_handle() };
    // SAFETY: the port, borrowed as long, keeps it open.
    unsafe { BorrowedFd::borrow_raw(descriptor) }
}

/// Returns a copy of a message in shared memory: later changes by its sender do not reach it.
pub(crate) fn copied<T: Message>(payload: &Payload<T>) -> T {
    // SAFETY: the address of a message; every value of its bytes is one.
    unsafe { (&raw const payload.0).read_volatile() }
}

/// Reads the used part of a message in shared memory into `message`.
pub(crate) fn read<T: Sparse>(payload: &Payload<T>, message: &mut T) {
    Exposed(NonNull::from_ref(&payload.0)).read(message);
}

/// Writes `reply` and `text`, truncated to its array, to a borrowed answer, and returns it, to be
/// sent.
pub(crate) fn answered<S: Service>(
    mut answer: ResponseMutUninit<S, MaybeUninit<Payload<AdminAnswer>>, ()>,
    reply: AdminReply,
    text: &[u8],
) -> ResponseMut<S, Payload<AdminAnswer>, ()> {
    let message = Exposed::<AdminAnswer>(NonNull::from_mut(answer.payload_mut()).cast());
    let length = text.len().min(ANSWER_BYTES_MAX);
    message.put(offset_of!(AdminAnswer, reply), reply);
    message.put(offset_of!(AdminAnswer, length), length as u32);
    message.put(offset_of!(AdminAnswer, reserved), 0_u32);
    let to = message.byte(offset_of!(AdminAnswer, text));
    // SAFETY: the array is longer, and no text of this process is in it.
    unsafe { text.as_ptr().copy_to_nonoverlapping(to, length) };
    // SAFETY: as for a sample that is sent.
    unsafe { answer.assume_init() }
}

/// A message borrowed from a port and not sent yet. Its memory belongs to a file that other members
/// of the group may write: see [`Exposed`].
pub(crate) struct Lent<S: Service, T: Message>(SampleMutUninit<S, MaybeUninit<Payload<T>>, ()>);

impl<S: Service, T: Message> Debug for Lent<S, T> {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("Lent")
    }
}

impl<S: Service, T: Sparse> Lent<S, T> {
    pub(crate) fn new(sample: SampleMutUninit<S, MaybeUninit<Payload<T>>, ()>) -> Self {
        Self(sample)
    }

    /// Returns the message: an earlier one of the same port, or zeros.
    fn message(&mut self) -> Exposed<T> {
        Exposed(NonNull::from_mut(self.0.payload_mut()).cast())
    }

    /// Writes `message`.
    pub(crate) fn write(&mut self, message: &T) {
        self.message().write(message);
    }

    /// Brings the memory of the message into the cache of this processor, for
    /// [`write`](Self::write).
    pub(crate) fn fetch(&mut self) {
        self.message().fetch();
    }

    /// Returns the sample, to be sent.
    pub(crate) fn sample(self) -> SampleMut<S, Payload<T>, ()> {
        // SAFETY: the memory of a port is a file. It is zeros when it is created: its bytes are
        // initialised, whichever process wrote them since. Any bytes are a `Message`, which
        // consists of numbers without padding.
        unsafe { self.0.assume_init() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::limits::JOINTS_MAX;
    use motord_shared::message::JointSetpoint;
    use motord_shared::{SetpointMessage, StateMessage};
    use std::sync::atomic::{AtomicBool, AtomicU32};

    fn setpoints(joint_count: u32) -> SetpointMessage {
        let setpoint = JointSetpoint { position: 1.0, ..Default::default() };
        SetpointMessage { joint_count, cycle: 7, joints: [setpoint; JOINTS_MAX], ..Default::default() }
    }

    #[test]
    fn used_part_is_copied_and_rest_cleared() {
        let mut copy = SetpointMessage::default();
        for joint_count in [JOINTS_MAX as u32, 12, u32::MAX, 0, 3] {
            let mut expected = setpoints(joint_count);
            read(&Payload(expected), &mut copy);
            expected.joints[(joint_count as usize).min(JOINTS_MAX)..].fill(JointSetpoint::default());
            assert_eq!(copy, expected);
        }
        let mut state = StateMessage { joint_count: 3, bus_count: 2, boot_id: 5, ..Default::default() };
        (state.joints[2].missed, state.joints[3].missed, state.buses[1].lost) = (1, 1, 1);
        let mut copy = StateMessage { group_count: 2, ..Default::default() };
        copy.groups[1].lease = 1;
        read(&Payload(state), &mut copy);
        state.joints[3].missed = 0;
        assert!(copy == state);
    }

    /// Goal: a sender that changes a count while it is read gains nothing: as many entries are used
    /// as were copied.
    #[test]
    fn hostile_count_is_read_once() {
        let mut shared = setpoints(0);
        let message = NonNull::from_mut(&mut shared);
        let count = SetpointMessage::ARRAYS[0].count;
        let over = AtomicBool::new(false);
        let exposed = Exposed(message);
        // SAFETY: an aligned `u32`, and the test uses it in no other way.
        let hostile = unsafe { AtomicU32::from_ptr(exposed.byte(count).cast()) };
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    [3, u32::MAX, 64, 0].iter().for_each(|value| hostile.store(*value, Ordering::Relaxed));
                }
            });
            let mut copy = SetpointMessage::default();
            let agrees = (0..200_000).all(|_| {
                exposed.read(&mut copy);
                let (used, rest) = copy.joints.split_at((copy.joint_count as usize).min(JOINTS_MAX));
                used.iter().all(|joint| joint.position > 0.0)
                    && rest.iter().all(|joint| joint.position == 0.0)
            });
            over.store(true, Ordering::Relaxed);
            assert!(agrees, "{} entries", copy.joint_count);
        });
    }

    /// Counts its drops.
    #[derive(Debug)]
    struct Counted<const BYTES: usize>(&'static AtomicU32, [u8; BYTES]);

    impl<const BYTES: usize> Drop for Counted<BYTES> {
        fn drop(&mut self) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    impl<const BYTES: usize> Abandonable for Counted<BYTES> {
        unsafe fn abandon_in_place(_: NonNull<Self>) {}
    }

    fn use_locks<const BYTES: usize>(drops: &'static AtomicU32) {
        for _ in 0..2_000 {
            let locks = [(); 12].map(|()| PortLock::new(Counted::<BYTES>(drops, [7; BYTES])).unwrap());
            for lock in &locks {
                let (clone, held) = (lock.clone(), lock.lock());
                assert_eq!((held.1, clone.lock().1[0]), ([7; BYTES], 7));
            }
        }
    }

    #[test]
    fn threads_reuse_blocks_and_drop_each_once() {
        static SMALL: AtomicU32 = AtomicU32::new(0);
        static LARGE: AtomicU32 = AtomicU32::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| use_locks::<24>(&SMALL));
                scope.spawn(|| use_locks::<400>(&LARGE));
            }
        });
        assert_eq!([&SMALL, &LARGE].map(|drops| drops.load(Ordering::Relaxed)), [4 * 2_000 * 12; 2]);
    }

    #[test]
    fn fetched_message_keeps_its_counts() {
        let mut message = setpoints(5);
        let mut exposed = Exposed(NonNull::from_mut(&mut message));
        exposed.fetch();
        assert_eq!(exposed.counts()[0], (5, 5));
        exposed.write(&setpoints(2));
        let mut copy = setpoints(64);
        exposed.read(&mut copy);
        assert_eq!(copy.joints.iter().filter(|joint| joint.position > 0.0).count(), 2);
    }
}
