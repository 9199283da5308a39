//! The objects behind the pointers of a caller.

use crate::status::{Failure, Status, fail};
use motord_client::{Claim, Client, Creator, Error, ImuPublisher, State};
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};

/// An object with a mark by which a freed or foreign pointer is found, where its memory was not used again.
#[repr(C)]
struct Marked<T> {
    mark: AtomicU32,
    creator: Creator,
    body: T,
}

/// A kind of handle.
pub trait Handle: Sized {
    /// Its mark.
    const MARK: u32;
    /// Its name in messages.
    const NAME: &'static str;
}

/// A connection.
pub struct ClientHandle {
    pub(crate) client: Client,
    /// Names of joints, groups and IMUs, as the description had them at the connection.
    pub(crate) names: [Vec<CString>; 3],
}

/// A state of the caller; empty before the first. One thread uses it at a time.
pub struct StateHandle(pub(crate) Mutex<Option<State>>);

/// The ownership of a group; empty once it is released. One thread uses it at a time.
pub struct ClaimHandle(pub(crate) Mutex<Option<Claim>>);

/// The publisher of an external IMU. One thread uses it at a time.
pub struct PublisherHandle(pub(crate) Mutex<Option<ImuPublisher>>);

impl Handle for ClientHandle {
    const MARK: u32 = 0x6d6f_7401;
    const NAME: &'static str = "motord_client";
}

impl Handle for StateHandle {
    const MARK: u32 = 0x6d6f_7402;
    const NAME: &'static str = "motord_state";
}

impl Handle for ClaimHandle {
    const MARK: u32 = 0x6d6f_7403;
    const NAME: &'static str = "motord_claim";
}

impl Handle for PublisherHandle {
    const MARK: u32 = 0x6d6f_7404;
    const NAME: &'static str = "motord_imu_publisher";
}

/// Moves an object to the caller.
pub(crate) fn give<T: Handle>(body: T) -> *mut T {
    let marked =
        Box::into_raw(Box::new(Marked { mark: AtomicU32::new(T::MARK), creator: Creator::this(), body }));
    // SAFETY: a field of a box that was just made.
    unsafe { &raw mut (*marked).body }
}

/// A pointer that leads to no handle of its kind.
#[derive(Debug, Clone, Copy)]
enum Mistake {
    Null,
    Freed,
    Forked,
}

impl Mistake {
    fn explained<T: Handle>(self) -> Failure {
        let name = T::NAME;
        match self {
            Self::Null => {
                Failure::bad_argument(format!("this {name} is a null pointer, or no pointer to one"))
            }
            Self::Freed => Failure::bad_argument(format!("this {name} was freed, or is no {name}")),
            Self::Forked => Error::Forked.into(),
        }
    }
}

fn marked<T: Handle>(pointer: *mut T) -> Result<*mut Marked<T>, Mistake> {
    if pointer.is_null() || !pointer.is_aligned() {
        return Err(Mistake::Null);
    }
    let marked = pointer.wrapping_byte_sub(core::mem::offset_of!(Marked<T>, body)).cast::<Marked<T>>();
    // SAFETY: by the contract of the header the pointer is one of `give`.
    let mark = unsafe { (*marked).mark.load(Ordering::Relaxed) };
    if mark == T::MARK { Ok(marked) } else { Err(Mistake::Freed) }
}

/// Returns an object of the calling process.
fn own<T: Handle>(pointer: *mut T) -> Result<*mut Marked<T>, Mistake> {
    let marked = marked(pointer)?;
    // SAFETY: it has the mark of its kind.
    let creator = unsafe { (*marked).creator };
    creator.check().map_or(Err(Mistake::Forked), |()| Ok(marked))
}

/// Returns the object of the caller, also of one in a forked process; `None` for a pointer that leads to none. Async-signal-safe.
///
/// # Safety
///
/// As [`borrow`].
pub(crate) unsafe fn found<'a, T: Handle>(pointer: *mut T) -> Option<&'a T> {
    // SAFETY: it has the mark of its kind.
    marked(pointer).ok().map(|marked| unsafe { &(*marked).body })
}

/// Returns the object of the caller. In a forked process it is an error: a lock of the object may be held by a thread of the parent.
///
/// # Safety
///
/// The pointer is null, or was given by [`give`] and is freed by no other thread during `'a`. A freed pointer is an error where
/// its memory was not used again.
pub(crate) unsafe fn borrow<'a, T: Handle>(pointer: *mut T) -> Result<&'a T, Failure> {
    let marked = own(pointer).map_err(Mistake::explained::<T>)?;
    // SAFETY: it has the mark of its kind.
    Ok(unsafe { &(*marked).body })
}

/// Frees the object of the caller; null is no error. In a forked process it does nothing. A panic does not reach the caller.
///
/// # Safety
///
/// As [`borrow`], and no other thread uses it now or later.
pub(crate) unsafe fn free<T: Handle>(pointer: *mut T) {
    if let Ok(marked) = own(pointer) {
        // SAFETY: it has the mark of its kind.
        unsafe { (*marked).mark.store(0, Ordering::Relaxed) };
        // SAFETY: `give` made it of a box.
        let marked = unsafe { Box::from_raw(marked) };
        guarded_or((), || drop(marked));
    }
}

/// Returns a text of the caller.
///
/// # Safety
///
/// The pointer is null, or leads to a text that ends with a null byte.
pub(crate) unsafe fn text<'a>(pointer: *const c_char) -> Result<&'a str, Failure> {
    if pointer.is_null() {
        return Err(Failure::bad_argument("a name is a null pointer"));
    }
    // SAFETY: not null, and ends with a null byte.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| Failure::bad_argument("a name is not UTF-8"))
}

/// Returns an array of the caller; `None` for a null pointer.
///
/// # Safety
///
/// The pointer is null, or leads to `count` values that nobody changes during `'a`.
pub(crate) unsafe fn array<'a, N>(pointer: *const N, count: usize) -> Result<Option<&'a [N]>, Failure> {
    if pointer.is_null() {
        return Ok(None);
    }
    check_array(pointer, count)?;
    // SAFETY: not null, aligned, and of this length by the contract.
    Ok(Some(unsafe { core::slice::from_raw_parts(pointer, count) }))
}

/// Returns an array of the caller, to write it.
///
/// # Safety
///
/// The pointer leads to `count` values that nobody uses during `'a`.
pub(crate) unsafe fn array_mut<'a, N>(pointer: *mut N, count: usize) -> Result<&'a mut [N], Failure> {
    check_array(pointer, count)?;
    // SAFETY: not null, aligned, and of this length by the contract.
    Ok(unsafe { core::slice::from_raw_parts_mut(pointer, count) })
}

fn check_array<N>(pointer: *const N, count: usize) -> Result<(), Failure> {
    if pointer.is_null() || !pointer.is_aligned() || count > isize::MAX as usize / size_of::<N>().max(1) {
        return Err(Failure::bad_argument("an array is a null pointer, is not aligned, or is too long"));
    }
    Ok(())
}

/// Writes a result of the caller.
///
/// # Safety
///
/// The pointer is null, or leads to a place for one value that nobody uses.
pub(crate) unsafe fn put<T>(pointer: *mut T, value: T) -> Result<(), Failure> {
    if pointer.is_null() || !pointer.is_aligned() {
        return Err(Failure::bad_argument("the pointer for the result is null or not aligned"));
    }
    // SAFETY: not null and aligned; the value there needs no drop.
    unsafe { pointer.write(value) };
    Ok(())
}

/// Makes a handle and writes it to the caller's pointer. Makes none where it cannot be written.
///
/// # Safety
///
/// As [`put`].
pub(crate) unsafe fn put_new<T: Handle>(
    pointer: *mut *mut T,
    make: impl FnOnce() -> Result<T, Failure>,
) -> Result<(), Failure> {
    // SAFETY: by the contract of this function.
    unsafe { put(pointer, core::ptr::null_mut()) }?;
    let made = give(make()?);
    // SAFETY: by the contract of this function.
    unsafe { put(pointer, made) }
}

/// Runs a function of the library. A panic does not reach the caller.
pub(crate) fn guarded(call: impl FnOnce() -> Result<(), Failure>) -> Status {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(())) => Status::Ok,
        Ok(Err(failure)) => fail(failure),
        Err(_) => fail(Failure::new(Status::Defect, "a defect of libmotord: please report it")),
    }
}

/// Runs a function of the library that returns no status. A panic does not reach the caller, and gives `otherwise`.
pub(crate) fn guarded_or<T>(otherwise: T, call: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(call)).unwrap_or(otherwise)
}

/// Returns the content of a handle that one thread uses at a time. Never waits for another thread.
fn locked<'a, T>(content: &'a Mutex<Option<T>>, name: &str) -> Result<MutexGuard<'a, Option<T>>, Failure> {
    match content.try_lock() {
        Ok(content) => Ok(content),
        Err(TryLockError::Poisoned(content)) => Ok(content.into_inner()),
        Err(TryLockError::WouldBlock) => {
            Err(Failure::new(Status::Busy, format!("another thread uses this {name}")))
        }
    }
}

impl ClaimHandle {
    fn released() -> Failure {
        Failure::bad_argument(format!("this {} was released", Self::NAME))
    }

    /// Takes the claim out of its handle.
    pub(crate) fn take(&self) -> Result<Claim, Failure> {
        locked(&self.0, Self::NAME)?.take().ok_or_else(Self::released)
    }

    pub(crate) fn with<R>(&self, call: impl FnOnce(&mut Claim) -> Result<R, Failure>) -> Result<R, Failure> {
        call(locked(&self.0, Self::NAME)?.as_mut().ok_or_else(Self::released)?)
    }
}

impl PublisherHandle {
    pub(crate) fn with<R>(
        &self,
        call: impl FnOnce(&mut ImuPublisher) -> Result<R, Failure>,
    ) -> Result<R, Failure> {
        let none = || Failure::bad_argument(format!("this {} is empty", Self::NAME));
        call(locked(&self.0, Self::NAME)?.as_mut().ok_or_else(none)?)
    }
}

impl StateHandle {
    pub(crate) fn with<R>(&self, call: impl FnOnce(&mut State) -> Result<R, Failure>) -> Result<R, Failure> {
        let empty =
            || Failure::bad_argument(format!("this {} is empty: wait for the first state", Self::NAME));
        call(locked(&self.0, Self::NAME)?.as_mut().ok_or_else(empty)?)
    }

    /// Replaces the state.
    pub(crate) fn put(&self, state: State) -> Result<(), Failure> {
        *locked(&self.0, Self::NAME)? = Some(state);
        Ok(())
    }
}
