//! Semi-dense inverse-depth filter.
