//! The `unsafe` code that iceoryx2 requires: messages as payloads, a lock for ports, and samples that are partly written.

use core::fmt::Debug;
use core::mem::MaybeUninit;
use core::ops::Deref;
use core::ptr::{NonNull, drop_in_place};
use iceoryx2::prelude::ZeroCopySend;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::Service;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::arc_sync_policy::{ArcSyncPolicy, ArcSyncPolicyCreationError, LockGuard};
use motord_shared::message::Message;
use parking_lot::{ReentrantMutex, ReentrantMutexGuard};
use std::sync::Arc;

/// A message as iceoryx2 transfers it, under the name of its layout.
#[derive(Debug, Clone, Copy, Default)]
#[repr(transparent)]
pub struct Payload<T: Message>(pub T);

// SAFETY: only motord-shared implements `Message`, for `repr(C)` structures that consist of numbers: no pointer, no reference and no
// resource. The name carries the version of the layout.
unsafe impl<T: Message> ZeroCopySend for Payload<T> {
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

/// A lock around each port, and around each borrowed sample. It is reentrant, as iceoryx2 requires.
///
/// iceoryx2's own lock is a mutex of the C library, created and destroyed with every message
/// (`docs/adr/0032`).
#[derive(Debug)]
pub struct PortLock<T: Send + Debug + Abandonable>(Arc<ReentrantMutex<T>>);

impl<T: Send + Debug + Abandonable> Clone for PortLock<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T: Send + Debug + Abandonable> Abandonable for PortLock<T> {
    unsafe fn abandon_in_place(mut this: NonNull<Self>) {
        // SAFETY: the caller has the only reference to it.
        let Self(lock) = unsafe { this.as_mut() };
        match Arc::get_mut(lock) {
            // SAFETY: the value is unreachable from here on, because the lock is not used again.
            Some(alone) => unsafe { T::abandon_in_place(NonNull::from_mut(alone.get_mut())) },
            // SAFETY: the lock is neither used nor dropped after this.
            None => unsafe { drop_in_place(lock) },
        }
    }
}

impl<T: Send + Debug + Abandonable> ArcSyncPolicy<T> for PortLock<T> {
    type LockGuard<'parent>
        = PortGuard<'parent, T>
    where
        Self: 'parent,
        T: 'parent;

    fn new(value: T) -> Result<Self, ArcSyncPolicyCreationError> {
        Ok(Self(Arc::new(ReentrantMutex::new(value))))
    }

    fn lock(&self) -> Self::LockGuard<'_> {
        PortGuard(self.0.lock())
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

/// A message borrowed from a port and not sent yet.
pub(crate) struct Lent<S: Service, T: Message>(SampleMutUninit<S, MaybeUninit<Payload<T>>, ()>);

impl<S: Service, T: Message> Debug for Lent<S, T> {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("Lent")
    }
}

impl<S: Service, T: Message> Lent<S, T> {
    pub(crate) fn new(sample: SampleMutUninit<S, MaybeUninit<Payload<T>>, ()>) -> Self {
        Self(sample)
    }

    /// Returns the message for changes: an earlier message of the same port, or zeros.
    pub(crate) fn message(&mut self) -> &mut T {
        // SAFETY: the memory of a port is a file. It is zeros when it is created, and only samples
        // of this type are written to it: its bytes are initialised. Any bytes are a `Message`: it
        // consists of numbers, without padding. No other code has a sample that is borrowed and not
        // sent.
        let Payload(message) = unsafe { self.0.payload_mut().assume_init_mut() };
        message
    }

    /// Returns the sample, to be sent.
    pub(crate) fn sample(self) -> SampleMut<S, Payload<T>, ()> {
        // SAFETY: as above.
        unsafe { self.0.assume_init() }
    }
}
