//! An inertial sensor that is read while the camera is: an image is tracked when the readings have
//! come to its time, or the next image has.

use crate::read_frame::ReadFrame;
use monogrid_slam::FrameReport;

/// Time from the first keyframe that was finished until the readings are asked for metres and up,
/// ns, and how much longer each time is than the one before: the answer becomes better with the
/// length of the path, and costs as much as the path is long.
const FIRST_QUESTION_NS: i64 = 2_000_000_000;
const LATER_BY: f64 = 1.5;

/// What waits for readings, and when they are asked.
#[derive(Debug, Default)]
pub(crate) struct LiveReadings {
    /// Time of the newest reading; none before the first one, when nobody waits.
    newest_ns: Option<i64>,
    waiting: Option<ReadFrame>,
    questions: Option<Questions>,
}

/// When the readings are asked for metres and up.
#[derive(Clone, Copy, Debug)]
struct Questions {
    first_ns: i64,
    /// After the first, ns.
    next_ns: i64,
}

impl LiveReadings {
    /// Takes a frame, which waits if readings until its time are missing; the one to track now:
    /// this one, or the one that has waited, for which the next image is the end of waiting.
    pub(crate) fn take_frame(&mut self, frame: ReadFrame) -> Option<ReadFrame> {
        match self.newest_ns {
            Some(newest_ns) if newest_ns < frame.timestamp_ns => self.waiting.replace(frame),
            _ => Some(frame),
        }
    }

    /// Readings have come to a time; the frame that waited for them.
    pub(crate) fn take_readings(&mut self, newest_ns: i64) -> Option<ReadFrame> {
        let newest_ns = self.newest_ns.map_or(newest_ns, |ns| ns.max(newest_ns));
        self.newest_ns = Some(newest_ns);
        self.waiting
            .take_if(|frame| frame.timestamp_ns <= newest_ns)
    }

    /// The frame that waits; it waits no longer.
    pub(crate) fn take_waiting(&mut self) -> Option<ReadFrame> {
        self.waiting.take()
    }

    /// The number of frames that wait.
    pub(crate) fn num_waiting(&self) -> usize {
        usize::from(self.waiting.is_some())
    }

    /// Whether it is time, after this frame, to ask the readings for metres and up.
    pub(crate) fn is_question_due(&mut self, report: &FrameReport) -> bool {
        if self.newest_ns.is_none() || report.finished_keyframe.is_none() {
            return false;
        }
        let now_ns = report.timestamp_ns;
        let questions = self.questions.get_or_insert(Questions {
            first_ns: now_ns,
            next_ns: FIRST_QUESTION_NS,
        });
        let passed_ns = now_ns - questions.first_ns;
        let is_due = passed_ns >= questions.next_ns;
        if is_due {
            questions.next_ns = (LATER_BY * passed_ns as f64) as i64;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_slam::TrackingState;

    const SECOND_NS: i64 = 1_000_000_000;

    fn frame(timestamp_ns: i64) -> ReadFrame {
        ReadFrame {
            index: 0,
            timestamp_ns,
            image: None,
            depth: None,
            readout_ms: 0.0,
            rectification: None,
            due: None,
        }
    }

    fn time(frame: Option<ReadFrame>) -> Option<i64> {
        frame.map(|frame| frame.timestamp_ns)
    }

    #[test]
    fn an_image_waits_for_its_readings_and_no_longer_than_until_the_next() {
        let mut live = LiveReadings::default();
        assert_eq!(time(live.take_frame(frame(5))), Some(5), "no sensor yet");
        assert_eq!(time(live.take_readings(9)), None);
        assert_eq!(time(live.take_frame(frame(9))), Some(9), "all is known");
        assert_eq!(time(live.take_frame(frame(20))), None);
        assert_eq!(live.num_waiting(), 1);
        assert_eq!(time(live.take_readings(19)), None, "not all of them");
        assert_eq!(time(live.take_readings(12)), None, "late ones");
        assert_eq!(time(live.take_readings(20)), Some(20));
        // the sensor falls silent
        assert_eq!(time(live.take_frame(frame(30))), None);
        assert_eq!(time(live.take_frame(frame(40))), Some(30));
        assert_eq!(live.num_waiting(), 1);
        assert_eq!(time(live.take_waiting()), Some(40));
        assert_eq!(live.num_waiting(), 0);
    }

    #[test]
    fn readings_are_asked_ever_more_seldom() {
        let mut live = LiveReadings::default();
        let finished = |secs: i64, live: &mut LiveReadings| {
            let mut report = FrameReport::new(0, secs * SECOND_NS, TrackingState::Good);
            assert!(!live.is_question_due(&report), "no keyframe");
            report.finished_keyframe = Some(0);
            live.is_question_due(&report)
        };
        assert!((0..9).all(|secs| !finished(secs, &mut live)), "no sensor");
        live.take_readings(0);
        let asked = (10..60).filter(|secs| finished(*secs, &mut live));
        assert_eq!(
            asked.collect::<Vec<i64>>(),
            [12, 13, 15, 18, 22, 28, 37, 51]
        );
    }
}
