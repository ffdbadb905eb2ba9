//! A panic of any part ends a run, with all that was mapped until then: it is a value here, never
//! swallowed.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a panic says.
#[must_use]
pub fn message_of(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "without a message".to_owned())
}

/// Does some work; what its panic says, if it panics. What it was changing may then be changed in
/// part.
///
/// # Errors
/// The message of the panic.
pub fn attempt<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| message_of(&*panic))
}

#[cfg(test)]
mod tests {
    use super::attempt;

    #[test]
    fn a_panic_is_what_it_says() {
        assert_eq!(attempt(|| 3), Ok(3));
        let said: Result<(), String> = attempt(|| panic!("it fell"));
        assert_eq!(said, Err("it fell".to_owned()));
        let number = 7;
        let said: Result<(), String> = attempt(|| panic!("it fell {number} times"));
        assert_eq!(said, Err("it fell 7 times".to_owned()));
        let said: Result<(), String> = attempt(|| std::panic::panic_any(7));
        assert_eq!(said, Err("without a message".to_owned()));
    }
}
