//! The objects of one kind, and the numbers that callers have of them.
//!
//! The pointer of a caller is a number that names a slot of a table and its use. It leads to no
//! memory, so the library reads nothing that was freed, and a number is not used again. The numbers
//! of two copies of the library in a process may be equal. Every function is lock-free, so a forked
//! process finds no lock of its parent.
//!
//! ```text
//!   1 | use | slot | kind | 000
//! ```
//!
//! The highest bit is set: no address of a 64-bit program has it.

use std::array::from_fn;
use std::ptr;
use std::sync::atomic::{AtomicPtr, AtomicUsize, Ordering};

const ALIGNMENT_BITS: u32 = 3;
const KIND_BITS: u32 = 2;
const SLOT_BITS: u32 = usize::BITS / 4;
const USE_BITS: u32 = usize::BITS - 1 - SLOT_BITS - KIND_BITS - ALIGNMENT_BITS;

/// Limit on the objects of a kind at the same time: 65 536 of a 64-bit program.
pub const OBJECTS_MAX: usize = 1 << SLOT_BITS;
/// The last use of a slot, an odd number: 2⁴² − 1 in a 64-bit program.
const USE_MAX: usize = (1 << USE_BITS) - 1;
/// Slots that are allocated together.
const CHUNK: usize = 64;

/// A kind of object. Handles of two kinds are never equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A client.
    Client = 0,
    /// A state.
    State = 1,
    /// A claim.
    Claim = 2,
    /// A publisher.
    Publisher = 3,
}

/// A slot and its use, as a caller has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Number {
    slot: usize,
    used: usize,
}

impl Number {
    fn to_handle(self, kind: Kind) -> usize {
        let tagged = (1 << USE_BITS) | self.used;
        (((tagged << SLOT_BITS) | self.slot) << KIND_BITS | kind as usize) << ALIGNMENT_BITS
    }

    /// Returns the number in a handle; `None` for one of another kind, and for an address.
    fn of_handle(handle: usize, kind: Kind) -> Option<Self> {
        let low = |value: usize, bits: u32| value & ((1 << bits) - 1);
        let shifted = handle >> ALIGNMENT_BITS;
        let (slot, used) = (shifted >> KIND_BITS, shifted >> (KIND_BITS + SLOT_BITS));
        let number = Self { slot: low(slot, SLOT_BITS), used: low(used, USE_BITS) };
        (number.to_handle(kind) == handle && number.used % 2 == 1).then_some(number)
    }
}

/// A slot for an object.
#[derive(Debug)]
struct Slot<T> {
    /// Number of its use: odd from the insertion of an object to its removal. Only grows.
    used: AtomicUsize,
    /// Null without an object.
    object: AtomicPtr<T>,
}

/// The objects of a kind.
#[derive(Debug)]
pub struct Table<T> {
    kind: Kind,
    /// Null before the first use. Never freed.
    chunks: [AtomicPtr<[Slot<T>; CHUNK]>; OBJECTS_MAX / CHUNK],
}

impl<T> Table<T> {
    /// Creates an empty table. Does not allocate.
    #[must_use]
    pub const fn new(kind: Kind) -> Self {
        Self { kind, chunks: [const { AtomicPtr::new(ptr::null_mut()) }; OBJECTS_MAX / CHUNK] }
    }

    /// Moves an object into a free slot. Returns its handle; `None` while there are [`OBJECTS_MAX`]. Checks each slot in use before it.
    pub fn insert(&self, object: T) -> Option<usize> {
        for index in 0..OBJECTS_MAX {
            let slot = self.slot_or_new(index)?;
            let free = slot.used.load(Ordering::Acquire);
            let used = free.wrapping_add(1);
            // The object of the last use may not be taken yet. A slot is not used again after its
            // last number.
            let is_free = free % 2 == 0 && free < USE_MAX && slot.object.load(Ordering::Acquire).is_null();
            if is_free && slot.used.compare_exchange(free, used, Ordering::AcqRel, Ordering::Relaxed).is_ok()
            {
                slot.object.store(Box::into_raw(Box::new(object)), Ordering::Release);
                return Some(Number { slot: index, used }.to_handle(self.kind));
            }
        }
        None
    }

    /// Returns the object of a handle; `None` after its removal, and for every other number. Async-signal-safe. It is valid until the
    /// removal.
    pub fn find(&self, handle: usize) -> Option<*const T> {
        let number = Number::of_handle(handle, self.kind)?;
        let slot = self.slot(number.slot)?;
        // The object first: a later use of the slot changes the number before it stores an object.
        let object = slot.object.load(Ordering::Acquire);
        let is_this = slot.used.load(Ordering::Acquire) == number.used;
        (is_this && !object.is_null()).then_some(object.cast_const())
    }

    /// Takes the object of a handle out of the table; `None` where [`find`](Self::find) returns `None`, and while another thread takes it.
    pub fn remove(&self, handle: usize) -> Option<Box<T>> {
        self.find(handle)?;
        self.take(Number::of_handle(handle, self.kind)?)
    }

    /// Takes the object with this number, which had one. The first of several threads gets it.
    fn take(&self, number: Number) -> Option<Box<T>> {
        let slot = self.slot(number.slot)?;
        // Ends the use first: a number never returns, and no other thread takes or stores an object
        // until the slot is empty.
        let next = number.used + 1;
        slot.used.compare_exchange(number.used, next, Ordering::AcqRel, Ordering::Relaxed).ok()?;
        let object = slot.object.swap(ptr::null_mut(), Ordering::AcqRel);
        // SAFETY: `insert` made it of a box, and only the thread that ended its use takes it.
        (!object.is_null()).then(|| unsafe { Box::from_raw(object) })
    }

    fn slot(&self, index: usize) -> Option<&Slot<T>> {
        let chunk = self.chunks.get(index / CHUNK)?.load(Ordering::Acquire);
        // SAFETY: null, or made of a box by `slot_or_new`, and never freed.
        unsafe { chunk.as_ref() }?.get(index % CHUNK)
    }

    /// Returns the slot with this index. Allocates its chunk before the first use.
    fn slot_or_new(&self, index: usize) -> Option<&Slot<T>> {
        let chunk = self.chunks.get(index / CHUNK)?;
        if chunk.load(Ordering::Acquire).is_null() {
            let empty = |_| Slot { used: AtomicUsize::new(0), object: AtomicPtr::default() };
            let new = Box::into_raw(Box::new(from_fn(empty)));
            let stored = chunk.compare_exchange(ptr::null_mut(), new, Ordering::AcqRel, Ordering::Acquire);
            if stored.is_err() {
                // SAFETY: another thread stored one first: this one is still owned here.
                drop(unsafe { Box::from_raw(new) });
            }
        }
        self.slot(index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;

    fn value<T: Copy>(table: &Table<T>, handle: usize) -> Option<T> {
        // SAFETY: no thread removes it meanwhile.
        table.find(handle).map(|object| unsafe { *object })
    }

    #[test]
    fn handle_is_never_used_again() {
        let table = Table::new(Kind::Claim);
        let mut before = Vec::new();
        for number in 0..1000 {
            let handle = table.insert(number).unwrap();
            assert!(!before.contains(&handle));
            assert_eq!(value(&table, handle), Some(number));
            assert_eq!(table.remove(handle).as_deref(), Some(&number));
            assert_eq!((value(&table, handle), table.remove(handle)), (None, None));
            before.push(handle);
        }
        assert_eq!(
            table.insert(0).map(|handle| Number::of_handle(handle, Kind::Claim).unwrap().slot),
            Some(0)
        );
        assert!(before.iter().all(|handle| value(&table, *handle).is_none()));
    }

    #[test]
    fn slot_ends_with_its_last_number() {
        let table = Table::new(Kind::State);
        table.slot_or_new(0).unwrap().used.store(USE_MAX - 1, Ordering::Relaxed);
        let last = table.insert('a').unwrap();
        assert_eq!(Number::of_handle(last, Kind::State), Some(Number { slot: 0, used: USE_MAX }));
        assert!(table.remove(last).is_some());
        let next = Number::of_handle(table.insert('b').unwrap(), Kind::State);
        assert_eq!((next, value(&table, last)), (Some(Number { slot: 1, used: 1 }), None));
    }

    /// A thread found an object. Before it takes it, another one removes it, and a third one stores an object in the slot.
    #[test]
    fn second_free_spares_later_object() {
        let table = Table::new(Kind::Claim);
        let first = table.insert('a').unwrap();
        let found = Number::of_handle(first, Kind::Claim).unwrap();
        assert!(table.remove(first).is_some());
        let later = table.insert('b').unwrap();
        assert_eq!((table.take(found), value(&table, later)), (None, Some('b')));
        assert!(table.remove(later).is_some());
        assert_ne!(table.insert('c'), Some(later), "no number returns");
    }

    /// A thread has ended the use of a slot, and has not taken the object out yet.
    #[test]
    fn slot_is_free_once_it_is_empty() {
        let table = Table::new(Kind::Claim);
        let first = table.insert('a').unwrap();
        let Number { slot, used } = Number::of_handle(first, Kind::Claim).unwrap();
        table.slot(slot).unwrap().used.store(used + 1, Ordering::Release);
        let next = Number { slot, used: used + 1 }.to_handle(Kind::Claim);
        assert_eq!((value(&table, first), value(&table, next)), (None, None));
        let other = Number::of_handle(table.insert('b').unwrap(), Kind::Claim);
        assert_eq!(other, Some(Number { slot: slot + 1, used: 1 }));
        table.slot(slot).unwrap().used.store(used, Ordering::Release);
        assert_eq!(table.remove(first).as_deref(), Some(&'a'));
    }

    #[test]
    fn full_table_accepts_no_object() {
        let table = Table::new(Kind::State);
        for index in 0..OBJECTS_MAX - 1 {
            table.slot_or_new(index).unwrap().used.store(1, Ordering::Relaxed);
        }
        let last = table.insert('a').unwrap();
        assert_eq!((table.insert('b'), value(&table, last)), (None, Some('a')));
        assert!(table.remove(last).is_some());
        assert_ne!(table.insert('c').unwrap(), last);
    }

    #[test]
    fn number_that_is_no_handle_is_found_nowhere() {
        let table = Table::new(Kind::Client);
        let handle = table.insert(1).unwrap();
        let kinds = [Kind::State, Kind::Claim, Kind::Publisher];
        assert!(kinds.iter().all(|kind| Number::of_handle(handle, *kind).is_none()));
        for other in [0, 1, 8, usize::MAX, usize::MAX - 7, handle + 1, handle ^ (1 << (usize::BITS - 1))] {
            assert_eq!((value(&table, other), table.remove(other)), (None, None), "{other:#x}");
        }
        assert_eq!(value(&table, handle), Some(1));
        for bit in 0..usize::BITS {
            assert_eq!(value(&table, handle ^ (1 << bit)), None, "bit {bit}");
        }
    }

    #[test]
    fn threads_get_handles_of_their_own() {
        static TABLE: Table<u32> = Table::new(Kind::Publisher);
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let turns = if cfg!(miri) { 30 } else { 20_000 };
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..turns {
                        let number = NEXT.fetch_add(1, Ordering::Relaxed);
                        let handle = TABLE.insert(number).unwrap();
                        assert_eq!(value(&TABLE, handle), Some(number));
                        assert_eq!(TABLE.remove(handle).as_deref(), Some(&number));
                    }
                });
            }
        });
    }
}
