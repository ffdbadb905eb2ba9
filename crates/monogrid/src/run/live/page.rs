//! The page that shows a run while it goes on.

use crate::explorer::{LIVE_POLICY, live_section};
use crate::failure::Failure;
use crate::report::Page;

/// The page.
pub fn page(title: &str) -> Result<String, Failure> {
    let mut page = Page::default();
    page.html(&live_section()?);
    Ok(page.finish_with(title, "This run goes on.", LIVE_POLICY))
}
