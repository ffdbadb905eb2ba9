//! Values of settings as they stand in files.

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::Value;

/// A type of numbers that a setting may have.
pub trait SettingValue: Sized {
    /// As it stands in a file.
    fn to_value(&self) -> Value;

    /// From a file.
    ///
    /// # Errors
    /// What was found and what is expected.
    fn of_value(value: &Value) -> Result<Self, String>;
}

/// A word, a switch or a name as it stands in a file.
pub fn to_word<T: Serialize>(value: &T) -> Value {
    Value::try_from(value).unwrap_or_else(|_| Value::String(String::new()))
}

/// A word, a switch or a name from a file.
///
/// # Errors
/// What was found and what is expected.
pub fn of_word<T: DeserializeOwned>(value: &Value) -> Result<T, String> {
    let word = value.clone().try_into();
    word.map_err(|error: toml::de::Error| error.message().to_owned())
}

/// The end of a sentence on a value that is none.
pub fn other(value: &Value, expected: &str) -> String {
    format!("found {value}, expected {expected}")
}

impl SettingValue for f64 {
    fn to_value(&self) -> Value {
        Value::Float(*self)
    }

    fn of_value(value: &Value) -> Result<Self, String> {
        match value {
            Value::Float(number) => Ok(*number),
            Value::Integer(number) => Ok(*number as f64),
            _ => Err(other(value, "a number")),
        }
    }
}

impl SettingValue for f32 {
    fn to_value(&self) -> Value {
        // as it was written: 0.1 in single precision is 0.1
        Value::Float(self.to_string().parse().unwrap_or(f64::NAN))
    }

    fn of_value(value: &Value) -> Result<Self, String> {
        f64::of_value(value).map(|number| number as f32)
    }
}

/// Whole numbers.
macro_rules! whole {
    ($($type:ty),*) => {$(
        impl SettingValue for $type {
            fn to_value(&self) -> Value {
                Value::Integer(i64::try_from(*self).unwrap_or(i64::MAX))
            }

            fn of_value(value: &Value) -> Result<Self, String> {
                let number = value.as_integer().and_then(|number| number.try_into().ok());
                number.ok_or_else(|| other(value, "a whole number"))
            }
        }
    )*};
}
whole!(usize, u32, u8);

impl<T: SettingValue> SettingValue for [T; 2] {
    fn to_value(&self) -> Value {
        Value::Array(self.iter().map(T::to_value).collect())
    }

    fn of_value(value: &Value) -> Result<Self, String> {
        let Some([first, second]) = value.as_array().map(Vec::as_slice) else {
            return Err(other(value, "two numbers, [LOW, HIGH]"));
        };
        Ok([T::of_value(first)?, T::of_value(second)?])
    }
}
