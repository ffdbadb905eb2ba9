//! `report.html` of a batch: what worked, what did not and why, how the numbers are spread, the worst recordings first.

use super::class::Class;
use super::record::TaskRecord;
use crate::picture::{data_url, shrink};
use crate::report::Page;
use crate::report::svg::{Plot, Series, escape, number};
use monogrid_datasets::{encode_png_rgb, read_rgb};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Recordings that are shown with a picture: more would make the page heavy.
const MAX_CARDS: usize = 120;
/// Width of a picture, at least, px.
const CARD_WIDTH: usize = 320;
/// Names that stand behind a reason.
const MAX_NAMES: usize = 4;

const STYLE: &str = "<style>\
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(220px,100%),1fr));gap:12px;margin:.8em 0}\
.cards figure{background:var(--paper);border:1px solid var(--edge);border-top-width:4px;padding:8px}\
.cards img{border:0;width:100%;aspect-ratio:3/2;object-fit:contain;background:#fff}.cards .none{aspect-ratio:3/2;display:grid;place-items:center;color:var(--faint);border:1px dashed var(--edge)}\
.cards figcaption{font-size:13px;overflow-wrap:anywhere}.cards b{font-size:15px}a{color:inherit}.scroll td,.scroll th{overflow-wrap:break-word}.wide td,.wide th{white-space:nowrap}.wide td:last-child{white-space:normal;min-width:16em}</style>";

/// The page; `runs` is the folder of the runs, `link` how the page refers to it.
pub fn page(name: &str, records: &[TaskRecord], runs: &Path, link: &str) -> String {
    let ordered = worst_first(records);
    let mut page = Page::default();
    page.html(STYLE);
    page.ribbon(&ribbon(records));
    what_happened(&mut page, records);
    reasons(&mut page, &ordered);
    spread(&mut page, records);
    page.heading("The worst first");
    page.html(&cards(&ordered, runs, link));
    if ordered.len() > MAX_CARDS {
        page.note(&format!(
            "The first {MAX_CARDS} of {}; all are below.",
            ordered.len()
        ));
    }
    page.heading("All recordings");
    page.html(&table(&ordered, link));
    let totals = totals(records);
    page.finish(&format!("monogrid: {name}"), &totals)
}

/// By class, then by share of the frames with a pose, then by error.
fn worst_first(records: &[TaskRecord]) -> Vec<&TaskRecord> {
    let mut ordered: Vec<&TaskRecord> = records.iter().collect();
    let error = |record: &TaskRecord| record.metrics.as_ref()?.ate_rmse_m;
    ordered.sort_by(|a, b| {
        let by_class = Reverse(a.class).cmp(&Reverse(b.class));
        let by_coverage = coverage(a)
            .unwrap_or(0.0)
            .total_cmp(&coverage(b).unwrap_or(0.0));
        let by_error = error(b)
            .unwrap_or(-1.0)
            .total_cmp(&error(a).unwrap_or(-1.0));
        by_class
            .then(by_coverage)
            .then(by_error)
            .then(a.name.cmp(&b.name))
    });
    ordered
}

fn coverage(record: &TaskRecord) -> Option<f64> {
    Some(record.metrics.as_ref()?.coverage())
}

fn colour(class: Class) -> &'static str {
    match class {
        Class::Ok => "#2e9e5b",
        Class::Lost => "#e0a800",
        Class::NotStarted => "#2a6fbb",
        Class::BadInput => "#8a8a86",
        Class::Timeout | Class::Failed => "#d9822b",
        Class::Crashed | Class::Killed | Class::NoSpace => "#c7372f",
        Class::Interrupted | Class::Unfinished => "#7d5ba6",
    }
}

/// How many there are of each class, the best first.
fn counts(records: &[TaskRecord]) -> Vec<(Class, usize)> {
    let all = Class::all().iter().map(|class| {
        let of_class = records.iter().filter(|record| record.class == *class);
        (*class, of_class.count())
    });
    all.filter(|(_, count)| *count > 0).collect()
}

fn ribbon(records: &[TaskRecord]) -> Vec<(f64, &'static str, String)> {
    let stripe = |(class, count): (Class, usize)| {
        let share = count as f64 / records.len().max(1) as f64;
        (share, colour(class), format!("{count} {}", class.name()))
    };
    counts(records).into_iter().map(stripe).collect()
}

fn totals(records: &[TaskRecord]) -> String {
    let counts = counts(records).into_iter();
    let said = counts.map(|(class, count)| format!("{count} {}", class.name()));
    let said: Vec<String> = said.collect();
    let metrics = records.iter().filter_map(|record| record.metrics.as_ref());
    let frames: u64 = metrics.map(|metrics| metrics.frames).sum();
    let seconds = records.iter().filter_map(|record| record.cpu_s);
    let hours = seconds.sum::<f64>() / 3600.0;
    let said = said.join(", ");
    format!(
        "{} recordings: {said}. {frames} frames, {} hours of CPU time.",
        records.len(),
        number((hours * 100.0).round() / 100.0)
    )
}

fn what_happened(page: &mut Page, records: &[TaskRecord]) {
    page.heading("What became of them");
    let mut html = String::from("<div class=\"scroll\"><table>");
    for (class, count) in counts(records) {
        let _ = write!(
            html,
            "<tr><td class=\"n\">{count}</td><td class=\"n\">{:.1} %</td><td><span class=\"dot\" style=\"background:{}\"></span>{}</td><td>{}</td></tr>",
            100.0 * count as f64 / records.len() as f64,
            colour(class),
            class.name(),
            escape(&class.meaning())
        );
    }
    page.html(&(html + "</table></div>"));
}

/// A reason without what belongs to one recording alone: its source and numbers.
fn kind_of(record: &TaskRecord) -> String {
    let text = record.reason.replace(&record.source, "SOURCE");
    let mut kind = String::new();
    for character in text.chars() {
        match character.is_ascii_digit() {
            true if kind.ends_with('#') => {}
            true => kind.push('#'),
            false => kind.push(character),
        }
    }
    kind
}

fn reasons(page: &mut Page, ordered: &[&TaskRecord]) {
    let mut kinds: BTreeMap<(Class, String), Vec<&str>> = BTreeMap::new();
    for record in ordered.iter().filter(|record| record.class != Class::Ok) {
        let key = (record.class, kind_of(record));
        kinds.entry(key).or_default().push(&record.name);
    }
    if kinds.is_empty() {
        return;
    }
    page.subheading("Why");
    let mut sorted: Vec<_> = kinds.into_iter().collect();
    sorted.sort_by_key(|(_, names)| Reverse(names.len()));
    let rows = sorted.into_iter().map(|((class, kind), names)| {
        let mut some = names[..names.len().min(MAX_NAMES)].join(", ");
        if names.len() > MAX_NAMES {
            some += ", ...";
        }
        vec![names.len().to_string(), class.name().to_owned(), kind, some]
    });
    let rows: Vec<_> = rows.collect();
    page.html("<div class=\"scroll\">");
    page.table(
        &["how many", "class", "reason (# is a number)", "such as"],
        &rows,
    );
    page.html("</div>");
}

/// Which share of the recordings has at most so much: one curve.
fn cumulative(title: &str, unit: &str, mut values: Vec<f64>) -> Option<Plot> {
    values.sort_by(f64::total_cmp);
    let count = values.len() as f64;
    let middle = *values.get(values.len() / 2)?;
    let steps = values.iter().enumerate().flat_map(|(place, value)| {
        [place, place + 1].map(|below| [*value, 100.0 * below as f64 / count])
    });
    let series = Series {
        name: String::new(),
        colour: "#2a6fbb",
        points: steps.collect(),
        is_dashed: false,
    };
    Some(Plot {
        title: title.to_owned(),
        x_label: format!("{unit}; half have at most {}", number(middle)),
        y_label: "recordings with at most so, %".to_owned(),
        series: vec![series],
        from_zero: true,
        is_panel: true,
        ..Plot::default()
    })
}

fn spread(page: &mut Page, records: &[TaskRecord]) {
    let metrics = || records.iter().filter_map(|record| record.metrics.as_ref());
    let rounded = |value: f64| (value * 1e4).round() / 1e4;
    let plots = [
        cumulative(
            "Frames with a pose",
            "%",
            metrics().map(|m| rounded(100.0 * m.coverage())).collect(),
        ),
        cumulative(
            "Error (ATE)",
            "m",
            metrics()
                .filter_map(|m| m.ate_rmse_m)
                .map(rounded)
                .collect(),
        ),
        cumulative(
            "Speed",
            "frames per second",
            metrics()
                .map(|m| (m.frames_per_second * 10.0).round() / 10.0)
                .collect(),
        ),
        cumulative(
            "Memory",
            "MB",
            records
                .iter()
                .filter_map(|record| Some((record.peak_rss_bytes? as f64 / 1e6).round()))
                .collect(),
        ),
    ];
    page.heading("How the numbers are spread");
    let plots: Vec<Plot> = plots.into_iter().flatten().collect();
    page.panels(&plots);
}

/// Numbers of a recording in one line.
fn line(record: &TaskRecord) -> String {
    let Some(metrics) = &record.metrics else {
        return record.reason.clone();
    };
    let mut text = format!(
        "{:.1} % of {} frames",
        (1000.0 * metrics.coverage()).floor() / 10.0,
        metrics.frames
    );
    if metrics.lost_episodes > 0 {
        text += &format!(", lost {} times", metrics.lost_episodes);
    }
    if let Some(ate) = metrics.ate_rmse_m {
        text += &format!(", error {} m", number(ate));
    }
    text
}

/// The name of a recording, which leads to its report where there is one.
fn linked(record: &TaskRecord, link: &str) -> String {
    let name = escape(&record.name);
    if !record.outputs.contains_key("report.html") {
        return name;
    }
    let address = percent_encoded(&format!("{link}/{}/report.html", record.name));
    format!("<a href=\"{address}\">{name}</a>")
}

/// As addresses hold it: what has a meaning in them is written as bytes.
pub fn percent_encoded(path: &str) -> String {
    let mut text = String::new();
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte) {
            text.push(char::from(byte));
        } else {
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}

fn cards(ordered: &[&TaskRecord], runs: &Path, link: &str) -> String {
    let mut html = String::from("<div class=\"cards\">");
    for record in ordered.iter().take(MAX_CARDS) {
        let picture = match thumbnail(&runs.join(&record.name).join("preview.png")) {
            Some(png) => format!(
                "<img src=\"{}\" alt=\"map of {}\">",
                data_url(&png),
                escape(&record.name)
            ),
            None => "<div class=\"none\">no map</div>".to_owned(),
        };
        let _ = write!(
            html,
            "<figure style=\"border-top-color:{}\">{picture}<figcaption><b>{}</b> · {}<br>{}</figcaption></figure>",
            colour(record.class),
            linked(record, link),
            record.class.name(),
            escape(&line(record))
        );
    }
    html + "</div>"
}

/// A small picture of a map.
fn thumbnail(path: &Path) -> Option<Vec<u8>> {
    let picture = read_rgb(path).ok()??;
    let factor = (picture.width() / CARD_WIDTH).max(1);
    Some(encode_png_rgb(&shrink(&picture, factor)))
}

fn table(ordered: &[&TaskRecord], link: &str) -> String {
    let header = [
        "recording",
        "class",
        "frames",
        "pose, %",
        "lost",
        "loops",
        "error, m",
        "per second",
        "CPU, s",
        "MB",
        "reason",
    ];
    let mut html = String::from("<div class=\"scroll\"><table class=\"wide\"><tr>");
    for cell in header {
        let _ = write!(html, "<th>{cell}</th>");
    }
    html += "</tr>";
    for record in ordered {
        let _ = write!(
            html,
            "<tr><td>{}</td><td><span class=\"dot\" style=\"background:{}\"></span>{}</td>",
            linked(record, link),
            colour(record.class),
            record.class.name()
        );
        for cell in numbers(record) {
            let _ = write!(html, "<td class=\"n\">{cell}</td>");
        }
        let _ = write!(html, "<td>{}</td></tr>", escape(&record.reason));
    }
    html + "</table></div>"
}

/// The columns of numbers of the table.
fn numbers(record: &TaskRecord) -> [String; 8] {
    let metrics = record.metrics.as_ref();
    let of = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
    [
        of(metrics.map(|m| m.frames.to_string())),
        of(metrics.map(|m| format!("{:.1}", (1000.0 * m.coverage()).floor() / 10.0))),
        of(metrics.map(|m| m.lost_episodes.to_string())),
        of(metrics.map(|m| m.loop_closures.to_string())),
        of(metrics.and_then(|m| Some(format!("{:.4}", m.ate_rmse_m?)))),
        of(metrics.map(|m| format!("{:.1}", m.frames_per_second))),
        of(record.cpu_s.map(|seconds| format!("{seconds:.1}"))),
        of(record
            .peak_rss_bytes
            .map(|bytes| format!("{:.0}", bytes as f64 / 1e6))),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::metrics::Metrics;
    use super::*;

    fn record(name: &str, class: &str, tracked: u64, ate: Option<f64>) -> TaskRecord {
        let text = format!(
            r#"{{"format": 1, "name": "{name}", "source": "/d/{name}.mp4", "options": [], "class": "{class}",
            "reason": "cannot read /d/{name}.mp4 at byte 17", "exit_code": 0, "attempts": 1, "version": "0", "settings_sha256": "",
            "input": null, "result_sha256": null, "began_unix_s": 0, "wall_s": 1.0, "timeout_s": null, "cpu_s": 3.5,
            "peak_rss_bytes": 100000000, "metrics": null, "outputs": {{"report.html": {{"bytes": 1, "sha256": ""}}}}}}"#
        );
        let mut record = TaskRecord::parse(&text).unwrap();
        record.metrics = Some(Metrics {
            status: "done".into(),
            frames: 100,
            tracked,
            lost_episodes: 2,
            keyframes: 3,
            loop_closures: 0,
            frames_per_second: 30.0,
            scale: "metric".into(),
            points: 1,
            ate_rmse_m: ate,
            warnings: Vec::new(),
        });
        record
    }

    #[test]
    fn the_worst_comes_first() {
        let all = [
            record("good", "ok", 100, Some(0.01)),
            record("fair", "ok", 100, Some(0.2)),
            record("part", "ok", 91, None),
            record("lost", "lost", 40, None),
            record("crash", "crashed", 0, None),
        ];
        let names: Vec<&str> = worst_first(&all).iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["crash", "lost", "part", "fair", "good"]);
    }

    #[test]
    fn reasons_that_differ_by_names_and_numbers_are_one() {
        let kinds = ["a", "b"].map(|name| kind_of(&record(name, "failed", 0, None)));
        assert_eq!(kinds[0], kinds[1]);
        assert_eq!(kinds[0], "cannot read SOURCE at byte #");
    }

    #[test]
    fn the_page_needs_no_other_file_and_escapes_what_it_is_told() {
        let mut odd = record("a", "failed", 0, None);
        odd.name = "a<b>&\u{fc} #?".to_owned();
        odd.reason = "<script>".to_owned();
        let html = page("<x>", &[odd], Path::new("nowhere"), "../runs");
        assert!(!html.contains("<script>") && !html.contains("<b>&"));
        assert!(html.contains("href=\"../runs/a%3Cb%3E%26%C3%BC%20%23%3F/report.html\""));
        assert!(!html.contains("src=\"http") && html.contains("no map"));
        for records in [&[][..], &[record("one", "ok", 100, None)]] {
            let html = page("b", records, Path::new("nowhere"), "../runs");
            assert!(html.ends_with("</html>\n") && !html.contains("NaN"));
        }
    }
}
