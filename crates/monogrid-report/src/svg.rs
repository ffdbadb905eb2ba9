//! Plots as SVG text: lines over a horizontal axis, and curves in the plane.

use std::fmt::Write;

/// One curve. Gaps are `NaN`.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Name in the legend; empty for none.
    pub name: String,
    /// CSS colour.
    pub colour: &'static str,
    /// Points.
    pub points: Vec<[f64; 2]>,
    /// Whether the line is dashed.
    pub is_dashed: bool,
}

impl Series {
    /// A solid line.
    pub fn new(name: impl Into<String>, colour: &'static str, points: Vec<[f64; 2]>) -> Self {
        Self {
            name: name.into(),
            colour,
            points,
            is_dashed: false,
        }
    }

    /// The same as a dashed line.
    pub fn dashed(self) -> Self {
        Self {
            is_dashed: true,
            ..self
        }
    }
}

/// Colours that can be told apart, for curves of one plot.
pub const COLOURS: [&str; 10] = [
    "#4a3aa7", "#2a6fbb", "#1f9bb5", "#1f9e77", "#66a61e", "#b8a000", "#e08a1e", "#d95f02",
    "#c7372f", "#8c1d5a",
];

/// A plot.
#[derive(Debug, Clone, Default)]
pub struct Plot {
    /// Text above.
    pub title: String,
    /// Text below the horizontal axis.
    pub x_label: String,
    /// Text at the vertical axis.
    pub y_label: String,
    /// What is drawn, the last one on top.
    pub series: Vec<Series>,
    /// One unit has the same length on both axes.
    pub equal_axes: bool,
    /// Start the vertical axis at zero.
    pub from_zero: bool,
    /// Ranges of both axes; by default those of the points.
    pub ranges: Option<[[f64; 2]; 2]>,
    /// A small panel of about equal sides, with its legend inside at the lower right.
    pub is_panel: bool,
}

const SIZE: [f64; 2] = [760.0, 240.0];
const SIZE_EQUAL: [f64; 2] = [760.0, 520.0];
const SIZE_PANEL: [f64; 2] = [420.0, 380.0];
/// How the parts of a plot look.
pub const STYLE: &str = "\
svg .title{font:600 14px system-ui,sans-serif}svg .tick{font:11px system-ui,sans-serif;fill:#666}\
svg .label{font:12px system-ui,sans-serif;fill:#444}svg .grid{stroke:#ececea;fill:none}\
svg .line{fill:none;stroke-width:1.6;stroke-linejoin:round}";
const MARGIN: [f64; 4] = [30.0, 15.0, 42.0, 62.0]; // top, right, bottom, left
/// Curves are thinned to about this many points: more cannot be seen and make the page heavy.
const MAX_POINTS: usize = 1500;

impl Plot {
    /// Curves with texts above them, below the horizontal axis and at the vertical one.
    pub fn new(title: impl Into<String>, labels: [&str; 2], series: Vec<Series>) -> Self {
        let [x_label, y_label] = labels.map(str::to_owned);
        Self {
            title: title.into(),
            x_label,
            y_label,
            series,
            ..Self::default()
        }
    }

    fn size(&self) -> [f64; 2] {
        match (self.is_panel, self.equal_axes) {
            (true, _) => SIZE_PANEL,
            (false, true) => SIZE_EQUAL,
            (false, false) => SIZE,
        }
    }

    /// The plot as a file of its own.
    pub fn file(&self) -> String {
        let [width, height] = self.size();
        let opening = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" "
        );
        let style = format!("><style>{STYLE}</style>");
        let svg = self.render().replacen("<svg ", &opening, 1);
        svg.replacen('>', &style, 1)
    }

    /// The points of all curves: one line each.
    pub fn csv(&self) -> String {
        let plain = |text: &str| text.replace([',', '"'], "");
        let mut text = format!("curve,{},{}\n", plain(&self.x_label), plain(&self.y_label));
        for series in &self.series {
            for [x, y] in &series.points {
                let _ = writeln!(text, "{},{x:.6},{y:.6}", plain(&series.name));
            }
        }
        text
    }

    /// The plot as an `<svg>` element.
    pub fn render(&self) -> String {
        let [width, height] = self.size();
        let [top, right, bottom, left] = MARGIN;
        let (inner_width, inner_height) = (width - left - right, height - top - bottom);
        let [mut xs, mut ys] = self.ranges.unwrap_or_else(|| self.data_ranges());
        if self.equal_axes {
            equalise(&mut xs, &mut ys, inner_width / inner_height);
        }
        let px = |x: f64| left + (x - xs[0]) / (xs[1] - xs[0]) * inner_width;
        let py = |y: f64| top + (ys[1] - y) / (ys[1] - ys[0]) * inner_height;
        let mut svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{0}\">\
             <text class=\"title\" x=\"{left}\" y=\"18\">{0}</text>",
            escape(&self.title)
        );
        self.draw_grid(&mut svg, [xs, ys], &px, &py);
        for series in &self.series {
            draw_series(&mut svg, series, &px, &py);
        }
        self.draw_legend(&mut svg);
        svg.push_str("</svg>");
        svg
    }

    fn data_ranges(&self) -> [[f64; 2]; 2] {
        let mut ranges = [0, 1].map(|axis| {
            let points = || self.series.iter().flat_map(|series| &series.points);
            let finite = || points().filter(|p| p[0].is_finite() && p[1].is_finite());
            let values = || finite().map(|p| p[axis]);
            let low = values().fold(f64::INFINITY, f64::min);
            let high = values().fold(f64::NEG_INFINITY, f64::max);
            if low > high {
                [0.0, 1.0]
            } else if high - low < 1e-9 * high.abs().max(1e-9) {
                [low - 0.5, high + 0.5]
            } else {
                [low, high]
            }
        });
        let [low, high] = &mut ranges[1];
        if self.from_zero {
            *low = low.min(0.0);
        }
        let pad = 0.04 * (*high - *low);
        *high += pad;
        if !self.from_zero {
            *low -= pad;
        }
        ranges
    }

    fn draw_grid(
        &self,
        svg: &mut String,
        [xs, ys]: [[f64; 2]; 2],
        px: &dyn Fn(f64) -> f64,
        py: &dyn Fn(f64) -> f64,
    ) {
        let [top, right, bottom, left] = MARGIN;
        let [width, height] = self.size();
        let (x_end, y_end) = (width - right, height - bottom);
        for tick in ticks(xs, if self.is_panel { 5 } else { 8 }) {
            let (x, y, text) = (px(tick), y_end + 15.0, number(tick));
            *svg += &format!(
                "<path class=\"grid\" d=\"M{x:.1} {top}V{y_end}\"/><text class=\"tick\" \
                 x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{text}</text>"
            );
        }
        for tick in ticks(ys, 5) {
            let (y, text) = (py(tick), number(tick));
            let (x, base) = (left - 6.0, y + 4.0);
            *svg += &format!(
                "<path class=\"grid\" d=\"M{left} {y:.1}H{x_end}\"/><text class=\"tick\" \
                 x=\"{x:.1}\" y=\"{base:.1}\" text-anchor=\"end\">{text}</text>"
            );
        }
        let (x, y, bottom) = (0.5 * (left + x_end), 0.5 * (top + y_end), height - 8.0);
        let (x_label, y_label) = (escape(&self.x_label), escape(&self.y_label));
        *svg += &format!(
            "<text class=\"label\" x=\"{x:.1}\" y=\"{bottom:.1}\" \
             text-anchor=\"middle\">{x_label}</text><text class=\"label\" transform=\"translate(14 \
             {y:.1}) rotate(-90)\" text-anchor=\"middle\">{y_label}</text>"
        );
    }

    fn draw_legend(&self, svg: &mut String) {
        let [width, height] = self.size();
        let [mut x, mut y] = match self.is_panel {
            true => [width - MARGIN[1] - 6.0, height - MARGIN[2] - 8.0],
            false => [width - MARGIN[1], 18.0],
        };
        for series in self.series.iter().rev().filter(|s| !s.name.is_empty()) {
            let (colour, name) = (series.colour, escape(&series.name));
            *svg += &format!(
                "<text class=\"tick\" x=\"{x:.0}\" y=\"{y:.0}\" text-anchor=\"end\" \
                 style=\"fill:{colour}\">{name}</text>"
            );
            match self.is_panel {
                true => y -= 14.0,
                false => x -= 7.0 * series.name.chars().count() as f64 + 14.0,
            }
        }
    }
}

/// Widens one of the ranges so that both have the given ratio of lengths.
fn equalise(xs: &mut [f64; 2], ys: &mut [f64; 2], ratio: f64) {
    let grow = |range: &mut [f64; 2], length: f64| {
        let centre = 0.5 * (range[0] + range[1]);
        *range = [centre - 0.5 * length, centre + 0.5 * length];
    };
    let (width, height) = (xs[1] - xs[0], ys[1] - ys[0]);
    if width < height * ratio {
        grow(xs, height * ratio);
    } else {
        grow(ys, width / ratio);
    }
}

fn draw_series(
    svg: &mut String,
    series: &Series,
    px: &dyn Fn(f64) -> f64,
    py: &dyn Fn(f64) -> f64,
) {
    let step = series.points.len().div_ceil(MAX_POINTS).max(1);
    let last = series.points.len().saturating_sub(1);
    let mut path = String::new();
    let mut pen_down = false;
    for (i, point) in series.points.iter().enumerate() {
        let [x, y] = *point;
        if !(x.is_finite() && y.is_finite()) {
            pen_down = false;
        } else if i % step == 0 || i == last || !pen_down {
            let command = if pen_down { 'L' } else { 'M' };
            let _ = write!(path, "{command}{:.1} {:.1}", px(x), py(y));
            pen_down = true;
        }
    }
    let dashes = match series.is_dashed {
        true => " stroke-dasharray=\"5 4\"",
        false => "",
    };
    let colour = series.colour;
    let _ = write!(
        svg,
        "<path class=\"line\" d=\"{path}\" stroke=\"{colour}\"{dashes}/>"
    );
}

/// Round numbers inside the range, about `count` of them.
fn ticks(range: [f64; 2], count: usize) -> Vec<f64> {
    let raw = (range[1] - range[0]) / count as f64;
    let magnitude = 10f64.powf(raw.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * magnitude);
    let step = steps.into_iter().find(|step| *step >= raw);
    let step = step.unwrap_or(10.0 * magnitude);
    let first = (range[0] / step).ceil() as i64;
    let last = (range[1] / step).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// A number without superfluous digits.
pub fn number(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude != 0.0 && !(1e-3..1e6).contains(&magnitude) {
        return format!("{value:.1e}");
    }
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

/// Text that is safe inside HTML and SVG.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let all = ticks([-0.13, 1.02], 5);
        assert_eq!(all.len(), 3);
        for (tick, expected) in all.iter().zip([0.0, 0.5, 1.0]) {
            assert!((tick - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn gaps_lift_the_pen_and_odd_values_do_no_harm() {
        let plot = |points: Vec<[f64; 2]>| Plot {
            title: "a < b".into(),
            x_label: "x".into(),
            y_label: "y".into(),
            series: vec![Series {
                name: "s".into(),
                colour: "red",
                points,
                is_dashed: true,
            }],
            ..Plot::default()
        };
        let gap = plot(vec![[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0], [3.0, 2.0]]).render();
        let line = gap.split("class=\"line\" d=\"").nth(1).unwrap();
        let line = line.split('"').next().unwrap();
        assert_eq!(line.matches('M').count(), 2);
        assert_eq!(line.matches('L').count(), 1);
        assert!(gap.contains("a &lt; b") && gap.contains("stroke-dasharray"));
        let one_point = plot(vec![[0.0, 1.0]]);
        assert_eq!(one_point.csv(), "curve,x,y\ns,0.000000,1.000000\n");
        let file = one_point.file();
        assert!(file.starts_with("<svg xmlns=") && file.contains("><style>svg .title"));
        for points in [vec![], vec![[1.0, 1.0]], vec![[f64::INFINITY, 0.0]]] {
            let svg = plot(points).render();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(0.5), "0.5");
        assert_eq!(number(-0.0), "0");
        assert_eq!(number(1200.0), "1200");
        assert_eq!(number(1e-7), "1.0e-7");
    }
}
