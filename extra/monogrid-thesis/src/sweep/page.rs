//! What a sweep leaves for people: tables as CSV and Markdown, figures as SVG with their points as
//! CSV, and one page that holds everything.

use super::figures::{self, Figure};
use super::pictures::{AFTER_ONE, AFTER_SEVERAL, LIKELY, PictureOrders, VIEWED};
use super::plan::Model;
use super::record::{MapRecord, PictureKind};
use super::result::RecordingResult;
use super::tables::{self, Score, Table, mm};
use super::thesis::{ANDERT, THRUN};
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::Failure;
use monogrid_report::Page;

/// What the page says at its top.
#[derive(Debug)]
pub struct Lead {
    /// One sentence.
    pub text: String,
    /// Facts about the sweep.
    pub facts: Vec<(String, String)>,
    /// What the reader should not miss.
    pub warnings: Vec<String>,
}

/// Writes `*.csv`, `*.svg`, `tables.md` and `sweep.html` into `out`.
pub fn write(
    out: &OutputFolder,
    lead: &Lead,
    results: &[RecordingResult],
    orders: &PictureOrders,
) -> Result<(), Failure> {
    let mut writer = Writer {
        out,
        orders,
        page: Page::default(),
        markdown: String::new(),
    };
    for warning in &lead.warnings {
        writer.page.warning(warning);
    }
    writer.page.facts(&lead.facts);
    writer.page.heading("Data sets");
    writer.table("", &tables::data_sets(results))?;
    out.write("maps.csv", tables::all_maps_csv(results))?;
    for result in results {
        writer.recording(result)?;
    }
    out.write("tables.md", writer.markdown)?;
    let title = "Sweep over sensor models and resolutions";
    out.write("sweep.html", writer.page.finish(title, &lead.text))
}

struct Writer<'a> {
    out: &'a OutputFolder,
    orders: &'a PictureOrders,
    page: Page,
    /// All tables, for pages such as a project's documentation.
    markdown: String,
}

impl Writer<'_> {
    fn recording(&mut self, result: &RecordingResult) -> Result<(), Failure> {
        let folder = format!("{}/", result.name);
        self.page.heading(&format!(
            "{}: recorded with the profile {}",
            result.name, result.profile
        ));
        if !result.is_metric {
            self.page.warning(
                "The scale of this recording is arbitrary: lengths are map units, \
                and L and k mean something else than in the thesis.",
            );
        }
        self.table(&folder, &tables::memory(result))?;
        self.figure(&folder, &figures::growth(result))?;
        self.table(&folder, &tables::speed(result))?;
        let is_compared = result.records.iter().any(|r| r.scores().is_some());
        if is_compared {
            for score in [Score::AucKnown, Score::AucObserved, Score::MccObserved] {
                for family in [&THRUN, &ANDERT] {
                    self.table(&folder, &tables::over_parameter(result, family, score))?;
                }
            }
            self.table(&folder, &tables::best_of(result))?;
            for figure in figures::compared(result) {
                self.figure(&folder, &figure)?;
            }
        }
        self.slices(result);
        self.views(result);
        Ok(())
    }

    fn table(&mut self, folder: &str, table: &Table) -> Result<(), Failure> {
        let name = format!("{folder}{}.csv", table.file);
        self.out.write(&name, table.csv())?;
        self.markdown.push_str(&table.markdown());
        self.page.subheading(&table.title);
        self.page.number_table(&table.header, &table.rows);
        self.page.note(&table.note);
        Ok(())
    }

    fn figure(&mut self, folder: &str, figure: &Figure) -> Result<(), Failure> {
        for plot in &figure.plots {
            let is_kept = |c: &char| c.is_ascii_alphanumeric() || *c == '.';
            let panel: String = plot.title.chars().filter(is_kept).collect();
            let name = format!("{folder}{}-{panel}", figure.file);
            self.out.write(&format!("{name}.svg"), plot.file())?;
            self.out.write(&format!("{name}.csv"), plot.csv())?;
        }
        self.page.subheading(&figure.title);
        self.page.panels(&figure.plots);
        self.page.note(&figure.note);
        Ok(())
    }

    /// Figure 6.12: truth, ideal, Thrun, Andert and ours side by side.
    fn slices(&mut self, result: &RecordingResult) {
        self.page
            .subheading(&format!("Slices (Figure 6.12): {}", result.name));
        for &resolution in &result.resolutions {
            let models = [
                Some(Model::Ideal),
                result.best(&THRUN, resolution, Score::AucKnown),
                result.best(&ANDERT, resolution, Score::AucKnown),
                Some(Model::Automatic),
            ];
            for (index, height) in self.orders.heights.iter().enumerate() {
                let mut pictures = Vec::new();
                let truth = self.out.path().join(truth_slice_file(resolution, index));
                if let Ok(png) = std::fs::read(truth) {
                    pictures.push((png, format!("truth, {}, z = {height:.2}", mm(resolution))));
                }
                for model in models.into_iter().flatten() {
                    let record = result.record(model, resolution);
                    let wanted = PictureKind::Slice(*height);
                    if let Some(png) = record.and_then(|r| self.picture(result, r, wanted)) {
                        pictures.push((png, model.caption()));
                    }
                }
                if pictures.len() > 1 {
                    self.page.row(&pictures);
                }
            }
        }
        self.page.note(
            "Black occupied, white free, grey unknown. L and k: the best by AUC of known cells.",
        );
    }

    /// Figures 6.9 to 6.11: the unprocessed map, three values of L and of k.
    fn views(&mut self, result: &RecordingResult) {
        let resolution = self.orders.view_resolution;
        let picture = |model: Model| {
            let record = result.record(model, resolution)?;
            let png = self.picture(result, record, PictureKind::View)?;
            Some((png, model.caption()))
        };
        let all: Vec<(Vec<u8>, String)> = VIEWED.into_iter().filter_map(picture).collect();
        if all.is_empty() {
            return;
        }
        let page = &mut self.page;
        page.subheading(&format!(
            "Occupied cells at {} (Figures 6.9 to 6.11): {}",
            mm(resolution),
            result.name
        ));
        for row in all.chunks(4) {
            page.row(row);
        }
        page.colour_key(&[
            (AFTER_ONE, "at the upper limit after one measurement"),
            (AFTER_SEVERAL, "after several"),
            (LIKELY, "above 0.7"),
        ]);
        page.note("Cut above 80 % of the height. The thesis shows L = 0.05, 0.45 and 1.0.");
    }

    fn picture(
        &self,
        result: &RecordingResult,
        record: &MapRecord,
        kind: PictureKind,
    ) -> Option<Vec<u8>> {
        let file = record.built()?.pictures.iter().find(|p| p.kind == kind)?;
        std::fs::read(self.out.path().join(&result.name).join(&file.file)).ok()
    }
}

/// Where a slice of the truth is kept.
pub fn truth_slice_file(resolution: f64, index: usize) -> String {
    format!("truth/slice-{resolution}-{index}.png")
}
