//! `report.html`: one page without other files that shows how a run went.

use crate::explorer::{self, POLICY};
use crate::picture::data_url;
use crate::svg::{self, Plot, escape};
use std::fmt::Write;
use std::io;

/// A page under construction.
#[derive(Debug, Default)]
pub struct Page {
    body: String,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#222;--faint:#666;--ground:#fafaf8;--paper:#fff;\
--edge:#e0e0dc;--warn:#fff4d6;--best:#b3541e}\
@media(prefers-color-scheme:dark){:root{--ink:#e4e4e0;--faint:#a0a09a;--ground:#121416;\
--paper:#1d2024;--edge:#383b40;--warn:#3a3010;--best:#f0a070}\
svg .title,svg .label,svg .tick{fill:#c8c8c4}svg .grid{stroke:#34373b}}\
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--ground);\
max-width:1000px;margin:2em auto;padding:0 1em}
h1{font-size:1.7em;margin-bottom:.2em;overflow-wrap:anywhere}\
h2{font-size:1.25em;margin-top:2em;border-bottom:1px solid var(--edge)}
.lead{font-size:1.1em}.note{color:var(--faint)}\
.warn{background:var(--warn);border-left:4px solid #e0a800;padding:.4em .8em;margin:.4em 0}
table{border-collapse:collapse;margin:.6em 0}\
td,th{padding:.25em .9em .25em 0;text-align:left;vertical-align:top}td{overflow-wrap:anywhere}
th{font-weight:600;color:var(--faint)}td.n{text-align:right;font-variant-numeric:tabular-nums}
svg{width:100%;background:var(--paper);border:1px solid var(--edge);margin:.4em 0;\
box-sizing:border-box}
.grid2{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(380px,100%),1fr));gap:8px}\
.scroll{overflow-x:auto}
.row{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(280px,100%),1fr));gap:6px;\
margin:.5em 0}.row figcaption{font-size:12px;color:var(--faint)}
td b{color:var(--best)}h3{font-size:1.05em;margin-bottom:.2em}\
.dot{display:inline-block;width:.8em;height:.8em;margin:0 .3em 0 .8em}
img{max-width:100%;border:1px solid var(--edge);box-sizing:border-box}\
.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:6px;margin:.5em 0}
.triple figcaption,.ribbon{font-size:12px;color:var(--faint)}figure{margin:0;min-width:0}
@media(max-width:600px){svg .tick{font-size:20px}svg .label{font-size:20px}\
svg .title{font-size:24px}body{margin-top:1em}}
pre{background:var(--paper);border:1px solid var(--edge);padding:.8em;overflow:auto;\
font-size:12px}
";

impl Page {
    /// A second-level heading.
    pub fn heading(&mut self, text: &str) {
        self.html(&element("h2", text));
    }

    /// A third-level heading.
    pub fn subheading(&mut self, text: &str) {
        self.html(&element("h3", text));
    }

    /// A paragraph of explanation.
    pub fn note(&mut self, text: &str) {
        self.list("<p class=\"note\">", [escape(text)], "</p>");
    }

    /// Something the reader should not miss.
    pub fn warning(&mut self, text: &str) {
        self.list("<div class=\"warn\">", [escape(text)], "</div>");
    }

    /// A piece of HTML that was made elsewhere.
    pub fn html(&mut self, html: &str) {
        self.body.push_str(html);
    }

    fn list(&mut self, begin: &str, parts: impl IntoIterator<Item = String>, end: &str) {
        self.body.push_str(begin);
        self.body.extend(parts);
        self.body.push_str(end);
    }

    /// Names and values.
    pub fn facts(&mut self, rows: &[(String, String)]) {
        let row = |(name, value): &(String, String)| element("th", name) + &element("td", value);
        let rows = rows.iter().map(|cells| format!("<tr>{}</tr>", row(cells)));
        self.list("<table>", rows, "</table>");
    }

    /// A table with a header.
    pub fn table(&mut self, header: &[&str], rows: &[Vec<String>]) {
        let rows = rows.iter().map(|cells| row("td", cells));
        self.list(
            "<table>",
            [row("th", header)].into_iter().chain(rows),
            "</table>",
        );
    }

    /// A table of numbers; cells that start with `*` are emphasised.
    pub fn number_table(&mut self, header: &[String], rows: &[Vec<String>]) {
        self.html("<div class=\"scroll\"><table>");
        self.html(&row("th", header));
        for row in rows {
            let cells = row.iter().enumerate().map(|(column, cell)| {
                let class = if column == 0 { "" } else { " class=\"n\"" };
                match cell.strip_prefix('*') {
                    Some(best) => format!("<td{class}>{}</td>", element("b", best)),
                    None => format!("<td{class}>{}</td>", escape(cell)),
                }
            });
            self.list("<tr>", cells, "</tr>");
        }
        self.html("</table></div>");
    }

    /// A plot.
    pub fn plot(&mut self, plot: &Plot) {
        self.html(&plot.render());
    }

    /// Small plots side by side.
    pub fn panels(&mut self, plots: &[Plot]) {
        let plots = plots.iter().map(Plot::render);
        self.list("<div class=\"grid2\">", plots, "</div>");
    }

    /// An embedded picture.
    pub fn picture(&mut self, png: &[u8], description: &str) {
        self.html(&image(png, &escape(description)));
    }

    /// Embedded pictures side by side with their captions.
    pub fn row(&mut self, pictures: &[(Vec<u8>, String)]) {
        let figures = pictures.iter().map(|(png, caption)| figure(png, caption));
        self.list("<div class=\"row\">", figures, "</div>");
    }

    /// Three embedded pictures side by side with their captions.
    pub fn triple(&mut self, pictures: [(&[u8], &str); 3]) {
        let figures = pictures.map(|(png, caption)| figure(png, caption));
        self.list("<div class=\"triple\">", figures, "</div>");
    }

    /// What colours mean.
    pub fn colour_key(&mut self, entries: &[([u8; 3], &str)]) {
        let entries = entries.iter().map(|([r, g, b], meaning)| {
            let meaning = escape(meaning);
            format!("<span class=\"dot\" style=\"background:rgb({r},{g},{b})\"></span>{meaning}")
        });
        self.list("<p class=\"note\">", entries, "</p>");
    }

    /// Text as it is, shown when it is asked for.
    pub fn folded(&mut self, summary: &str, text: &str) {
        let parts = [element("summary", summary), element("pre", text)];
        self.list("<details>", parts, "</details>");
    }

    /// Coloured stretches over the frames: (share of the width, colour, description).
    pub fn ribbon(&mut self, stretches: &[(f64, &str, String)]) {
        self.html(
            "<svg viewBox=\"0 0 760 22\" role=\"img\" aria-label=\"state of tracking\" \
             preserveAspectRatio=\"none\" style=\"height:22px\">",
        );
        let mut x = 0.0;
        for (share, colour, description) in stretches {
            let (width, title) = (share * 760.0, element("title", description));
            let _ = write!(
                self.body,
                "<rect x=\"{x:.2}\" y=\"0\" width=\"{width:.2}\" height=\"22\" \
                 fill=\"{colour}\">{title}</rect>"
            );
            x += width;
        }
        self.html("</svg>");
    }

    /// The complete page, which loads nothing.
    pub fn finish(self, title: &str, lead: &str) -> String {
        self.finish_with(title, lead, POLICY)
    }

    /// The complete page; `policy` is its content security policy.
    pub fn finish_with(self, title: &str, lead: &str, policy: &str) -> String {
        beginning(title, lead, policy) + &self.body + END
    }

    /// Writes the complete page with something between its body and the rest of it.
    pub fn write_around(
        &self,
        out: &mut dyn io::Write,
        (title, lead): (&str, &str),
        between: impl FnOnce(&mut dyn io::Write) -> io::Result<()>,
        rest: &Self,
    ) -> io::Result<()> {
        out.write_all(beginning(title, lead, POLICY).as_bytes())?;
        out.write_all(self.body.as_bytes())?;
        between(out)?;
        out.write_all(rest.body.as_bytes())?;
        out.write_all(END.as_bytes())
    }
}

/// An element that holds text.
pub fn element(tag: &str, text: &str) -> String {
    format!("<{tag}>{}</{tag}>", escape(text))
}

/// A row of a table.
pub fn row(tag: &str, cells: &[impl AsRef<str>]) -> String {
    let cells: String = cells
        .iter()
        .map(|cell| element(tag, cell.as_ref()))
        .collect();
    format!("<tr>{cells}</tr>")
}

/// An embedded picture; the description is safe.
pub fn image(png: &[u8], description: &str) -> String {
    let url = data_url(png);
    format!("<img src=\"{url}\" alt=\"{description}\">")
}

fn figure(png: &[u8], caption: &str) -> String {
    let caption = escape(caption);
    let image = image(png, &caption);
    format!("<figure>{image}<figcaption>{caption}</figcaption></figure>")
}

/// What stands behind the body.
const END: &str = "</body></html>\n";

/// What stands before it.
fn beginning(title: &str, lead: &str, policy: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><meta \
         http-equiv=\"Content-Security-Policy\" content=\"{policy}\"><meta name=\"viewport\" \
         content=\"width=device-width,initial-scale=1\"><style>{2}{STYLE}{3}</style></head><body>\
         <h1>{0}</h1><p class=\"lead\">{1}</p>",
        escape(title),
        escape(lead),
        svg::STYLE,
        explorer::STYLE
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_needs_no_other_file_and_escapes_what_it_is_told() {
        let mut page = Page::default();
        page.heading("<script>");
        page.facts(&[("a&b".into(), "1 < 2".into())]);
        page.triple([(b"x", "one"), (b"y", "two"), (b"z", "three")]);
        page.ribbon(&[(1.0, "green", "good".into())]);
        let html = page.finish("title", "lead");
        assert!(!html.contains("<script>"));
        assert!(!html.contains("src=\"http") && !html.contains("href="));
        assert_eq!(html.matches("data:image/png;base64,").count(), 3);
    }
}
