//! What became of a frame, and the report that is made of it.

use crate::frame::BufferedFrame;
use crate::tracker::Tracked;
use crate::{FragmentId, FrameReport, InFragment, KeyframeId, LostReason, MAIN_MAP, TrackingState};
use monogrid_alignment::Alignment;
use monogrid_geometry::Se3;

/// What the stages found about a frame.
#[derive(Debug)]
pub(super) struct FrameOutcome {
    /// The frame on the keyframe in use, believed or not; none without such a keyframe.
    pub attempt: Option<Attempt>,
    pub localised: Localised,
    pub change: KeyframeChange,
    /// Odometry, where it was told already.
    pub odom_from_camera: Option<Se3>,
    /// A map or fragment that began with this frame.
    pub begun: Option<Begun>,
}

/// A frame tracked on a keyframe.
#[derive(Debug)]
pub(super) struct Attempt {
    pub keyframe: KeyframeId,
    pub tracked: Tracked,
    /// Why its pose is to be doubted after the frames before it, if it is.
    pub doubt: Option<LostReason>,
}

/// How a frame got its pose, or why it has none.
#[derive(Debug)]
pub(super) enum Localised {
    /// There is no map yet.
    Waiting(LostReason),
    /// The image is the one before.
    Repeated {
        place: InFragment,
        keyframe: KeyframeId,
        gain: f32,
    },
    /// Tracked on the keyframe in use.
    Tracked(InFragment),
    /// Recognised at a keyframe, and aligned there.
    Relocalised {
        place: InFragment,
        keyframe: KeyframeId,
        alignment: Box<Alignment>,
    },
    /// A map begins where the camera is.
    Begun(InFragment),
    /// Nowhere.
    Lost(Option<LostReason>),
}

/// What a frame did to the keyframe in use.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct KeyframeChange {
    pub finished: Option<KeyframeId>,
    pub next: Option<NextKeyframe>,
}

/// The keyframe with which tracking goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NextKeyframe {
    Created,
    Reactivated(KeyframeId),
}

/// A map or fragment that began.
#[derive(Debug)]
pub(super) struct Begun {
    /// The fragment, where one was begun.
    pub fragment: Option<FragmentId>,
    pub keyframe: KeyframeId,
    /// Frames after the keyframe, which waited for it.
    pub later: Vec<BufferedFrame>,
}

impl Attempt {
    /// Whether the frame has a pose.
    pub(super) fn is_believed(&self) -> bool {
        self.tracked.state != TrackingState::Lost
    }
}

impl FrameOutcome {
    pub(super) fn new(attempt: Option<Attempt>, localised: Localised) -> Self {
        Self {
            attempt,
            localised,
            change: KeyframeChange::default(),
            odom_from_camera: None,
            begun: None,
        }
    }

    /// The report on a frame.
    pub(super) fn report(&self, index: usize, timestamp_ns: i64) -> FrameReport {
        let attempt = self.attempt.as_ref();
        let mut report = self.localised.report_of(attempt, index, timestamp_ns);
        report.finished_keyframe = self.change.finished;
        match self.change.next {
            Some(NextKeyframe::Created) => report.created_keyframe = true,
            Some(NextKeyframe::Reactivated(id)) => report.reactivated_keyframe = Some(id),
            None => {}
        }
        if let Some(begun) = &self.begun {
            report.created_keyframe = true;
            report.keyframe = Some(begun.keyframe);
            report.started_fragment = begun.fragment;
        }
        report
    }
}

fn report_attempt(attempt: &Attempt, report: &mut FrameReport) {
    let alignment = &attempt.tracked.alignment;
    report.state = attempt.tracked.state;
    report.reason = attempt.tracked.reason;
    if attempt.doubt.is_some() && report.state == TrackingState::Good {
        report.state = TrackingState::Degraded;
        report.reason = attempt.doubt;
    }
    report.residual = alignment.residual_rms;
    report.good_share = alignment.good_of_visible;
    report.usage = alignment.usage;
    report.exposure_gain = alignment.gain();
    report.keyframe = Some(attempt.keyframe);
    if attempt.is_believed() {
        report.covariance = alignment.covariance;
    }
}

impl Localised {
    /// The report on a frame as far as it is known before it does anything to keyframes.
    pub(super) fn report_of(
        &self,
        attempt: Option<&Attempt>,
        index: usize,
        timestamp_ns: i64,
    ) -> FrameReport {
        let mut report = FrameReport::new(index, timestamp_ns, TrackingState::Lost);
        if let Some(attempt) = attempt {
            report_attempt(attempt, &mut report);
        }
        self.report(&mut report);
        report
    }

    fn report(&self, report: &mut FrameReport) {
        match self {
            Self::Waiting(reason) => {
                report.state = TrackingState::Initialising;
                report.reason = Some(*reason);
            }
            Self::Repeated {
                place,
                keyframe,
                gain,
            } => {
                report.state = TrackingState::Good;
                report.reason = Some(LostReason::Repeated);
                report.keyframe = Some(*keyframe);
                report.exposure_gain = *gain;
                report_place(place, report);
            }
            Self::Tracked(place) => report_place(place, report),
            Self::Relocalised {
                place,
                keyframe,
                alignment,
            } => {
                report.state = TrackingState::Good;
                report.reason = None;
                report.relocalised = true;
                report.keyframe = Some(*keyframe);
                report.covariance = alignment.covariance;
                report.exposure_gain = alignment.gain();
                report_place(place, report);
            }
            Self::Begun(place) => {
                report.state = TrackingState::Good;
                report.reason = None;
                report_place(place, report);
            }
            Self::Lost(reason) => report.reason = *reason,
        }
    }
}

/// Says where the camera is: in the main map, or in a fragment.
fn report_place(place: &InFragment, report: &mut FrameReport) {
    if place.id == MAIN_MAP {
        report.world_from_camera = Some(place.fragment_from_camera);
    } else {
        report.state = TrackingState::Fragment;
        report.fragment = Some(*place);
    }
}
