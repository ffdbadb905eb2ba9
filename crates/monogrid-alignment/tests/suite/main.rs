//! Tests of alignment over both groups; one program, so that it links once.

mod alignment;
mod plane;
mod similarity;
