//! Structures that any process may write: numbers only, without padding.

use core::fmt::Debug;

/// A value of which every bit pattern is valid: a number, or an array or structure of such values without padding.
///
/// Only this crate implements it, with [`plain!`]: unsafe code of the ports relies on that.
pub trait Plain: Copy {
    /// The value whose bytes are zero.
    const ZERO: Self;
}

/// A message of a service.
pub trait Message: Plain + Debug {
    /// Its name and the version of its layout. A process whose layout differs cannot open the service.
    const TYPE_NAME: &'static str;
}

macro_rules! numbers {
    ($($number:ident),+) => {
        $(impl Plain for $number {
            const ZERO: Self = 0 as Self;
        })+
    };
}

numbers!(u8, u32, u64, f32, f64);

impl<T: Plain, const N: usize> Plain for [T; N] {
    const ZERO: Self = [T::ZERO; N];
}

/// Declares a structure of a message. Its fields must be [`Plain`], and must leave no padding between them.
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
        }

        impl Default for $name {
            fn default() -> Self {
                <Self as $crate::plain::Plain>::ZERO
            }
        }
    };
}

pub(crate) use plain;
