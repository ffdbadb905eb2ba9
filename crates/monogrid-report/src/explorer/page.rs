//! The explorer as a piece of HTML.

use super::Scene;
use crate::ReportError;
use crate::picture::base64;
use std::io::{self, Write};

/// How the explorer looks.
pub const STYLE: &str = include_str!("../../assets/explorer/style.css");

/// What a page with the explorer is allowed to load: nothing but itself.
pub const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src \
    'unsafe-inline'; img-src data:";

/// What the page of a run that goes on may load: answers of the server that it came from.
pub const LIVE_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src \
    'unsafe-inline'; img-src data:; connect-src 'self'";

/// A script of `assets/explorer` and the name under which others import it.
macro_rules! module {
    ($name:literal) => {
        (
            concat!("explorer/", $name),
            include_str!(concat!("../../assets/explorer/", $name, ".js")),
        )
    };
}

/// The scripts by the names under which they import each other.
const MODULES: [(&str, &str); 11] = [
    ("three", include_str!("../../assets/three/three.min.js")),
    module!("colours"),
    module!("data"),
    module!("keyframe"),
    module!("layers"),
    module!("live"),
    module!("main"),
    module!("model"),
    module!("plan"),
    module!("timeline"),
    module!("view"),
];

/// Licence of three.js, which must go where it goes.
const LICENCE: &str = include_str!("../../assets/three/LICENSE");

const MARKUP: &str = "<section id=\"explorer\" class=\"explorer\" hidden><div id=\"stage\" \
    class=\"stage\"><canvas id=\"view3d\" tabindex=\"0\" aria-label=\"map in three \
    dimensions\"></canvas><p id=\"picked\" class=\"picked\" hidden></p><div id=\"ruler\" \
    class=\"ruler\"><i></i><span></span></div></div><p id=\"colours\" class=\"legend\"></p><form \
    id=\"rescale\" hidden></form><form id=\"modes\"></form><p id=\"no-webgl\" class=\"warn\" \
    hidden>This browser shows no three-dimensional graphics (WebGL): the map is below, as a \
    picture.</p><form id=\"switches\"></form><form id=\"cuts\"></form><details><summary>Crop, \
    turn, hide, save</summary><form id=\"edit\"></form></details><p id=\"saved\" class=\"note\" \
    role=\"status\"></p><p class=\"note\">Drag to turn, right button or two fingers to move, wheel \
    or pinch to come nearer; click two places to measure. This page is one file without others: \
    send it to show the map.</p><div \
    id=\"timeline-part\"><h3>Over time</h3><canvas id=\"timeline\" class=\"timeline\" \
    tabindex=\"0\" aria-label=\"state of tracking over time\"></canvas><p id=\"legend\" \
    class=\"legend\"></p><p id=\"moment\" class=\"moment\"></p></div><div class=\"pair\"><div \
    id=\"plan-part\"><h3>From above</h3><form id=\"plan-controls\"></form><div><canvas \
    id=\"plan\"></canvas></div></div><div id=\"keyframe-part\"><h3>Keyframe</h3><form \
    id=\"keyframe-controls\"></form><canvas id=\"keyframe\"></canvas><p id=\"keyframe-caption\" \
    class=\"note\"></p></div></div></section>";

const LIVE_MARKUP: &str = "<section id=\"explorer\" class=\"explorer\"><p id=\"live-state\" \
    class=\"lead\"></p><div id=\"stage\" class=\"stage\"><canvas id=\"view3d\" tabindex=\"0\" \
    aria-label=\"map in three dimensions\"></canvas><div id=\"ruler\" \
    class=\"ruler\"><i></i><span></span></div></div><p id=\"no-webgl\" class=\"warn\" hidden>This \
    browser shows no three-dimensional graphics (WebGL).</p><form id=\"switches\"></form><div \
    class=\"pair\"><div><h3>Camera</h3><canvas id=\"live-image\"></canvas><p \
    class=\"note\">Green: points of the newest keyframe where the pose has \
    them.</p></div><div><h3>Keyframe</h3><canvas id=\"keyframe\"></canvas><p \
    id=\"keyframe-caption\" class=\"note\"></p></div></div></section>";

/// The explorer of a scene: markup, data and scripts. The data are not in memory a second time.
pub fn write_section(out: &mut dyn Write, scene: &Scene) -> io::Result<()> {
    out.write_all(MARKUP.as_bytes())?;
    out.write_all(b"<script type=\"application/json\" id=\"scene\">")?;
    serde_json::to_writer(WithoutTags(out), scene)?;
    out.write_all(b"</script>")?;
    out.write_all(scripts("explorer/main")?.as_bytes())?;
    Ok(())
}

/// The same as text.
pub fn section(scene: &Scene) -> Result<String, ReportError> {
    let mut html = Vec::new();
    write_section(&mut html, scene).map_err(ReportError::Page)?;
    String::from_utf8(html).map_err(|error| ReportError::Page(io::Error::other(error)))
}

/// Writes JSON in which nothing can end its block.
struct WithoutTags<'a>(&'a mut dyn Write);

impl Write for WithoutTags<'_> {
    fn write(&mut self, json: &[u8]) -> io::Result<usize> {
        let mut parts = json.split(|byte| *byte == b'<');
        self.0.write_all(parts.next().unwrap_or_default())?;
        for part in parts {
            self.0.write_all(b"\\u003c")?;
            self.0.write_all(part)?;
        }
        Ok(json.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// The explorer of a run that goes on: markup and scripts, which ask for the rest.
pub fn live_section() -> Result<String, ReportError> {
    let scripts = scripts("explorer/live").map_err(ReportError::Page)?;
    Ok(LIVE_MARKUP.to_owned() + &scripts)
}

/// All scripts with their licence; the one named is begun with.
fn scripts(main: &str) -> io::Result<String> {
    let module = |(name, text): &(&str, &str)| {
        let url = format!("data:text/javascript;base64,{}", base64(text.as_bytes()));
        ((*name).to_owned(), serde_json::Value::String(url))
    };
    let imports: serde_json::Map<_, _> = MODULES.iter().map(module).collect();
    let map = serde_json::to_string(&serde_json::json!({ "imports": imports }))?;
    Ok(format!(
        "<script type=\"text/plain\" id=\"licence-of-three\">{LICENCE}</script>\
         <script type=\"importmap\">{map}</script>\
         <script type=\"module\">import '{main}';</script>"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Names in `import ... from '...'`.
    fn imported(text: &str) -> BTreeSet<&str> {
        text.lines()
            .filter_map(|line| {
                let line = line.trim();
                let name = line.rsplit_once("from '").map(|(_, name)| name);
                name?.strip_suffix("';")
            })
            .collect()
    }

    #[test]
    fn every_module_that_is_imported_is_in_the_page_and_the_other_way_round() {
        let known: BTreeSet<&str> = MODULES.iter().map(|(name, _)| *name).collect();
        let wanted: BTreeSet<&str> = MODULES
            .iter()
            .flat_map(|(_, text)| imported(text))
            .collect();
        assert!(wanted.is_subset(&known), "{wanted:?}");
        let unused: Vec<_> = known.difference(&wanted).collect();
        assert_eq!(unused, [&"explorer/live", &"explorer/main"]);
    }

    #[test]
    fn scripts_look_up_only_elements_that_exist() {
        for (name, text) in MODULES.iter().filter(|(name, _)| *name != "three") {
            let markup = if *name == "explorer/live" {
                LIVE_MARKUP
            } else {
                MARKUP
            };
            for part in text.split("byId('").skip(1) {
                let id = part.split('\'').next().unwrap_or_default();
                let exists = markup.contains(&format!("id=\"{id}\"")) || id == "scene";
                assert!(exists, "{id}");
            }
        }
    }

    #[test]
    fn data_cannot_leave_its_block_and_nothing_is_loaded() {
        let scene = Scene {
            unit: "</script><img src=http://example.org>".into(),
            ..Scene::default()
        };
        let html = section(&scene).unwrap();
        assert_eq!(html.matches("</script>").count(), 4);
        assert!(!html.contains("<img"), "the data stay data");
        assert!(LICENCE.contains("MIT"));
    }
}
