//! JSON with a check for repeated keys, which `serde_json::Value` drops.

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};
use std::fmt;

/// A JSON value.
#[derive(Debug)]
pub(super) struct Strict {
    /// The value; of a repeated key, the last one.
    pub(super) value: Value,
    /// The first repeated key in the value or in an object below it.
    pub(super) repeated: Option<String>,
}

impl From<Value> for Strict {
    fn from(value: Value) -> Self {
        Self { value, repeated: None }
    }
}

impl<'de> Deserialize<'de> for Strict {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Reader)
    }
}

struct Reader;

impl<'de> Visitor<'de> for Reader {
    type Value = Strict;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_bool<E>(self, value: bool) -> Result<Strict, E> {
        Ok(Value::from(value).into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Strict, E> {
        Ok(Value::from(value).into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Strict, E> {
        Ok(Value::from(value).into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Strict, E> {
        Ok(Number::from_f64(value).map_or(Value::Null, Value::Number).into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Strict, E> {
        Ok(Value::from(value).into())
    }

    fn visit_unit<E>(self) -> Result<Strict, E> {
        Ok(Value::Null.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Strict, A::Error> {
        let (mut values, mut repeated) = (Vec::new(), None);
        while let Some(item) = items.next_element::<Strict>()? {
            values.push(item.value);
            repeated = repeated.or(item.repeated);
        }
        Ok(Strict { value: Value::Array(values), repeated })
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Strict, A::Error> {
        let (mut map, mut repeated) = (Map::new(), None);
        while let Some((key, member)) = members.next_entry::<String, Strict>()? {
            repeated = repeated.or(member.repeated);
            if map.insert(key.clone(), member.value).is_some() {
                repeated = repeated.or(Some(key));
            }
        }
        Ok(Strict { value: Value::Object(map), repeated })
    }
}
