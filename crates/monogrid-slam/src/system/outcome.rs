//! What became of a frame, as the report on it tells.

use crate::frame::Frame;
use crate::tracker::Tracked;
use crate::{FrameReport, InFragment, KeyframeId, LostReason, MAIN_MAP, TrackingState};

/// A frame tracked on a keyframe.
#[derive(Debug)]
pub(super) struct Attempt {
    pub keyframe: KeyframeId,
    pub tracked: Tracked,
    /// Whether the pose of the keyframe is certain.
    pub is_certain: bool,
}

/// What a frame did to the keyframe in use.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct KeyframeChange {
    pub finished: Option<KeyframeId>,
    /// Whether tracking goes on with the frame,
    pub created: bool,
    /// or with a keyframe that existed already.
    pub reactivated: Option<KeyframeId>,
}

impl FrameReport {
    /// What tracking on the keyframe in use says of a frame, believed or not; lost without such a
    /// keyframe.
    pub(super) fn of(frame: &Frame, attempt: Option<&Attempt>) -> Self {
        let mut report = Self::new(frame.index, frame.timestamp_ns, TrackingState::Lost);
        if let Some(attempt) = attempt {
            let tracked = &attempt.tracked;
            let alignment = &tracked.alignment;
            report.state = tracked.state;
            report.reason = tracked.reason;
            report.residual = alignment.residual_rms;
            report.good_share = alignment.good_of_visible;
            report.usage = alignment.usage;
            report.exposure_gain = alignment.gain();
            report.keyframe = Some(attempt.keyframe);
            if tracked.state != TrackingState::Lost {
                report.covariance = alignment.covariance;
            }
            if !attempt.is_certain && tracked.state == TrackingState::Good {
                report.state = TrackingState::Degraded;
                report.reason = Some(LostReason::Loose);
            }
        }
        report
    }

    /// Says where the camera is: in the main map, or in a fragment.
    pub(super) fn place(&mut self, place: InFragment) {
        if place.id == MAIN_MAP {
            self.world_from_camera = Some(place.fragment_from_camera);
        } else {
            self.state = TrackingState::Fragment;
            self.fragment = Some(place);
        }
    }

    /// Says where a camera is that was lost, or had no map before.
    pub(super) fn place_anew(&mut self, place: InFragment) {
        self.place_as(TrackingState::Good, place);
    }

    /// Says where a camera is whose picture was recognised, and how far its pixels agree.
    pub(super) fn place_as(&mut self, state: TrackingState, place: InFragment) {
        self.state = state;
        self.reason = (state != TrackingState::Good).then_some(LostReason::Residuals);
        self.place(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracker::Support;
    use crate::tracker::tests::perfect;
    use monogrid_alignment::Target;
    use monogrid_geometry::Pinhole;
    use monogrid_image::{GrayImage, Pyramid};
    use std::sync::Arc;

    #[test]
    fn a_good_pose_on_a_keyframe_that_is_not_certain_is_degraded() {
        let pinhole = Pinhole {
            fx: 30.0,
            fy: 30.0,
            cx: 16.0,
            cy: 16.0,
        };
        let pyramid = Pyramid::new(GrayImage::filled(32, 32, 0.0), 1);
        let frame = Frame {
            index: 0,
            timestamp_ns: 0,
            target: Target::new(&pyramid, &pinhole, 0, 0),
            pyramid: Arc::new(pyramid),
            measured: None,
        };
        let report = |state, is_certain| {
            let attempt = Attempt {
                keyframe: 0,
                tracked: Tracked {
                    alignment: perfect(1000),
                    is_beyond_gate: false,
                    has_other_gain: false,
                    support: Support::None,
                    state,
                    reason: None,
                },
                is_certain,
            };
            let report = FrameReport::of(&frame, Some(&attempt));
            (report.state, report.reason)
        };
        use TrackingState::{Degraded, Good, Lost};
        assert_eq!(report(Good, true), (Good, None));
        assert_eq!(report(Good, false), (Degraded, Some(LostReason::Loose)));
        assert_eq!(report(Lost, false), (Lost, None));
    }
}
