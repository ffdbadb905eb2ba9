//! `report.html` of a batch: what worked, what did not and why, how the numbers are spread, the
//! worst recordings first.

use super::class::Class;
use super::metrics::Metrics;
use super::record::TaskRecord;
use monogrid_datasets::{encode_png_rgb, read_rgb};
use monogrid_report::page::{Page, image, row};
use monogrid_report::picture::shrink;
use monogrid_report::svg::{Plot, Series, escape, number};
use std::cmp::Reverse;
use std::collections::BTreeMap;

use std::path::Path;

/// Recordings that are shown with a picture: more would make the page heavy.
const MAX_CARDS: usize = 120;
/// Width of a picture, at least, px.
const CARD_WIDTH: usize = 320;
/// Names that stand behind a reason.
const MAX_NAMES: usize = 4;

const STYLE: &str = "\
<style>.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(220px,100%),1fr));\
gap:12px;margin:.8em 0}\
.cards figure{background:var(--paper);border:1px solid var(--edge);border-top-width:4px;\
padding:8px}.cards img{border:0;width:100%;aspect-ratio:3/2;object-fit:contain;background:#fff}\
.cards .none{aspect-ratio:3/2;display:grid;place-items:center;color:var(--faint);\
border:1px dashed var(--edge)}.cards figcaption{font-size:13px;overflow-wrap:anywhere}\
.cards b{font-size:15px}a{color:inherit}.scroll td,.scroll th{overflow-wrap:break-word}\
.wide td,.wide th{white-space:nowrap}.wide td:last-child{white-space:normal;min-width:16em}\
</style>";

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
    let coverage = |r: &TaskRecord| r.metrics.as_ref().map_or(0.0, Metrics::coverage);
    let ate = |r: &TaskRecord| r.metrics.as_ref()?.ate_rmse_m;
    let error = |r: &TaskRecord| ate(r).unwrap_or(-1.0);
    ordered.sort_by(|a, b| {
        let by_class = b.class.cmp(&a.class);
        let by_coverage = coverage(a).total_cmp(&coverage(b));
        let by_error = error(b).total_cmp(&error(a));
        let by_number = by_class.then(by_coverage).then(by_error);
        by_number.then_with(|| a.name.cmp(&b.name))
    });
    ordered
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

/// The name of a class behind a dot of its colour.
fn dotted(class: Class) -> String {
    let (colour, name) = (colour(class), class.name());
    format!("<span class=\"dot\" style=\"background:{colour}\"></span>{name}")
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
        let percent = 100.0 * count as f64 / records.len() as f64;
        let (class, meaning) = (dotted(class), escape(&class.meaning()));
        html += &format!(
            "<tr><td class=\"n\">{count}</td><td class=\"n\">{percent:.1} \
             %</td><td>{class}</td><td>{meaning}</td></tr>"
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
    let series = Series::new("", "#2a6fbb", steps.collect());
    let half = format!("{unit}; half have at most {}", number(middle));
    let labels = [half.as_str(), "recordings with at most so, %"];
    Some(Plot {
        from_zero: true,
        is_panel: true,
        ..Plot::new(title, labels, vec![series])
    })
}

fn spread(page: &mut Page, records: &[TaskRecord]) {
    let metrics = || records.iter().filter_map(|record| record.metrics.as_ref());
    let rounded = |value: f64| (value * 1e4).round() / 1e4;
    let per_second = |m: &Metrics| (m.frames_per_second * 10.0).round() / 10.0;
    let megabytes = |record: &TaskRecord| Some((record.peak_rss_bytes? as f64 / 1e6).round());
    let poses = metrics().map(|m| rounded(100.0 * m.coverage())).collect();
    let errors = metrics().filter_map(|m| m.ate_rmse_m);
    let errors = errors.map(rounded).collect();
    let rates = metrics().map(per_second).collect();
    let memory = records.iter().filter_map(megabytes).collect();
    let plots = [
        cumulative("Frames with a pose", "%", poses),
        cumulative("Error (ATE)", "m", errors),
        cumulative("Speed", "frames per second", rates),
        cumulative("Memory", "MB", memory),
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
    let encoded = |byte: u8| match byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    path.bytes().map(encoded).collect()
}

fn cards(ordered: &[&TaskRecord], runs: &Path, link: &str) -> String {
    let mut html = String::from("<div class=\"cards\">");
    for record in ordered.iter().take(MAX_CARDS) {
        let picture = match thumbnail(&runs.join(&record.name).join("preview.png")) {
            Some(png) => image(&png, &format!("map of {}", escape(&record.name))),
            None => "<div class=\"none\">no map</div>".to_owned(),
        };
        let (colour, class) = (colour(record.class), record.class.name());
        let (name, line) = (linked(record, link), escape(&line(record)));
        html += &format!(
            "<figure style=\"border-top-color:{colour}\">{picture}<figcaption><b>{name}</b> · \
             {class}<br>{line}</figcaption></figure>"
        );
    }
    html + "</div>"
}

/// A small picture of a map.
fn thumbnail(path: &Path) -> Option<Vec<u8>> {
    let picture = read_rgb(path).ok()??;
    let factor = (picture.width() / CARD_WIDTH).max(1);
    Some(encode_png_rgb(&shrink(&picture, factor, |pixel| pixel)))
}

fn table(ordered: &[&TaskRecord], link: &str) -> String {
    let header = "recording|class|frames|pose, %|lost|loops|error, m|per second|CPU, s|MB|reason";
    let header: Vec<&str> = header.split('|').collect();
    let mut html = String::from("<div class=\"scroll\"><table class=\"wide\">");
    html += &row("th", &header);
    for record in ordered {
        let (name, class) = (linked(record, link), dotted(record.class));
        let numbers = numbers(record).map(|cell| format!("<td class=\"n\">{cell}</td>"));
        let (numbers, reason) = (numbers.concat(), escape(&record.reason));
        html += &format!("<tr><td>{name}</td><td>{class}</td>{numbers}<td>{reason}</td></tr>");
    }
    html + "</table></div>"
}

/// The columns of numbers of the table.
fn numbers(record: &TaskRecord) -> [String; 8] {
    let (metrics, bytes) = (record.metrics.as_ref(), record.peak_rss_bytes);
    let of = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
    [
        of(metrics.map(|m| m.frames.to_string())),
        of(metrics.map(|m| format!("{:.1}", (1000.0 * m.coverage()).floor() / 10.0))),
        of(metrics.map(|m| m.lost_episodes.to_string())),
        of(metrics.map(|m| m.loop_closures.to_string())),
        of(metrics.and_then(|m| Some(format!("{:.4}", m.ate_rmse_m?)))),
        of(metrics.map(|m| format!("{:.1}", m.frames_per_second))),
        of(record.cpu_s.map(|seconds| format!("{seconds:.1}"))),
        of(bytes.map(|bytes| format!("{:.0}", bytes as f64 / 1e6))),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::metrics::Metrics;
    use super::*;

    fn record(name: &str, class: &str, tracked: u64, ate: Option<f64>) -> TaskRecord {
        let text = format!(
            r#"{{"format": 1, "name": "{name}", "source": "/d/{name}.mp4", "options": [],
            "class": "{class}", "reason": "cannot read /d/{name}.mp4 at byte 17",
            "exit_code": 0, "attempts": 1,
            "version": "0", "settings_sha256": "", "input": null, "result_sha256": null,
            "began_unix_s": 0, "wall_s": 1.0, "timeout_s": null, "cpu_s": 3.5,
            "peak_rss_bytes": 100000000, "metrics": null,
            "outputs": {{"report.html": {{"bytes": 1, "sha256": ""}}}}}}"#
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
