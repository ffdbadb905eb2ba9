//! Tests of the readers of videos and streams; one program, so that it links once.

mod budget;
mod files;
mod streams;
mod variants;
