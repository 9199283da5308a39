//! The members of a JSON object for the fields of a frame, in one table for both directions.

use crate::object::{Object, Quantities};
use crate::rejected::Rejected;
use motord_protocol::gim::{
    Calibration, CommandCode, ConfigurationKey, ExecutionTime, Finite, Outcome, Refusal, State, Value,
    ValueType,
};
use motord_protocol::{DecodeError, FaultBits, StateCodes};
use std::f64::consts::TAU;

/// Converts a field of a frame to members of an object. `key` is the name of its main member.
pub(super) trait Member: Sized {
    /// Adds the field to `object`.
    fn write(&self, object: &mut Object, key: &'static str);

    /// Reads the field from `object`.
    fn read(object: &Object, key: &'static str) -> Result<Self, Rejected>;
}

/// Implements [`Variants`] from a table with a row per variant: its selectors, then its fields with
/// the keys of their members.
macro_rules! variants {
    ($enum:ty, by $selector:ty; $($selected:pat => $variant:ident { $($field:tt: $key:ident),* },)*) => {
        impl Variants for $enum {
            type Selector = $selector;

            fn write(&self, object: &mut Object) {
                match self {
                    $(Self::$variant { $($field: $key),* } => {
                        $(Member::write($key, object, stringify!($key));)*
                    })*
                }
                let _ = object;
            }

            fn read(selector: $selector, object: &Object) -> Result<Self, Rejected> {
                Ok(match selector {
                    $($selected => Self::$variant { $($field: Member::read(object, stringify!($key))?),* },)*
                })
            }
        }
    };
}
pub(super) use variants;

/// Converts the variants of an enum of frames.
pub(super) trait Variants: Sized {
    /// The type that selects a variant.
    type Selector;

    /// Adds the fields of the variant to `object`.
    fn write(&self, object: &mut Object);

    /// Reads the variant that `selector` selects.
    fn read(selector: Self::Selector, object: &Object) -> Result<Self, Rejected>;
}

impl Member for () {
    fn write(&self, _: &mut Object, _: &'static str) {}

    fn read(_: &Object, _: &'static str) -> Result<Self, Rejected> {
        Ok(())
    }
}

/// Implements [`Member`] for a field that is one number in an object.
macro_rules! number {
    ($type:ty, $to_number:expr, $read:expr) => {
        impl Member for $type {
            fn write(&self, object: &mut Object, key: &'static str) {
                object.insert(key, $to_number(*self));
            }

            fn read(object: &Object, key: &'static str) -> Result<Self, Rejected> {
                $read(object, key)
            }
        }
    };
}

number!(u8, |byte| byte, Object::byte);
number!(u32, |word| word, |object: &Object, key| Ok(object.integer(key, 0, u32::MAX.into())? as u32));
number!(Calibration, |Self(byte)| byte, |object: &Object, key| object.byte(key).map(Self));
number!(FaultBits, |Self(byte)| byte, |object: &Object, key| object.byte(key).map(Self));
number!(Finite, Finite::get, finite);
number!(ExecutionTime, ExecutionTime::as_millis, duration);

fn finite(object: &Object, key: &'static str) -> Result<Finite, Rejected> {
    let number = object.number(key)?;
    let refused = || Rejected::Type { key, expected: "a float of 32 bits", received: number.to_string() };
    Finite::new(number as f32).ok_or_else(refused)
}

fn duration(object: &Object, key: &'static str) -> Result<ExecutionTime, Rejected> {
    let most = i64::from(ExecutionTime::MAX.as_millis());
    let millis = object.integer(key, 0, most)?;
    let refused = || Rejected::Range { key, least: 0, most, received: millis.to_string() };
    ExecutionTime::from_millis(millis as u32).ok_or_else(refused)
}

/// Converts the result byte and, in a successful reply, the value.
impl<T: Member> Member for Outcome<T> {
    fn write(&self, object: &mut Object, key: &'static str) {
        object.insert("res", self.as_ref().err().map_or(0, |refusal| refusal.code()));
        if let Ok(value) = self {
            value.write(object, key);
        }
    }

    fn read(object: &Object, key: &'static str) -> Result<Self, Rejected> {
        match Refusal::check(object.byte("res")?) {
            Ok(()) => T::read(object, key).map(Ok),
            Err(refusal) => Ok(Err(refusal)),
        }
    }
}

/// The default is the byte of an indicator: the document answers a calibration with it.
impl Member for CommandCode {
    fn write(&self, object: &mut Object, key: &'static str) {
        object.insert(key, *self as u8);
    }

    fn read(object: &Object, key: &'static str) -> Result<Self, Rejected> {
        Ok(if object.has(key) { Self::from_byte(object.byte(key)?)? } else { Self::RetrieveIndicator })
    }
}

impl Member for ConfigurationKey {
    fn write(&self, object: &mut Object, _: &'static str) {
        object.insert("conf_type", self.conf_type);
        object.insert("conf_id", self.conf_id);
    }

    fn read(object: &Object, _: &'static str) -> Result<Self, Rejected> {
        Ok(Self { conf_type: object.byte("conf_type")?, conf_id: object.byte("conf_id")? })
    }
}

/// The value of a configuration item. Its type and number are also members.
impl Member for Value {
    fn write(&self, object: &mut Object, key: &'static str) {
        object.insert("conf_type", self.value_type() as u8);
        match self {
            Self::Integer(value) => object.insert(key, *value),
            Self::Float(value) => object.insert(key, value.get()),
        }
    }

    fn read(object: &Object, key: &'static str) -> Result<Self, Rejected> {
        let item = ConfigurationKey::read(object, "")?;
        match ValueType::from_byte(item.conf_type) {
            Some(ValueType::Integer) if item.is_position() && !object.has(key) => {
                let turns = object.number("position_rad")? / TAU;
                Ok(Self::Integer((turns.rem_euclid(1.0) * 65536.0).round() as i32 % 65536))
            }
            Some(ValueType::Integer) => {
                Ok(Self::Integer(object.integer(key, i32::MIN.into(), i32::MAX.into())? as i32))
            }
            Some(ValueType::Float) => Member::read(object, key).map(Self::Float),
            None => Err(DecodeError::UnknownType { received: item.conf_type }.into()),
        }
    }
}

impl Member for StateCodes {
    fn write(&self, object: &mut Object, _: &'static str) {
        let Quantities { position, velocity, torque, .. } = object.quantities();
        object.insert_code(&position, self.position);
        object.insert_code(&velocity, self.velocity);
        object.insert_code(&torque, self.torque);
        object.insert_scale();
    }

    fn read(object: &Object, _: &'static str) -> Result<Self, Rejected> {
        let Quantities { position, velocity, torque, .. } = object.quantities();
        Ok(Self {
            position: object.code(&position)?,
            velocity: object.code(&velocity)?,
            torque: object.code(&torque)?,
        })
    }
}

impl Member for State {
    fn write(&self, object: &mut Object, key: &'static str) {
        object.insert("temperature_c", self.temperature_celsius);
        self.codes.write(object, key);
    }

    fn read(object: &Object, key: &'static str) -> Result<Self, Rejected> {
        let temperature = object.integer("temperature_c", i8::MIN.into(), i8::MAX.into())? as i8;
        Ok(Self::new(temperature, StateCodes::read(object, key)?, &object.scales()?))
    }
}
