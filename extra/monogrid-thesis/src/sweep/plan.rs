//! What a sweep builds.

use monogrid_mapping::{AutoLength, MappingConfig, SensorModelKind};
use serde::{Deserialize, Serialize};

/// The thesis' resolutions, metres.
pub const RESOLUTIONS: [f64; 5] = [0.008, 0.016, 0.032, 0.064, 0.128];
/// The thesis' values of Thrun's buffer L, metres.
pub const BUFFERS: [f64; 10] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0];
/// The thesis' values of Andert's significance k, metres.
pub const SIGNIFICANCES: [f64; 10] = [0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09];
/// The values that the thesis found best: they stand for their models where one value is enough.
pub const USUAL_BUFFER: f64 = 0.5;
/// See [`USUAL_BUFFER`].
pub const USUAL_SIGNIFICANCE: f64 = 0.02;

/// One way of mapping.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// End points only: the thesis' unprocessed map.
    None,
    /// The ideal model, as thick as the diagonal of a cell.
    Ideal,
    /// Thrun's model in the thesis' form and by its rule, with a fixed buffer L.
    Thrun(f64),
    /// Andert's model by the thesis' rule, with a fixed significance k.
    Andert(f64),
    /// The default settings of this program: parameters from resolution and uncertainty.
    Automatic,
}

impl Model {
    /// The family, for tables.
    pub fn family(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Ideal => "ideal",
            Self::Thrun(_) => "thrun",
            Self::Andert(_) => "andert",
            Self::Automatic => "automatic",
        }
    }

    /// L or k, where the model has one.
    pub fn parameter(self) -> Option<f64> {
        match self {
            Self::Thrun(value) | Self::Andert(value) => Some(value),
            _ => None,
        }
    }

    /// For people.
    pub fn label(self) -> String {
        match self {
            Self::None => "unprocessed".to_owned(),
            Self::Ideal => "ideal".to_owned(),
            Self::Thrun(l) => format!("L = {l}"),
            Self::Andert(k) => format!("k = {k}"),
            Self::Automatic => "automatic".to_owned(),
        }
    }

    /// For people: the family, and L or k where the model has one.
    pub fn caption(self) -> String {
        match self.parameter() {
            Some(_) => format!("{} {}", self.family(), self.label()),
            None => self.label(),
        }
    }

    /// The settings of a map of this kind.
    pub fn mapping(self, resolution: f64) -> MappingConfig {
        let mut config = match self {
            Self::Automatic => MappingConfig::default(),
            _ => MappingConfig::thesis(),
        };
        config.resolution = resolution;
        match self {
            Self::Automatic => {}
            Self::None => config.sensor_model = SensorModelKind::None,
            Self::Ideal => {
                config.sensor_model = SensorModelKind::Ideal;
                config.buffer = AutoLength::Fixed(3_f64.sqrt() * resolution);
            }
            Self::Thrun(l) => {
                config.sensor_model = SensorModelKind::Thrun;
                config.buffer = AutoLength::Fixed(l);
            }
            Self::Andert(k) => {
                config.sensor_model = SensorModelKind::Andert;
                config.significance = AutoLength::Fixed(k);
            }
        }
        config
    }
}

/// One map of the sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// How it is built.
    pub model: Model,
    /// Edge of its cells, metres.
    pub resolution: f64,
}

impl Entry {
    /// Name of its files.
    pub fn name(&self) -> String {
        let parameter = self.model.parameter();
        let parameter = parameter.map_or_else(String::new, |value| format!("-{value}"));
        format!("{}{parameter}-{}", self.model.family(), self.resolution)
    }
}

/// All models: the thesis' and ours.
pub fn models() -> Vec<Model> {
    let alone = [Model::None, Model::Ideal, Model::Automatic].into_iter();
    let thrun = alone.chain(BUFFERS.map(Model::Thrun));
    thrun.chain(SIGNIFICANCES.map(Model::Andert)).collect()
}

/// The models with one value each, for memory and speed.
pub fn usual_models() -> [Model; 5] {
    [
        Model::None,
        Model::Ideal,
        Model::Thrun(USUAL_BUFFER),
        Model::Andert(USUAL_SIGNIFICANCE),
        Model::Automatic,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_map_has_a_name_of_its_own_and_valid_settings() {
        let mut names = BTreeSet::new();
        for resolution in RESOLUTIONS {
            for model in models() {
                let entry = Entry { model, resolution };
                assert!(names.insert(entry.name()), "{}", entry.name());
                model.mapping(resolution).validate().unwrap();
            }
        }
        // per resolution: 10 L, 10 k, ideal, automatic, none
        assert_eq!(names.len(), 5 * 23);
        assert!(usual_models().iter().all(|m| models().contains(m)));
    }
}
