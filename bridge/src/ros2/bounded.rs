//! Lists of messages with a limit on their length: each byte from the network is hostile.

use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
use serde::ser::{Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// A list of at most `MOST` elements. A longer one is an error, found before its elements are read.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Bounded<T, const MOST: usize>(pub(crate) Vec<T>);

impl<T: Serialize, const MOST: usize> Serialize for Bounded<T, MOST> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'a, T: Deserialize<'a>, const MOST: usize> Deserialize<'a> for Bounded<T, MOST> {
    fn deserialize<D: Deserializer<'a>>(deserializer: D) -> Result<Self, D::Error> {
        struct Elements<T, const MOST: usize>(PhantomData<T>);
        impl<'a, T: Deserialize<'a>, const MOST: usize> Visitor<'a> for Elements<T, MOST> {
            type Value = Vec<T>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "at most {MOST} elements")
            }
            fn visit_seq<S: SeqAccess<'a>>(self, mut elements: S) -> Result<Vec<T>, S::Error> {
                let announced = elements.size_hint().unwrap_or(0);
                if announced > MOST {
                    return Err(S::Error::invalid_length(announced, &self));
                }
                let mut list = Vec::new();
                while let Some(element) = elements.next_element()? {
                    if list.len() == MOST {
                        return Err(S::Error::invalid_length(MOST + 1, &self));
                    }
                    list.push(element);
                }
                Ok(list)
            }
        }
        deserializer.deserialize_seq(Elements::<T, MOST>(PhantomData)).map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::dds::rustdds::RepresentationIdentifier;
    use ros2_client::dds::rustdds::serialization::deserialize_from_cdr_with_rep_id;

    fn decode(bytes: &[u8]) -> Option<Bounded<f64, 2>> {
        let encoding = RepresentationIdentifier::CDR_LE;
        deserialize_from_cdr_with_rep_id(bytes, encoding).ok().map(|(list, _)| list)
    }

    fn list(length: u32, numbers: usize) -> Vec<u8> {
        // Numbers are aligned to 8 bytes.
        let mut bytes = [length.to_le_bytes(), [0; 4]].concat();
        bytes.extend(1.0f64.to_le_bytes().repeat(numbers));
        bytes
    }

    #[test]
    fn list_up_to_the_limit_is_read() {
        assert_eq!(decode(&list(2, 2)), Some(Bounded(vec![1.0; 2])));
        assert_eq!(decode(&list(0, 0)), Some(Bounded(Vec::new())));
    }

    #[test]
    fn longer_or_truncated_list_is_an_error() {
        assert_eq!(decode(&list(3, 3)), None);
        assert_eq!(decode(&list(u32::MAX, 3)), None);
        assert_eq!(decode(&list(2, 1)), None);
        assert_eq!(decode(&[]), None);
    }
}
