//! `monogrid view`: a map, a cloud or a run in the browser, as a page or as a picture.

use crate::commands::left_out;
use clap::Args;
use monogrid_app::args::WriteArgs;
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFile};
use monogrid_app::process::failure::{Classify, CommandResult, Failure, Outcome};
use monogrid_app::process::talk;
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::{Align, Up};
use monogrid_app::run::sessions::Source;
use monogrid_datasets::{encode_png_rgb, read_text};
use monogrid_mapping::MeshConfig;
use monogrid_occupancy::SurfaceMesh;
use monogrid_report::Page;
use monogrid_report::explorer::{
    Answer, Cells, Cloud, CloudPoint, POLICY, PageMesh, Scene, Server, section,
};
use monogrid_report::picture::colour::quantile;
use monogrid_report::picture::voxels::{
    Cube, View, dollhouse_cut, occupied_cubes, render, render_surface,
};
use monogrid_report::surface::{CellColours, ColouredMesh};
use monogrid_worlds::{MeshModel, TriangleMesh};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// `monogrid view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Map (.ot, .bt, .mgo), mesh (.glb, .ply, .obj, .stl), points (.ply, .pcd), recording (.mgk),
    /// submaps (submaps.json), or the folder of a run
    pub source: PathBuf,
    /// Port on this computer; 0 is any that is free
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub port: u16,
    /// Write the page into a file instead
    #[arg(long, value_name = "OUT.html")]
    pub html: Option<PathBuf>,
    /// Write a picture into a file instead
    #[arg(long, value_name = "OUT.png")]
    pub png: Option<PathBuf>,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// `view --json`.
#[derive(Debug, Serialize)]
struct ViewReport {
    /// Where the page is served.
    #[serde(skip_serializing_if = "Option::is_none")]
    url: Option<String>,
    cells: usize,
    points: usize,
    triangles: usize,
    keyframes: usize,
}

/// Set by Ctrl-C.
static STOP: AtomicBool = AtomicBool::new(false);

/// Shows it.
pub fn execute(args: &ViewArgs) -> CommandResult {
    let inputs = Inputs::of("what is shown", &args.source);
    let output = |path: &PathBuf| OutputFile::new(path, args.write.force, &inputs);
    let [html, png] = [&args.html, &args.png].map(|path| path.as_ref().map(output).transpose());
    let (html, png) = (html?, png?);
    let shown = Shown::read(&args.source)?;
    if let Some(file) = &png {
        file.write(&encode_png_rgb(&shown.picture()?))?;
    }
    let is_served = html.is_none() && png.is_none();
    let server = is_served.then(|| Server::listen(args.port)).transpose()?;
    tell(args, &shown, server.as_ref().map(Server::url))?;
    if html.is_none() && server.is_none() {
        return Ok(Outcome::Done);
    }
    let page = shown.page(&args.source)?;
    if let Some(file) = &html {
        file.write(page.as_bytes())?;
    }
    if let Some(server) = server {
        ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed)).map_err(Failure::running)?;
        // also where the page is one that somebody else wrote
        let page = Answer::page(page, POLICY);
        let _resting = talk::rest();
        let serving = server.start(move |path| (path == "/").then(|| page.clone()))?;
        while !STOP.load(Ordering::Relaxed) && !serving.is_dead() {
            std::thread::sleep(Duration::from_millis(20));
        }
        serving.end().map_err(Failure::running)?;
    }
    Ok(Outcome::Done)
}

fn tell(args: &ViewArgs, shown: &Shown, url: Option<String>) -> CommandResult {
    let scene = &shown.scene;
    let report = ViewReport {
        cells: scene.cells.as_ref().map_or(0, |cells| cells.count[0]),
        points: scene.cloud.as_ref().map_or(0, |cloud| cloud.count[1]),
        triangles: scene.mesh.as_ref().map_or(0, |mesh| mesh.count[1]),
        keyframes: scene.keyframes.len(),
        url,
    };
    args.write.json.print(&report, || {
        println!(
            "{}: {} occupied cells, {} points, {} triangles, {} keyframes",
            args.source.display(),
            report.cells,
            report.points,
            report.triangles,
            report.keyframes
        );
        if let Some(url) = &report.url {
            println!("{url} shows it in a browser of this computer; Ctrl-C ends");
        }
    })
}

/// What is shown.
struct Shown {
    scene: Scene,
    /// What a picture shows,
    cubes: Vec<Cube>,
    /// and instead of cells, where a mesh is shown.
    surface: Option<ColouredMesh>,
    /// The page that a run wrote.
    report: Option<String>,
}

impl Shown {
    fn read(source: &Path) -> Result<Self, Failure> {
        if source.is_dir() {
            return Self::of_run(source);
        }
        let extension = source.extension().unwrap_or_default().to_ascii_lowercase();
        let is_cloud = ["ply", "pcd", "glb", "obj", "stl"]
            .iter()
            .any(|known| extension == *known);
        let (scene, cubes) = if Source::is_at(source) {
            of_recording(source)?
        } else if is_cloud {
            return of_model(source);
        } else {
            of_map(source)?
        };
        Ok(Self {
            scene,
            cubes,
            surface: None,
            report: None,
        })
    }

    /// A run: the page that it wrote, else its map and its recording.
    fn of_run(folder: &Path) -> Result<Self, Failure> {
        let [map, report] = ["global.ot", "report.html"].map(|name| folder.join(name));
        let recording = Source::in_folder(folder);
        if !map.is_file() && recording.is_none() {
            return Err(Failure::input(format!(
                "{} holds neither global.ot nor recording.mgk nor submaps: it is not the folder of \
                 a run that came to a map",
                folder.display()
            )));
        }
        let (mut scene, mut cubes) = match &recording {
            Some(recording) => of_recording(&recording.file)?,
            None => of_map(&map)?,
        };
        if map.is_file() && recording.is_some() {
            let (mapped, cubes_of_map) = of_map(&map)?;
            (scene.cells, scene.mesh) = (mapped.cells, mapped.mesh);
            cubes = cubes_of_map;
        }
        let mut shown = Self {
            scene,
            cubes,
            surface: None,
            report: read_text(&report).ok(),
        };
        shown.scene.cut = dollhouse_cut(&shown.cubes, &shown.path());
        Ok(shown)
    }

    fn path(&self) -> Vec<[f64; 3]> {
        let path = self.scene.path.iter();
        path.map(|(_, x, y, z)| [*x, *y, *z].map(f64::from))
            .collect()
    }

    fn picture(&self) -> Result<monogrid_report::picture::Picture, Failure> {
        let Some(mesh) = &self.surface else {
            let view = View::default();
            return Ok(render(&self.cubes, &self.path(), self.scene.cut, &view));
        };
        render_surface(&mesh.surface, |t, shares| mesh.colour_at(t, shares), &[]).ok_or_else(|| {
            Failure::input(
                "no picture is drawn of triangles that lie in one another; expected a surface, as \
                 scans and models have it",
            )
        })
    }

    fn page(&self, source: &Path) -> Result<String, Failure> {
        if let Some(report) = &self.report {
            return Ok(report.clone());
        }
        let mut page = Page::default();
        page.html(&section(&self.scene)?);
        let name = source.file_name().unwrap_or(source.as_os_str());
        Ok(page.finish(
            &format!("monogrid: {}", name.display()),
            &source.display().to_string(),
        ))
    }
}

fn of_map(source: &Path) -> Result<(Scene, Vec<Cube>), Failure> {
    let (map, _) = mapfile::load(source)?;
    let cubes = occupied_cubes(&map).while_running("the map cannot be drawn")?;
    let cells = Cells::new(&map, None).while_running("the map cannot be drawn")?;
    let mesh = CellColours::unknown()
        .mesh(&map, &MeshConfig::default())
        .ok();
    let scene = Scene {
        cells: Some(cells),
        // one that is too large for the memory is left to `monogrid mesh`, which says so
        mesh: mesh.and_then(|mesh| PageMesh::new(&mesh, map.resolution())),
        ..Scene::default()
    };
    Ok((scene, cubes))
}

fn of_model(source: &Path) -> Result<Shown, Failure> {
    let model = MeshModel::read(source).bad_input()?;
    left_out(&model, source)
        .iter()
        .for_each(|said| eprintln!("warning: {said}"));
    let TriangleMesh {
        vertices,
        triangles,
        mut colours,
        ..
    } = model.mesh;
    // what has no colour is of a middle grey
    colours.resize(vertices.len(), [128; 3]);
    if !triangles.is_empty() {
        let surface = SurfaceMesh {
            vertices,
            triangles,
            ..SurfaceMesh::default()
        };
        let mesh = ColouredMesh {
            surface,
            colours,
            texture: None,
        };
        let scene = Scene {
            mesh: PageMesh::of_model(&mesh),
            ..Scene::default()
        };
        return Ok(Shown {
            scene,
            cubes: Vec::new(),
            surface: Some(mesh),
            report: None,
        });
    }
    let keep_every = Cloud::keep_every(vertices.len());
    let points = vertices.iter().zip(colours).step_by(keep_every);
    let points = points.map(|(point, colour)| CloudPoint {
        point: *point,
        colour,
        confidence: 1.0,
    });
    let shown: Vec<CloudPoint> = points.collect();
    let cubes = small_cubes(&shown);
    let (cloud, _) = Cloud::new(&[shown], vertices.len());
    let scene = Scene {
        cloud: Some(cloud),
        ..Scene::default()
    };
    Ok(Shown {
        scene,
        cubes,
        surface: None,
        report: None,
    })
}

/// The depth of the keyframes as it was recorded.
fn of_recording(source: &Path) -> Result<(Scene, Vec<Cube>), Failure> {
    let recorded = Recorded::read(source, &Align::Level(Up::Scene))?;
    let (scene, points) = recorded.scene();
    Ok((scene, small_cubes(&points)))
}

/// Points as cubes that can be seen in a picture.
fn small_cubes(points: &[CloudPoint]) -> Vec<Cube> {
    const PER_SIDE: f64 = 250.0;
    let ranges = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = points.iter().map(|p| f64::from(p.point[axis])).collect();
        quantile(&mut values, 0.98) - quantile(&mut values, 0.02)
    });
    let size = ranges.into_iter().fold(0.0, f64::max).max(1e-6) / PER_SIDE;
    let cube = |point: &CloudPoint| Cube {
        center: point.point.map(f64::from),
        size,
    };
    points.iter().map(cube).collect()
}
