//! The JSON object of a frame: its members, and how their values are read.

use crate::frame::hex;
use crate::frame::refused::Refused;
use crate::frame::scale::Scale;
use motord_protocol::{FaultBits, Field, ScaleError, TorqueScale, mit};
use serde::Deserialize;
use serde_json::{Map, Value};

/// A JSON object of one frame, and the scale of the torques in it.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(transparent)]
pub(super) struct Object {
    members: Map<String, Value>,
    #[serde(skip)]
    scale: Option<Scale>,
}

impl From<Object> for Value {
    fn from(object: Object) -> Self {
        Self::Object(object.members)
    }
}

impl Object {
    /// No member yet. Torques have this scale.
    pub(super) fn new(scale: Option<Scale>) -> Self {
        Self { members: Map::new(), scale }
    }

    /// The object with the scale of its own constants, else with this one.
    pub(super) fn with_scale(mut self, scale: Option<Scale>) -> Result<Self, Refused> {
        self.scale = Scale::of(&self)?.or(scale);
        Ok(self)
    }

    /// The scale of its torques.
    pub(super) fn scale(&self) -> Option<Scale> {
        self.scale
    }

    /// The torque scale; any, where torques are raw codes alone.
    pub(super) fn torque_scale(&self) -> Result<TorqueScale, ScaleError> {
        self.scale.map_or_else(|| TorqueScale::new(1.0, 1.0), |scale| Ok(scale.torque))
    }

    /// The torque of this scale as a quantity.
    pub(super) fn torque(&self) -> Quantity {
        Quantity::torque(self.scale.as_ref())
    }

    pub(super) fn insert(&mut self, key: &str, value: impl Into<Value>) {
        self.members.insert(key.into(), value.into());
    }

    /// Adds the constants of the scale, if they are known.
    pub(super) fn insert_scale(&mut self) {
        if let Some(scale) = self.scale {
            scale.write(self);
        }
    }

    /// Adds the names of the bits of the member `fault`, if there is one.
    pub(super) fn name_faults(&mut self) {
        if let Ok(fault) = self.byte("fault") {
            let names: Vec<_> = FaultBits(fault).named().map(|fault| fault.name).collect();
            self.insert("faults", names);
        }
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.members.contains_key(key)
    }

    pub(super) fn entries(&self) -> impl Iterator<Item = (&String, &Value)> {
        self.members.iter()
    }

    pub(super) fn get(&self, key: &str) -> Option<&Value> {
        self.members.get(key)
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
        let members = value.as_object().cloned().ok_or_else(received)?;
        Ok(Self { members, scale: self.scale })
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

    /// Adds a code and, where its scale is known, the value that it stands for.
    pub(super) fn insert_code(&mut self, quantity: &Quantity, code: u16) {
        self.insert(quantity.raw, code);
        if let Some(field) = quantity.field {
            self.insert(quantity.physical, field.decode(code));
        }
    }

    /// The code of `quantity`, given as such or as the value that it stands for.
    pub(super) fn code(&self, quantity: &Quantity) -> Result<u16, Refused> {
        let &Quantity { raw, physical, .. } = quantity;
        if !self.has(physical) {
            return quantity.code(self);
        }
        let nearest = quantity.nearest(self)?;
        if !self.has(raw) {
            return Ok(nearest);
        }
        match quantity.code(self)? {
            code if code == nearest => Ok(code),
            code => Err(Refused::Disagree { raw, code, physical, nearest }),
        }
    }
}

/// A quantity that an object has twice: as a code and as the value that it stands for.
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

    /// The key is the code or the value of a quantity in `object`, not a member of its own as in `torque_control`.
    pub(super) fn has_key(key: &str, object: &Object) -> bool {
        let all = [Self::POSITION, Self::VELOCITY, Self::KP, Self::KD, Self::torque(None)];
        let is_quantity = all.iter().any(|quantity| [quantity.raw, quantity.physical].contains(&key));
        is_quantity && (object.has(Self::POSITION.raw) || object.has(Self::POSITION.physical))
    }

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
