//! Why something cannot be shown.

use monogrid_datasets::DatasetError;
use std::io;
use std::path::PathBuf;

/// Why something cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// Another program has the port.
    #[error(
        "port {port} of this computer cannot be used ({source}); choose another with --port, or 0 \
         for any that is free"
    )]
    Port {
        /// That was asked for.
        port: u16,
        /// What the system says.
        source: io::Error,
    },
    /// The name of a mesh has no ending that is a format.
    #[error(
        "cannot tell the format of the mesh from {}: expected a name that ends in .ply, .glb, \
         .obj, .stl, .dxf or .usdz",
        path.display()
    )]
    MeshFormat {
        /// The name.
        path: PathBuf,
    },
    /// A recording whose colours cannot be read.
    #[error(transparent)]
    Recording(#[from] DatasetError),
    /// The system refuses what a server of pages needs.
    #[error("the server of pages cannot be started: {0}")]
    Server(io::Error),
    /// The system has no random numbers.
    #[error("the address of the page cannot be chosen: {0}")]
    Address(getrandom::Error),
    /// The page cannot be put together.
    #[error("the page cannot be made: {0}")]
    Page(io::Error),
}

impl ReportError {
    /// Whether another input or option helps.
    pub fn is_bad_input(&self) -> bool {
        matches!(
            self,
            Self::Port { .. } | Self::MeshFormat { .. } | Self::Recording(_)
        )
    }
}
