//! Tests of the readers and writers; one program, so that it links once.

mod calibration;
mod calibrations_of_others;
mod check;
mod crafted_recordings;
mod hostile;
mod images;
mod imu;
mod mutations;
mod real_data;
mod recording;
mod register;
mod scans;
mod sources;
mod stereo;
mod submaps;
mod trajectory;
