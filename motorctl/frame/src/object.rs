//! The JSON object of a frame: access to its members.

use crate::hex;
use crate::rejected::Rejected;
use crate::scale::{self, Scale};
use crate::strict::Strict;
use motord_protocol::profile::STEADYWIN;
use motord_protocol::{Field, Profile, ScaleError, Scales};
use motord_shared::Fault;
use serde_json::{Map, Value};

/// A JSON object of one frame, the profile of its motor, and the scale of the codes in it.
#[derive(Debug, Clone)]
pub(super) struct Object {
    members: Map<String, Value>,
    profile: Option<&'static Profile>,
    scale: Option<Scale>,
}

impl From<Object> for Value {
    fn from(object: Object) -> Self {
        Self::Object(object.members)
    }
}

impl Object {
    /// Creates an object without members.
    pub(super) fn new(profile: &'static Profile, scale: Option<Scale>) -> Self {
        Self { members: Map::new(), profile: Some(profile), scale }
    }

    /// Converts a parsed value to an object.
    pub(super) fn given(Strict { value, repeated }: Strict) -> Result<Self, Rejected> {
        match (value, repeated) {
            (_, Some(key)) => Err(Rejected::Repeated { key }),
            (Value::Object(members), None) => Ok(Self { members, profile: None, scale: None }),
            (other, None) => Err(Rejected::NoObject { received: other.to_string() }),
        }
    }

    /// Sets the profile, and the scale from the object's own constants or, without them, `scale`.
    pub(super) fn with_scale(
        mut self,
        profile: &'static Profile,
        scale: Option<Scale>,
    ) -> Result<Self, Rejected> {
        self.profile = Some(profile);
        self.scale = match self.has("torque_constant") || self.has("gear_ratio") {
            true => Some(Scale::new(self.number("torque_constant")?, self.number("gear_ratio")?)?),
            false => scale,
        };
        Ok(self)
    }

    /// Returns the profile of the motor's vendor.
    pub(super) fn profile(&self) -> &'static Profile {
        self.profile.unwrap_or(&STEADYWIN)
    }

    /// Returns the scale of the codes.
    pub(super) fn scale(&self) -> Option<Scale> {
        self.scale
    }

    /// Returns the scales; arbitrary ones where codes are raw.
    pub(super) fn scales(&self) -> Result<Scales, ScaleError> {
        self.scale.map_or_else(|| Scales::by_current(1.0, 1.0), |scale| Ok(scale.scales))
    }

    /// Returns the quantities of a control frame, with their scales where known.
    pub(super) fn quantities(&self) -> Quantities {
        let known = self.scale.map(|scale| scale.scales).or_else(|| scale::common(self.profile()));
        Quantities {
            position: Quantity::new("pos_int", "pos_rad", known.map(|scales| scales.position), 0xFFFF),
            velocity: Quantity::new("vel_int", "vel_rad_s", known.map(|scales| scales.velocity), 0xFFF),
            kp: Quantity::new("kp_int", "kp", known.map(|scales| scales.kp), 0xFFF),
            kd: Quantity::new("kd_int", "kd", known.map(|scales| scales.kd), 0xFFF),
            torque: Quantity::new(
                "torque_int",
                "torque_nm",
                self.scale.map(|scale| scale.scales.torque),
                0xFFF,
            ),
        }
    }

    pub(super) fn insert(&mut self, key: &str, value: impl Into<Value>) {
        self.members.insert(key.into(), value.into());
    }

    /// Adds the constants of the scale, if known.
    pub(super) fn insert_scale(&mut self) {
        if let Some([torque_constant, gear_ratio]) = self.scale.and_then(|scale| scale.constants) {
            self.insert("torque_constant", torque_constant);
            self.insert("gear_ratio", gear_ratio);
        }
    }

    /// Adds the names of the bits in the member `fault`, if it exists.
    pub(super) fn name_faults(&mut self) {
        if let Ok(fault) = self.byte("fault") {
            let names: Vec<_> = Fault::of_bits(fault.into()).map(Fault::name).collect();
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

    fn required(&self, key: &'static str) -> Result<&Value, Rejected> {
        self.get(key).ok_or(Rejected::Missing { key })
    }

    pub(super) fn kind(&self) -> Result<&str, Rejected> {
        self.text("kind")
    }

    fn text(&self, key: &'static str) -> Result<&str, Rejected> {
        let value = self.required(key)?;
        value.as_str().ok_or_else(|| Rejected::Type {
            key,
            expected: "a string",
            received: value.to_string(),
        })
    }

    pub(super) fn bytes(&self, key: &'static str) -> Result<Vec<u8>, Rejected> {
        hex::bytes(self.text(key)?)
    }

    pub(super) fn object(&self, key: &'static str) -> Result<Self, Rejected> {
        let value = self.required(key)?;
        let received = || Rejected::Type { key, expected: "an object", received: value.to_string() };
        let members = value.as_object().cloned().ok_or_else(received)?;
        Ok(Self { members, profile: self.profile, scale: self.scale })
    }

    pub(super) fn number(&self, key: &'static str) -> Result<f64, Rejected> {
        let value = self.required(key)?;
        value.as_f64().ok_or_else(|| Rejected::Type {
            key,
            expected: "a number",
            received: value.to_string(),
        })
    }

    /// Reads a whole number from `least` to `most`.
    pub(super) fn integer(&self, key: &'static str, least: i64, most: i64) -> Result<i64, Rejected> {
        let number = self.number(key)?;
        let is_whole = number.fract() == 0.0 && (least as f64..=most as f64).contains(&number);
        let refused = || Rejected::Range { key, least, most, received: number.to_string() };
        is_whole.then_some(number as i64).ok_or_else(refused)
    }

    pub(super) fn byte(&self, key: &'static str) -> Result<u8, Rejected> {
        Ok(self.integer(key, 0, 0xFF)? as u8)
    }

    /// Adds a code and, where its scale is known, its physical value.
    pub(super) fn insert_code(&mut self, quantity: &Quantity, code: u16) {
        self.insert(quantity.raw, code);
        if let Some(field) = quantity.field {
            self.insert(quantity.physical, field.decode(code));
        }
    }

    /// Reads the code of `quantity`, given as a code or as a physical value.
    pub(super) fn code(&self, quantity: &Quantity) -> Result<u16, Rejected> {
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
            code => Err(Rejected::Disagree { raw, code, physical, nearest }),
        }
    }
}

/// A quantity that an object has as a code and as a physical value.
pub(super) struct Quantity {
    raw: &'static str,
    physical: &'static str,
    /// `None` for an unknown scale.
    field: Option<Field>,
    code_max: u16,
}

/// The five quantities of a control frame.
pub(super) struct Quantities {
    pub(super) position: Quantity,
    pub(super) velocity: Quantity,
    pub(super) kp: Quantity,
    pub(super) kd: Quantity,
    pub(super) torque: Quantity,
}

impl Quantities {
    /// Returns true when `key` belongs to a quantity of a control frame in `object`. In
    /// `torque_control` the same keys are separate members.
    pub(super) fn have_key(key: &str, object: &Object) -> bool {
        let Self { position, velocity, kp, kd, torque } = object.quantities();
        let has_position = object.has(position.raw) || object.has(position.physical);
        let all = [position, velocity, kp, kd, torque];
        has_position && all.iter().any(|quantity| [quantity.raw, quantity.physical].contains(&key))
    }
}

impl Quantity {
    const fn new(raw: &'static str, physical: &'static str, field: Option<Field>, code_max: u16) -> Self {
        Self { raw, physical, field, code_max }
    }

    fn code(&self, object: &Object) -> Result<u16, Rejected> {
        Ok(object.integer(self.raw, 0, self.code_max.into())? as u16)
    }

    fn nearest(&self, object: &Object) -> Result<u16, Rejected> {
        let physical = self.physical;
        let field = self.field.ok_or(Rejected::NoScale { physical })?;
        let value = object.number(physical)?;
        let received =
            || Rejected::Type { key: physical, expected: "a finite number", received: value.to_string() };
        field.encode(value).ok_or_else(received)
    }
}
