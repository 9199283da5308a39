//! The types of values: their names, and how they are read.

use motord_bus::transport::{Serial, Simulated, SocketCan};
use motord_protocol::imu::{CanProtocol, SerialProtocol};
use motord_protocol::{FAMILIES, MotorProtocol};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Debug;
use std::net::SocketAddr;
use std::path::PathBuf;

use motord_settings::sensor::imu::WhenLost;
use motord_settings::settings::{BeyondRange, FaultPolicy, IpcMode, SafeStop};
use toml::Spanned;
use toml::de::DeValue;

use super::problem::{Wrong, plain};
use super::similar::suggestion;
use super::sort::Sort;
use super::units::short;

/// Why a value is no value of a type.
#[derive(Debug)]
pub(super) enum Misfit {
    /// It is of another sort, or has more digits than an integer.
    Sort,
    /// It is of the sort.
    Value(Wrong),
}

impl From<Wrong> for Misfit {
    fn from(wrong: Wrong) -> Self {
        Self::Value(wrong)
    }
}

/// A type that a key can have.
pub(super) trait Value: Sized {
    /// Its sort, for messages.
    const SORT: Sort;

    /// The value, when it is of this type.
    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit>;

    /// The value as a number, to compare it with a range.
    fn number(&self) -> Option<f64> {
        None
    }

    /// A warning about a valid value.
    fn warning(&self) -> Option<Wrong> {
        None
    }

    /// The texts it can be; empty where it can be any.
    fn choices() -> Vec<&'static str> {
        Vec::new()
    }

    /// As a default in the reference.
    fn default_text(&self) -> String {
        String::new()
    }
}

impl Value for f64 {
    const SORT: Sort = Sort::Number;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        match found {
            DeValue::Float(float) => float.as_str().parse().map_err(|_| Misfit::Sort),
            DeValue::Integer(_) => i64::read(written).map(|integer| integer as Self),
            _ => Err(Misfit::Sort),
        }
    }

    fn number(&self) -> Option<f64> {
        Some(*self)
    }

    fn default_text(&self) -> String {
        format!("{self}")
    }
}

impl Value for i64 {
    const SORT: Sort = Sort::Integer;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        let integer = found.as_integer().ok_or(Misfit::Sort)?;
        Self::from_str_radix(integer.as_str(), integer.radix()).map_err(|_| Misfit::Sort)
    }

    fn number(&self) -> Option<f64> {
        Some(*self as f64)
    }

    fn default_text(&self) -> String {
        format!("{self}")
    }
}

impl Value for bool {
    const SORT: Sort = Sort::Flag;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        found.as_bool().ok_or(Misfit::Sort)
    }

    fn default_text(&self) -> String {
        format!("{self}")
    }
}

impl Value for String {
    const SORT: Sort = Sort::Text;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        found.as_str().map(str::to_owned).ok_or(Misfit::Sort)
    }
}

impl Value for PathBuf {
    const SORT: Sort = Sort::Text;

    /// Path of a file for metrics that ends with `.prom`: Prometheus' node exporter reads no other
    /// names.
    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let text = String::read(written)?;
        let path = Self::from(&text);
        let is_sound = path.is_absolute() && path.extension().is_some_and(|end| end == "prom");
        if is_sound && !text.contains('\0') {
            Ok(path)
        } else {
            Err(Wrong::MetricsFile { path: text }.into())
        }
    }
}

impl Value for SocketAddr {
    const SORT: Sort = Sort::Text;

    /// A loopback address: every process that reaches the address can read the metrics.
    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let text = String::read(written)?;
        let loopback = text.parse().ok().filter(|address: &Self| address.ip().is_loopback());
        loopback.filter(|address| address.port() != 0).ok_or(Wrong::MetricsAddress { address: text }.into())
    }
}

impl Value for [f64; 2] {
    const SORT: Sort = Sort::TwoNumbers;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        let items = found.as_array().ok_or(Misfit::Sort)?;
        let numbers = items.iter().map(f64::read).collect::<Result<Vec<_>, _>>()?;
        <[f64; 2]>::try_from(numbers).map_err(|numbers| Wrong::PositionCount(numbers.len()).into())
    }
}

impl Value for [f64; 3] {
    const SORT: Sort = Sort::ThreeNumbers;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        let items = found.as_array().ok_or(Misfit::Sort)?;
        let angles = items.iter().map(f64::read).collect::<Result<Vec<_>, _>>()?;
        let angles = Self::try_from(angles).map_err(|angles| Wrong::AngleCount(angles.len()))?;
        match angles.iter().find(|angle| !(-360.0..=360.0).contains(*angle)) {
            Some(&value) => {
                let expected = "from -360 to 360 °".to_owned();
                Err(Wrong::OutOfRange { value, expected, hint: String::new() }.into())
            }
            None => Ok(angles),
        }
    }

    /// Small angles, one of them near a multiple of π/2.
    fn warning(&self) -> Option<Wrong> {
        let is_right = |angle: &&f64| {
            let turns = (angle.abs() / FRAC_PI_2).round();
            turns >= 1.0 && (angle.abs() - turns * FRAC_PI_2).abs() < 0.01
        };
        let radians = self.iter().find(is_right).filter(|_| self.iter().all(|angle| angle.abs() <= 6.3))?;
        let degrees = self.map(|angle| short(angle.to_degrees()));
        let cure = format!("[{}]", degrees.join(", "));
        Some(Wrong::RadiansAsDegrees { radians: *radians, cure })
    }

    fn default_text(&self) -> String {
        format!("{self:?}")
    }
}

impl Value for Vec<String> {
    const SORT: Sort = Sort::Texts;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let listed = Vec::<Listed>::read(written)?;
        let names: Self = listed.into_iter().map(|item| item.text).collect();
        let is_host = |name: &String| {
            let is_part = |letter: char| letter.is_ascii_alphanumeric() || "-._".contains(letter);
            !name.is_empty() && name.chars().all(is_part)
        };
        match names.iter().find(|name| !is_host(name)) {
            Some(name) => Err(Wrong::HostName { name: name.clone() }.into()),
            None => Ok(names),
        }
    }
}

/// An item of a list, with its place.
#[derive(Debug, Clone)]
pub(super) struct Listed {
    pub(super) text: String,
    pub(super) offset: usize,
}

impl Value for Vec<Listed> {
    const SORT: Sort = Sort::Texts;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let found = written.get_ref();
        let items = found.as_array().ok_or(Misfit::Sort)?;
        let listed = |item| String::read(item).map(|text| Listed { text, offset: item.span().start });
        items.iter().map(listed).collect()
    }
}

impl<T: Value> Value for Option<T> {
    const SORT: Sort = T::SORT;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        T::read(written).map(Some)
    }

    fn number(&self) -> Option<f64> {
        self.as_ref().and_then(T::number)
    }

    fn choices() -> Vec<&'static str> {
        T::choices()
    }
}

/// One of a few words.
pub(super) trait Choice: Copy + PartialEq + 'static {
    /// Each word and its meaning.
    const WORDS: &'static [(&'static str, Self)];

    /// The word for it.
    fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, choice)| *choice == self).map_or("", |(word, _)| word)
    }
}

impl<C: Choice> Value for C {
    const SORT: Sort = Sort::Text;

    fn read(written: &Spanned<DeValue<'_>>) -> Result<Self, Misfit> {
        let text = String::read(written)?;
        let known = Self::WORDS.iter().find(|(word, _)| *word == text);
        known.map(|(_, choice)| *choice).ok_or_else(|| {
            let hint = suggestion(&text, Self::choices().into_iter());
            Wrong::UnknownWord { word: plain(&text), hint }.into()
        })
    }

    fn choices() -> Vec<&'static str> {
        Self::WORDS.iter().map(|(word, _)| *word).collect()
    }

    fn default_text(&self) -> String {
        format!("`\"{}\"`", self.word())
    }
}

/// `type` of a `[[bus]]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BusType {
    SocketCan,
    Serial,
    Simulated,
}

impl Choice for BusType {
    const WORDS: &'static [(&'static str, Self)] = &[
        (SocketCan::NAME, Self::SocketCan),
        (Serial::NAME, Self::Serial),
        (Simulated::NAME, Self::Simulated),
    ];
}

/// `type` of an `[[imu]]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ImuType {
    Simulated,
    Serial(SerialProtocol),
    Can(CanProtocol),
    External,
}

impl ImuType {
    const COUNT: usize = 2 + SerialProtocol::ALL.len() + CanProtocol::ALL.len();

    /// Returns every type and its word: those without a device, then each protocol.
    const fn words() -> [(&'static str, Self); Self::COUNT] {
        let mut words = [("simulated", Self::Simulated); Self::COUNT];
        words[1] = ("external", Self::External);
        let (mut word, mut index) = (2, 0);
        while word < Self::COUNT {
            let serial = SerialProtocol::ALL.len();
            words[word] = if index < serial {
                (SerialProtocol::ALL[index].name(), Self::Serial(SerialProtocol::ALL[index]))
            } else {
                (CanProtocol::ALL[index - serial].name(), Self::Can(CanProtocol::ALL[index - serial]))
            };
            (word, index) = (word + 1, index + 1);
        }
        words
    }
}

impl Choice for ImuType {
    const WORDS: &'static [(&'static str, Self)] = &Self::words();
}

impl Choice for WhenLost {
    const WORDS: &'static [(&'static str, Self)] = &[("report", Self::Report), ("stop", Self::Stop)];
}

impl Choice for IpcMode {
    const WORDS: &'static [(&'static str, Self)] = &[("timed", Self::Timed), ("spin", Self::Spin)];
}

impl Choice for SafeStop {
    const WORDS: &'static [(&'static str, Self)] =
        &[("damp", Self::Damp), ("hold", Self::Hold), ("stop", Self::Stop)];
}

impl Choice for FaultPolicy {
    const WORDS: &'static [(&'static str, Self)] =
        &[("stop-joint", Self::StopJoint), ("stop-group", Self::StopGroup), ("stop-all", Self::StopAll)];
}

impl Choice for MotorProtocol {
    const WORDS: &'static [(&'static str, Self)] = FAMILIES;
}

impl Choice for BeyondRange {
    const WORDS: &'static [(&'static str, Self)] = &[("stop", Self::Stop), ("wrap", Self::Wrap)];
}
