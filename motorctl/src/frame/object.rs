//! The JSON object of a frame: what it tells, and how its values are read.

use crate::frame::hex;
use crate::frame::refused::Refused;
use crate::frame::scale::Scale;
use motord_protocol::{Field, mit};
use serde::Deserialize;
use serde_json::{Map, Value};

/// A JSON object of one frame.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(transparent)]
pub(super) struct Object(Map<String, Value>);

impl From<Object> for Value {
    fn from(object: Object) -> Self {
        Self::Object(object.0)
    }
}

impl Object {
    pub(super) fn of_kind(kind: &str) -> Self {
        let mut object = Self::default();
        object.insert("kind", kind);
        object
    }

    pub(super) fn insert(&mut self, key: &str, value: impl Into<Value>) {
        self.0.insert(key.into(), value.into());
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.0.contains_key(key)
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = (&String, &Value)> {
        self.0.iter()
    }

    pub(super) fn get(&self, key: &str) -> Option<&Value> {
        self.0.get(key)
    }

    fn required(&self, key: &'static str) -> Result<&Value, Refused> {
        self.get(key).ok_or(Refused::Missing { key })
    }

    pub(super) fn kind(&self) -> Result<&str, Refused> {
        self.text("kind")
    }

    fn text(&self, key: &'static str) -> Result<&str, Refused> {
        let value = self.required(key)?;
        value.as_str().ok_or_else(|| Refused::Type { key, expected: "a string", received: value.to_string() })
    }

    pub(super) fn bytes(&self, key: &'static str) -> Result<Vec<u8>, Refused> {
        hex::bytes(self.text(key)?)
    }

    pub(super) fn object(&self, key: &'static str) -> Result<Self, Refused> {
        let value = self.required(key)?;
        let received = || Refused::Type { key, expected: "an object", received: value.to_string() };
        value.as_object().cloned().map(Self).ok_or_else(received)
    }

    pub(super) fn number(&self, key: &'static str) -> Result<f64, Refused> {
        let value = self.required(key)?;
        value.as_f64().ok_or_else(|| Refused::Type { key, expected: "a number", received: value.to_string() })
    }

    /// A whole number from `least` to `most`.
    pub(super) fn integer(&self, key: &'static str, least: i64, most: i64) -> Result<i64, Refused> {
        let number = self.number(key)?;
        let is_whole = number.fract() == 0.0 && (least as f64..=most as f64).contains(&number);
        let refused = || Refused::Range { key, least, most, received: number.to_string() };
        is_whole.then_some(number as i64).ok_or_else(refused)
    }

    pub(super) fn byte(&self, key: &'static str) -> Result<u8, Refused> {
        Ok(self.integer(key, 0, 0xFF)? as u8)
    }

    pub(super) fn tell(&mut self, quantity: &Quantity, code: u16) {
        self.insert(quantity.raw, code);
        if let Some(field) = quantity.field {
            self.insert(quantity.physical, field.decode(code));
        }
    }

    /// The code of `quantity`, given as such or as what it stands for.
    pub(super) fn code(&self, quantity: &Quantity) -> Result<u16, Refused> {
        let &Quantity { raw, physical, .. } = quantity;
        if !self.has(physical) {
            return quantity.code(self);
        }
        if !self.has(raw) {
            return quantity.nearest(self);
        }
        let code = quantity.code(self)?;
        match quantity.field {
            None => Ok(code),
            Some(_) => match quantity.nearest(self)? {
                nearest if nearest == code => Ok(code),
                nearest => Err(Refused::Disagree { raw, code, physical, nearest }),
            },
        }
    }
}

/// A quantity that an object tells twice: as a code and as what it stands for.
pub(super) struct Quantity {
    raw: &'static str,
    physical: &'static str,
    /// `None` for a torque whose scale is not known.
    field: Option<Field>,
    code_max: u16,
}

impl Quantity {
    pub(super) const POSITION: Self = Self::new("pos_int", "pos_rad", mit::POSITION);
    pub(super) const VELOCITY: Self = Self::new("vel_int", "vel_rad_s", mit::VELOCITY);
    pub(super) const KP: Self = Self::new("kp_int", "kp", mit::KP);
    pub(super) const KD: Self = Self::new("kd_int", "kd", mit::KD);

    const fn new(raw: &'static str, physical: &'static str, field: Field) -> Self {
        Self { raw, physical, field: Some(field), code_max: field.code_max() }
    }

    pub(super) fn torque(scale: Option<&Scale>) -> Self {
        let field = scale.map(|scale| scale.torque.field());
        Self { raw: "torque_int", physical: "torque_nm", field, code_max: 0x0FFF }
    }

    fn code(&self, object: &Object) -> Result<u16, Refused> {
        Ok(object.integer(self.raw, 0, self.code_max.into())? as u16)
    }

    fn nearest(&self, object: &Object) -> Result<u16, Refused> {
        let physical = self.physical;
        let field = self.field.ok_or(Refused::NoScale { physical })?;
        let value = object.number(physical)?;
        let received =
            || Refused::Type { key: physical, expected: "a finite number", received: value.to_string() };
        field.encode(value).ok_or_else(received)
    }
}
