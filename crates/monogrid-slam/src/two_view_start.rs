//! placeholder
use crate::start::StartOutcome;
use crate::frame::Frame;
use crate::*;
#[derive(Debug)]
pub(crate) struct TwoViewStart;
impl TwoViewStart {
    pub(crate) fn new(_: &InitializationConfig, _: u64) -> Self { Self }
    pub(crate) fn add_frame(&mut self, _: Frame, _: &monogrid_geometry::Pinhole, _: &monogrid_image::Mask, _: &SlamConfig) -> StartOutcome { StartOutcome::Waiting(LostReason::NotEnoughParallax) }
}
