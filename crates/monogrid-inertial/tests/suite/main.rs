//! Tests of preintegration and of what readings say of a path; one program, so that it links once.

mod estimate;
mod preintegration;
