//! `report.html`: one page without other files that shows how a run went.

pub mod svg;

use crate::explorer::{self, POLICY};
use crate::picture::data_url;
use std::fmt::Write;
use std::io;
use svg::{Plot, escape};

/// A page under construction.
#[derive(Debug, Default)]
pub struct Page {
    body: String,
}

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#222;--faint:#666;--ground:#fafaf8;--paper:#fff;--edge:#e0e0dc;--warn:#fff4d6;--best:#b3541e}\
@media(prefers-color-scheme:dark){:root{--ink:#e4e4e0;--faint:#a0a09a;--ground:#121416;--paper:#1d2024;--edge:#383b40;--warn:#3a3010;--best:#f0a070}\
svg .title,svg .label,svg .tick{fill:#c8c8c4}svg .grid{stroke:#34373b}}\
body{font:15px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--ground);max-width:1000px;margin:2em auto;padding:0 1em}
h1{font-size:1.7em;margin-bottom:.2em;overflow-wrap:anywhere}h2{font-size:1.25em;margin-top:2em;border-bottom:1px solid var(--edge)}
.lead{font-size:1.1em}.note{color:var(--faint)}.warn{background:var(--warn);border-left:4px solid #e0a800;padding:.4em .8em;margin:.4em 0}
table{border-collapse:collapse;margin:.6em 0}td,th{padding:.25em .9em .25em 0;text-align:left;vertical-align:top}td{overflow-wrap:anywhere}
th{font-weight:600;color:var(--faint)}td.n{text-align:right;font-variant-numeric:tabular-nums}
svg{width:100%;background:var(--paper);border:1px solid var(--edge);margin:.4em 0;box-sizing:border-box}
.grid2{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(380px,100%),1fr));gap:8px}.scroll{overflow-x:auto}
.row{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(280px,100%),1fr));gap:6px;margin:.5em 0}.row figcaption{font-size:12px;color:var(--faint)}
td b{color:var(--best)}h3{font-size:1.05em;margin-bottom:.2em}.dot{display:inline-block;width:.8em;height:.8em;margin:0 .3em 0 .8em}
img{max-width:100%;border:1px solid var(--edge);box-sizing:border-box}.triple{display:grid;grid-template-columns:repeat(3,1fr);gap:6px;margin:.5em 0}
.triple figcaption,.ribbon{font-size:12px;color:var(--faint)}figure{margin:0;min-width:0}
@media(max-width:600px){svg .tick{font-size:20px}svg .label{font-size:20px}svg .title{font-size:24px}body{margin-top:1em}}
pre{background:var(--paper);border:1px solid var(--edge);padding:.8em;overflow:auto;font-size:12px}
";

impl Page {
    /// A second-level heading.
    pub fn heading(&mut self, text: &str) {
        let _ = write!(self.body, "<h2>{}</h2>", escape(text));
    }

    /// A piece of HTML that was made elsewhere.
    pub fn html(&mut self, html: &str) {
        self.body.push_str(html);
    }

    /// A paragraph of explanation.
    pub fn note(&mut self, text: &str) {
        let _ = write!(self.body, "<p class=\"note\">{}</p>", escape(text));
    }

    /// Something the reader should not miss.
    pub fn warning(&mut self, text: &str) {
        let _ = write!(self.body, "<div class=\"warn\">{}</div>", escape(text));
    }

    /// Names and values.
    pub fn facts(&mut self, rows: &[(String, String)]) {
        self.body.push_str("<table>");
        for (name, value) in rows {
            let _ = write!(
                self.body,
                "<tr><th>{}</th><td>{}</td></tr>",
                escape(name),
                escape(value)
            );
        }
        self.body.push_str("</table>");
    }

    /// A table with a header.
    pub fn table(&mut self, header: &[&str], rows: &[Vec<String>]) {
        self.body.push_str("<table><tr>");
        for cell in header {
            let _ = write!(self.body, "<th>{}</th>", escape(cell));
        }
        self.body.push_str("</tr>");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let _ = write!(self.body, "<td>{}</td>", escape(cell));
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</table>");
    }

    /// A third-level heading.
    pub fn subheading(&mut self, text: &str) {
        let _ = write!(self.body, "<h3>{}</h3>", escape(text));
    }

    /// A table of numbers; cells that start with `*` are emphasised.
    pub fn number_table(&mut self, header: &[String], rows: &[Vec<String>]) {
        self.body.push_str("<div class=\"scroll\"><table><tr>");
        for cell in header {
            let _ = write!(self.body, "<th>{}</th>", escape(cell));
        }
        self.body.push_str("</tr>");
        for row in rows {
            self.body.push_str("<tr>");
            for (column, cell) in row.iter().enumerate() {
                let class = if column == 0 { "" } else { " class=\"n\"" };
                let _ = match cell.strip_prefix('*') {
                    Some(best) => write!(self.body, "<td{class}><b>{}</b></td>", escape(best)),
                    None => write!(self.body, "<td{class}>{}</td>", escape(cell)),
                };
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</table></div>");
    }

    /// Small plots side by side.
    pub fn panels(&mut self, plots: &[Plot]) {
        self.body.push_str("<div class=\"grid2\">");
        for plot in plots {
            self.body.push_str(&plot.render());
        }
        self.body.push_str("</div>");
    }

    /// Embedded pictures side by side with their captions.
    pub fn row(&mut self, pictures: &[(Vec<u8>, String)]) {
        self.body.push_str("<div class=\"row\">");
        for (png, caption) in pictures {
            let _ = write!(
                self.body,
                "<figure><img src=\"{}\" alt=\"{1}\"><figcaption>{1}</figcaption></figure>",
                data_url(png),
                escape(caption)
            );
        }
        self.body.push_str("</div>");
    }

    /// What colours mean.
    pub fn colour_key(&mut self, entries: &[([u8; 3], &str)]) {
        self.body.push_str("<p class=\"note\">");
        for ([r, g, b], meaning) in entries {
            let _ = write!(
                self.body,
                "<span class=\"dot\" style=\"background:rgb({r},{g},{b})\"></span>{}",
                escape(meaning)
            );
        }
        self.body.push_str("</p>");
    }

    /// A plot.
    pub fn plot(&mut self, plot: &Plot) {
        self.body.push_str(&plot.render());
    }

    /// An embedded picture.
    pub fn picture(&mut self, png: &[u8], description: &str) {
        let _ = write!(
            self.body,
            "<img src=\"{}\" alt=\"{}\">",
            data_url(png),
            escape(description)
        );
    }

    /// Three embedded pictures side by side with their captions.
    pub fn triple(&mut self, pictures: [(&[u8], &str); 3]) {
        self.body.push_str("<div class=\"triple\">");
        for (png, caption) in pictures {
            let _ = write!(
                self.body,
                "<figure><img src=\"{}\" alt=\"{1}\"><figcaption>{1}</figcaption></figure>",
                data_url(png),
                escape(caption)
            );
        }
        self.body.push_str("</div>");
    }

    /// Text as it is, shown when it is asked for.
    pub fn folded(&mut self, summary: &str, text: &str) {
        let _ = write!(
            self.body,
            "<details><summary>{}</summary><pre>{}</pre></details>",
            escape(summary),
            escape(text)
        );
    }

    /// Coloured stretches over the frames: (share of the width, colour, description).
    pub fn ribbon(&mut self, stretches: &[(f64, &str, String)]) {
        self.body.push_str(
            "<svg viewBox=\"0 0 760 22\" role=\"img\" aria-label=\"state of tracking\" preserveAspectRatio=\"none\" style=\"height:22px\">",
        );
        let mut x = 0.0;
        for (share, colour, description) in stretches {
            let width = share * 760.0;
            let _ = write!(
                self.body,
                "<rect x=\"{x:.2}\" y=\"0\" width=\"{width:.2}\" height=\"22\" fill=\"{colour}\"><title>{}</title></rect>",
                escape(description)
            );
            x += width;
        }
        self.body.push_str("</svg>");
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
        between: impl FnOnce(&mut dyn io::Write) -> anyhow::Result<()>,
        rest: &Self,
    ) -> anyhow::Result<()> {
        out.write_all(beginning(title, lead, POLICY).as_bytes())?;
        out.write_all(self.body.as_bytes())?;
        between(out)?;
        out.write_all(rest.body.as_bytes())?;
        Ok(out.write_all(END.as_bytes())?)
    }
}

/// What stands behind the body.
const END: &str = "</body></html>\n";

/// What stands before it.
fn beginning(title: &str, lead: &str, policy: &str) -> String {
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title>\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{policy}\">\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"><style>{2}{STYLE}{3}</style></head>\
             <body><h1>{0}</h1><p class=\"lead\">{1}</p>",
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
