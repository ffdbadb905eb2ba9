//! Tests of messages and their bytes; one program, so that it links once.

mod cdr;
mod golden;
