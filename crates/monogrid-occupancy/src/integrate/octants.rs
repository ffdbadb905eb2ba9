//! The eight halves of a cube of cells.

/// Octants of a cube as bits: bit `x | y << 1 | z << 2`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Octants {
    /// Those that can get anything at all.
    pub touched: u8,
    /// Those whose cells all get the same free update.
    pub free: u8,
    /// Those whose cells get the free update of some measurements or nothing, the free ones
    /// included.
    pub clear: u8,
}

impl Octants {
    /// One of them.
    pub(crate) fn only(self, octant: u8) -> Self {
        let bit = 1 << octant;
        Self {
            touched: self.touched & bit,
            free: self.free & bit,
            clear: self.clear & bit,
        }
    }
}
