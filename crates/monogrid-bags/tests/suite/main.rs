//! Tests of the readers and writers of recordings; one program, so that it links once.

mod recordings;
mod variants;
mod written;
