//! The curves of the thesis' chapter 5: probability of occupancy over the range.

use monogrid_occupancy::{AndertForm, Buffer, SensorModel, Significance, ThrunForm};
use monogrid_report::svg::{COLOURS, Plot, Series, number};

/// Curves that belong together.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Name of its files.
    pub name: String,
    /// Which parameters it shows.
    pub note: String,
    /// The curves.
    pub plot: Plot,
}

/// Points per curve.
pub const POINTS: usize = 1200;

fn thrun(l: f64) -> SensorModel {
    SensorModel::Thrun {
        buffer: Buffer::Fixed(l),
        form: ThrunForm::Thesis,
    }
}

fn andert(k: f64, form: AndertForm) -> SensorModel {
    SensorModel::Andert {
        significance: Significance::Fixed(k),
        p_min: 0.3,
        form,
    }
}

/// P over the range for a measurement at `z`.
pub fn curve(
    name: impl Into<String>,
    colour: &'static str,
    model: &SensorModel,
    z: f64,
    sigma: f64,
    to: f64,
) -> Series {
    let point = |i| {
        let range = to * i as f64 / POINTS as f64;
        [range, model.probability(range, z, sigma)]
    };
    Series::new(name, colour, (1..=POINTS).map(point).collect())
}

/// A plot of probabilities up to a range.
pub fn plot(title: &str, series: Vec<Series>, to: f64) -> Plot {
    let labels = ["range r, m", "probability of occupancy"];
    Plot {
        ranges: Some([[0.0, to], [0.0, 1.05]]),
        ..Plot::new(title, labels, series)
    }
}

/// A figure.
pub fn figure(name: &str, note: &str, plot: Plot) -> Figure {
    Figure {
        name: name.to_owned(),
        note: note.to_owned(),
        plot,
    }
}

/// Curves of one model over one varying quantity.
fn family(
    quantity: &str,
    values: &[f64],
    to: f64,
    of: impl Fn(f64) -> (SensorModel, f64, f64),
) -> Vec<Series> {
    let curve = |(i, value): (usize, &f64)| {
        let (model, z, sigma) = of(*value);
        let colour = COLOURS[(i * 9 / values.len().max(2)).min(9)];
        let name = format!("{quantity} = {}", number(*value));
        curve(name, colour, &model, z, sigma, to)
    };
    values.iter().enumerate().map(curve).collect()
}

/// Standard deviation of a range of the stereo camera of figure 5.11: baseline 0.3 m, focal length
/// 700 px, disparity known to half a pixel (thesis eq. 5.3.3 and 5.3.4).
fn stereo_sigma(z: f64) -> f64 {
    z * z * 0.5 / (0.3 * 700.0)
}

/// Figures 5.1 to 5.11.
pub fn thesis_figures() -> Vec<Figure> {
    [gaussian_figures(), thrun_figures(), andert_figures()].concat()
}

fn gaussian(mean: f64, sigma: f64, from: f64, to: f64) -> Vec<[f64; 2]> {
    let point = |i| {
        let r = from + (to - from) * i as f64 / POINTS as f64;
        let q = (r - mean) / sigma;
        let norm = sigma * (2.0 * std::f64::consts::PI).sqrt();
        [r, (-0.5 * q * q).exp() / norm]
    };
    (0..=POINTS).map(point).collect()
}

fn gaussian_figures() -> Vec<Figure> {
    let ideal = SensorModel::Ideal {
        buffer: Buffer::Fixed(1.0),
    };
    let one = |name: &str, colour, model: &SensorModel, sigma| {
        curve(name, colour, model, 2.0, sigma, 4.0)
    };
    let alone = |model: &SensorModel, sigma| vec![one("", COLOURS[1], model, sigma)];
    let convolved = vec![
        one("ideal", "#999999", &ideal, 0.3),
        Series::new("noise", COLOURS[6], gaussian(2.0, 0.3, 0.0, 4.0)).dashed(),
        one("convolved", COLOURS[1], &thrun(1.0), 0.3),
    ];
    vec![
        figure(
            "figure-5.1-ideal",
            "Ideal model, z = 2 m, L = 1 m.",
            plot("5.1 Ideal inverse sensor model", alone(&ideal, 0.5), 4.0),
        ),
        noise_figure(),
        figure(
            "figure-5.3-convolution",
            "The ideal model (z = 2 m, L = 1 m) convolved with noise of sigma = 0.3 m.",
            Plot {
                ranges: Some([[0.0, 4.0], [0.0, 1.4]]),
                ..plot("5.3 Convolution", convolved, 4.0)
            },
        ),
        figure(
            "figure-5.4-thrun",
            "Thrun's model in the thesis' closed form (last line of 5.2.12), z = 2 m, sigma = 0.3 \
             m, L = 1 m.",
            plot("5.4 Thrun", alone(&thrun(1.0), 0.3), 4.0),
        ),
    ]
}

fn noise_figure() -> Figure {
    let density = Series::new("", COLOURS[1], gaussian(0.0, 0.5, -2.0, 2.0));
    let labels = ["error of the range, m", "density"];
    let plot = Plot {
        from_zero: true,
        ..Plot::new("5.2 Noise", labels, vec![density])
    };
    let note = "Gaussian noise of the range, sigma = 0.5 m.";
    figure("figure-5.2-noise", note, plot)
}

fn thrun_figures() -> Vec<Figure> {
    let over_l = family("L", &[0.05, 0.1, 0.2, 0.4, 0.8], 2.0, |l| {
        (thrun(l), 1.0, 0.1)
    });
    let over_sigma = family("sigma", &[0.02, 0.05, 0.1, 0.2, 0.4], 2.0, |s| {
        (thrun(0.4), 1.0, s)
    });
    let over_range = family("z", &[1.0, 2.0, 3.0], 6.0, |z| {
        (thrun(0.4), z, 0.05 * z * z)
    });
    let varying = "5.7 Thrun over the range, range-dependent sigma";
    vec![
        figure(
            "figure-5.5-thrun-buffer",
            "z = 1 m, sigma = 0.1 m. Below L = 0.861 sigma the measured range itself is less \
             likely occupied than not.",
            plot("5.5 Thrun over L", over_l, 2.0),
        ),
        figure(
            "figure-5.6-thrun-sigma",
            "z = 1 m, L = 0.4 m.",
            plot("5.6 Thrun over sigma", over_sigma, 2.0),
        ),
        figure(
            "figure-5.7-thrun-range",
            "L = 0.4 m, sigma = 0.05 m at 1 m, growing with the square of the range: the peak \
             moves behind the measurement.",
            plot(varying, over_range, 6.0),
        ),
    ]
}

fn andert_figures() -> Vec<Figure> {
    let mono = |k: f64| andert(k, AndertForm::Monocular);
    let over_range = family("z", &[1.0, 2.0, 3.0, 4.0], 5.0, |z| (mono(0.1), z, 0.1));
    let over_k = family("k", &[0.01, 0.02, 0.05, 0.1, 0.2], 4.0, |k| {
        (mono(k), 3.0, 0.1)
    });
    let over_sigma = family("sigma", &[0.05, 0.1, 0.2, 0.4], 5.0, |s| {
        (mono(0.1), 3.0, s)
    });
    let stereo = family("z", &[4.0, 6.0, 8.0, 10.0, 15.0], 20.0, |z| {
        (andert(0.1, AndertForm::Stereo), z, stereo_sigma(z))
    });
    vec![
        figure(
            "figure-5.8-andert",
            "sigma = 0.1 m, k = 0.1 m, the same at all ranges: one camera.",
            plot("5.8 Andert, monocular", over_range, 5.0),
        ),
        figure(
            "figure-5.9-andert-significance",
            "z = 3 m, sigma = 0.1 m. The peak is limited to 0.97.",
            plot("5.9 Andert over k", over_k, 4.0),
        ),
        figure(
            "figure-5.10-andert-sigma",
            "z = 3 m, k = 0.1 m.",
            plot("5.10 Andert over sigma", over_sigma, 5.0),
        ),
        figure(
            "figure-5.11-andert-stereo",
            "k = 0.1 m; baseline 0.3 m, focal length 700 px, disparity known to half a pixel: \
             sigma grows with the square of the range, also along the ray.",
            plot("5.11 Andert, stereo", stereo, 20.0),
        ),
    ]
}

/// What the thesis does not show: where its closed form and the exact ones part.
pub fn thrun_forms() -> Figure {
    let buffer = Buffer::AUTO;
    let forms = [
        ("exact", ThrunForm::Exact, COLOURS[1]),
        ("thesis", ThrunForm::Thesis, COLOURS[8]),
        ("inverse depth", ThrunForm::InverseDepth, COLOURS[3]),
    ];
    let series = forms.map(|(name, form, colour)| {
        let model = SensorModel::Thrun { buffer, form };
        curve(name, colour, &model, 2.0, 1.6, 8.0)
    });
    let title = "Forms of Thrun's model under large uncertainty";
    figure(
        "thrun-forms",
        "z = 2 m, sigma = 1.6 m (80 %), L = 2.5 sigma: the thesis' form stays below 1/2 behind the \
         obstacle, the form in inverse depth is longer on the far side.",
        plot(title, series.to_vec(), 8.0),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_the_chapter_is_drawn_with_curves_in_range() {
        let figures = thesis_figures();
        let numbers: Vec<String> = (1..=11).map(|n| format!("figure-5.{n}-")).collect();
        assert_eq!(figures.len(), numbers.len());
        for (figure, start) in figures.iter().zip(&numbers) {
            assert!(figure.name.starts_with(start), "{}", figure.name);
            assert!(!figure.plot.series.is_empty());
            for point in figure.plot.series.iter().flat_map(|s| &s.points) {
                assert!(
                    point[1].is_finite() && (0.0..1.4).contains(&point[1]),
                    "{}",
                    figure.name
                );
            }
        }
    }

    #[test]
    fn the_published_curve_has_the_published_values() {
        // thesis figure 5.4: z = 2, sigma = 0.3, L = 1
        let figure = &thesis_figures()[3];
        let at = |r: f64| {
            let points = &figure.plot.series[0].points;
            let nearest = |p: &&[f64; 2]| ((p[0] - r).abs() * 1e9) as u64;
            points.iter().min_by_key(nearest).map(|p| p[1]).unwrap()
        };
        for (r, expected) in [(1.0, 0.0478), (2.0, 0.9283), (3.0, 0.5239)] {
            assert!((at(r) - expected).abs() < 1e-3, "{r}: {}", at(r));
        }
    }
}
