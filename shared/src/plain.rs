//! Structures that any process may write: numbers only, without padding.

use core::fmt::Debug;

/// A value of which every bit pattern is valid: a number, or an array or structure of such values
/// without padding.
///
/// Only this crate implements it, with `plain!`: unsafe code of the ports relies on that.
pub trait Plain: Copy {
    /// The value whose bytes are zero.
    const ZERO: Self;

    /// Appends its bytes, little-endian, in the order of the memory.
    fn write(&self, bytes: &mut Vec<u8>);

    /// Takes its bytes from the front of `bytes`. `None` when there are fewer.
    fn read(bytes: &mut &[u8]) -> Option<Self>;
}

/// A message of a service.
pub trait Message: Plain + Debug {
    /// Its name and the version of its layout. A process whose layout differs cannot open the
    /// service.
    const TYPE_NAME: &'static str;
}

/// An array of a message of which only the first entries are used.
#[derive(Debug, Clone, Copy)]
pub struct Used {
    /// Where the number of used entries is, a `u32`, bytes from the start of the message.
    pub count: usize,
    /// Where the array begins, bytes from the start of the message.
    pub start: usize,
    /// Size of an entry, bytes.
    pub entry: usize,
    /// Entries of the array.
    pub most: usize,
}

/// A message of which only a part is used. Copies to and from shared memory leave out the rest.
///
/// Only this crate implements it: unsafe code of the ports relies on the places.
pub trait Sparse: Message {
    /// Its arrays, by place. The bytes between them are always used.
    const ARRAYS: &'static [Used];
}

/// Declares the arrays of a message, with the fields that hold their numbers of used entries.
macro_rules! sparse {
    ($name:ident { $($array:ident by $count:ident,)+ }) => {
        impl $crate::plain::Sparse for $name {
            const ARRAYS: &'static [$crate::plain::Used] = {
                const fn most<T, const N: usize>(_: &[T; N]) -> (usize, usize) {
                    (size_of::<T>(), N)
                }
                const ZERO: $name = <$name as $crate::plain::Plain>::ZERO;
                &[$({
                    let (entry, most) = most(&ZERO.$array);
                    let _: u32 = ZERO.$count;
                    $crate::plain::Used {
                        count: core::mem::offset_of!($name, $count),
                        start: core::mem::offset_of!($name, $array),
                        entry,
                        most,
                    }
                },)+]
            };
        }
    };
}

macro_rules! numbers {
    ($($number:ident),+) => {
        $(impl Plain for $number {
            const ZERO: Self = 0 as Self;

            fn write(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            fn read(bytes: &mut &[u8]) -> Option<Self> {
                bytes.split_off(..size_of::<Self>())?.try_into().ok().map(Self::from_le_bytes)
            }
        })+
    };
}

numbers!(u8, u32, u64, f32, f64);

impl<T: Plain, const N: usize> Plain for [T; N] {
    const ZERO: Self = [T::ZERO; N];

    fn write(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|entry| entry.write(bytes));
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        let mut entries = Self::ZERO;
        entries.iter_mut().try_for_each(|entry| T::read(bytes).map(|read| *entry = read))?;
        Some(entries)
    }
}

/// Declares a structure of a message. Its fields must be [`Plain`], and must leave no padding
/// between them.
macro_rules! plain {
    ($(#[$attribute:meta])* pub struct $name:ident {
        $($(#[$field_attribute:meta])* pub $field:ident: $type:ty,)+
    }) => {
        $(#[$attribute])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        #[repr(C)]
        pub struct $name {
            $($(#[$field_attribute])* pub $field: $type,)+
        }

        impl $crate::plain::Plain for $name {
            const ZERO: Self = {
                assert!(size_of::<Self>() == 0 $(+ size_of::<$type>())+, "this layout has padding");
                Self { $($field: <$type as $crate::plain::Plain>::ZERO,)+ }
            };

            fn write(&self, bytes: &mut Vec<u8>) {
                $($crate::plain::Plain::write(&self.$field, bytes);)+
            }

            fn read(bytes: &mut &[u8]) -> Option<Self> {
                // In the order of the memory.
                Some(Self { $($field: $crate::plain::Plain::read(bytes)?,)+ })
            }
        }

        impl Default for $name {
            fn default() -> Self {
                <Self as $crate::plain::Plain>::ZERO
            }
        }
    };
}

pub(crate) use {plain, sparse};
