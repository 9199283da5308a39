//! The objects behind the pointers of a caller.

use crate::status::{Failure, Status, fail};
use crate::table::{Kind, OBJECTS_MAX, Table};
use motord_client::{Claim, Client, Creator, Error, ImuPublisher, State};
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::{Mutex, MutexGuard, TryLockError};

/// An object, and the process that created it.
pub struct Owned<T> {
    creator: Creator,
    body: T,
}

/// A kind of handle.
pub trait Handle: Sized + 'static {
    /// Its name in messages.
    const NAME: &'static str;
    /// Returns the objects of this kind.
    fn table() -> &'static Table<Owned<Self>>;
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
    const NAME: &'static str = "motord_client";
    fn table() -> &'static Table<Owned<Self>> {
        static TABLE: Table<Owned<ClientHandle>> = Table::new(Kind::Client);
        &TABLE
    }
}

impl Handle for StateHandle {
    const NAME: &'static str = "motord_state";
    fn table() -> &'static Table<Owned<Self>> {
        static TABLE: Table<Owned<StateHandle>> = Table::new(Kind::State);
        &TABLE
    }
}

impl Handle for ClaimHandle {
    const NAME: &'static str = "motord_claim";
    fn table() -> &'static Table<Owned<Self>> {
        static TABLE: Table<Owned<ClaimHandle>> = Table::new(Kind::Claim);
        &TABLE
    }
}

impl Handle for PublisherHandle {
    const NAME: &'static str = "motord_imu_publisher";
    fn table() -> &'static Table<Owned<Self>> {
        static TABLE: Table<Owned<PublisherHandle>> = Table::new(Kind::Publisher);
        &TABLE
    }
}

/// Moves an object to the caller, who gets a number of it in place of its address. Fails while its kind has no free slot: while
/// [`OBJECTS_MAX`] exist, and once a 32-bit program has used each number.
pub(crate) fn give<T: Handle>(body: T) -> Result<*mut T, Failure> {
    let handle = T::table().insert(Owned { creator: Creator::this(), body });
    let name = T::NAME;
    handle.map(ptr::without_provenance_mut).ok_or_else(|| {
        let message =
            format!("no further {name}: at most {OBJECTS_MAX} exist. Free those that are no longer in use");
        Failure::new(Status::Unavailable, message)
    })
}

/// Returns the failure of a pointer that is no handle of its kind.
fn no_handle<T: Handle>(pointer: *mut T) -> Failure {
    let name = T::NAME;
    Failure::bad_argument(match pointer.is_null() {
        true => format!("this {name} is a null pointer"),
        false => format!("this {name} was freed, or is no {name}"),
    })
}

/// Returns the object of the caller, also of one in a forked process; `None` for every other pointer. Async-signal-safe.
///
/// # Safety
///
/// As [`borrow`].
pub(crate) unsafe fn found<'a, T: Handle>(pointer: *mut T) -> Option<&'a T> {
    // SAFETY: the table has it, and no thread removes it during `'a`.
    T::table().find(pointer.addr()).map(|owned| unsafe { &(*owned).body })
}

/// Returns the object of the caller. In a forked process it is an error: a lock of the object may be held by a thread of the parent.
///
/// # Safety
///
/// No other thread frees the object during `'a`. The pointer may have any value: it is never followed.
pub(crate) unsafe fn borrow<'a, T: Handle>(pointer: *mut T) -> Result<&'a T, Failure> {
    let owned = T::table().find(pointer.addr()).ok_or_else(|| no_handle(pointer))?;
    // SAFETY: the table has it, and no thread removes it during `'a`.
    let owned = unsafe { &*owned };
    owned.creator.check().map_err(|_| Error::Forked)?;
    Ok(&owned.body)
}

/// Frees the object of the caller. Every other pointer, and an object of a parent process, is ignored. A panic does not reach the caller.
///
/// # Safety
///
/// No other thread uses the object.
pub(crate) unsafe fn free<T: Handle>(pointer: *mut T) {
    // SAFETY: by the contract of this function.
    if unsafe { borrow(pointer) }.is_ok() {
        let owned = T::table().remove(pointer.addr());
        guarded_or((), || drop(owned));
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
/// The pointer is null, or leads to `count` values that no other code changes during `'a`.
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
/// The pointer leads to `count` values that no other code uses during `'a`.
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
/// The pointer is null, or leads to memory for one value that no other code uses.
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
    unsafe { put(pointer, ptr::null_mut()) }?;
    let made = give(make()?)?;
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
