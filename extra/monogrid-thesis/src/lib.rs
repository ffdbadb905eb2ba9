//! What repeats the experiments of the thesis: `monogrid thesis`.
//!
//! [`sweep`] builds maps of recordings with every resolution, sensor model and parameter and
//! compares them, [`sensor_model`] draws the curves of the models ([`curves`]), [`vocabulary`]
//! trains the words of FAB-MAP.
#![deny(missing_docs)]

#[macro_use]
extern crate monogrid_app;

pub mod curves;
pub mod sensor_model;
pub mod sweep;
pub mod vocabulary;

use clap::Subcommand;
use monogrid_app::process::failure::CommandResult;

/// What to repeat.
#[derive(Debug, Subcommand)]
pub enum ThesisCommand {
    /// Every resolution, sensor model and parameter on recordings, with tables and figures
    #[command(
        after_help = "Example: monogrid thesis sweep runs/room/recording.mgk --truth truth.ot \
            --align gt:groundtruth.txt --out sweeps/room"
    )]
    Sweep(sweep::command::SweepArgs),
    /// Curves of the inverse sensor models: probability over range, for any parameters
    #[command(after_help = "Example: monogrid thesis sensor-model --plot curves")]
    SensorModel(sensor_model::SensorModelArgs),
    /// Train the words by which FAB-MAP knows places, on images of many places
    #[command(
        after_help = "Example: monogrid thesis vocabulary recordings/kitchen recordings/office \
            --every 10 --out places.vocabulary"
    )]
    Vocabulary(vocabulary::VocabularyArgs),
}

impl ThesisCommand {
    /// Does it.
    ///
    /// # Errors
    /// Bad input, or what went wrong meanwhile.
    pub fn execute(&self) -> CommandResult {
        match self {
            Self::Sweep(args) => sweep::command::execute(args),
            Self::SensorModel(args) => sensor_model::execute(args),
            Self::Vocabulary(args) => vocabulary::execute(args),
        }
    }
}
