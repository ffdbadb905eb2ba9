//! `monogrid export`: a run as files of other programs.
//!
//! Images with poses and points for photogrammetry and radiance fields ([`colmap`], [`nerf`]), the
//! surface for modelling programs and printers, and the cloud for programs that survey
//! ([`files`]). All lengths and axes are those of the maps of the run.

mod colmap;
mod files;
mod images;
mod nerf;
mod reconstruction;
#[cfg(test)]
mod tests;

use crate::commands::runs::CLOUD;
use crate::commands::runs::rescale::SUMMARY;
use clap::{Args, ValueEnum};
use monogrid_app::args::WriteArgs;
use monogrid_app::output::{Inputs, MAP, OutputFile, OutputFolder};
use monogrid_app::process::failure::{CommandResult, Failure};
use monogrid_app::run::sessions::{MAP_FROM_WORLD, Source, files_of};
use monogrid_report::surface::MeshFormat;
use reconstruction::Reconstruction;
use serde_json::json;
use std::path::{Path, PathBuf};

/// `monogrid export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Folder of a run
    pub run: PathBuf,
    /// What it becomes
    #[arg(long, value_enum, value_name = "FORMAT")]
    pub to: Target,
    /// Folder (colmap, nerf) or file (all others) to write
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// Formats that a run is exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Target {
    /// Folder: images, and sparse/0 as COLMAP's model, binary and text
    Colmap,
    /// Folder: images, transforms.json and points for nerfstudio, instant-ngp and Gaussian splats
    Nerf,
    /// File: the surface with colours, or with its material (.mtl) and picture (.jpg) beside it
    Obj,
    /// File: the surface as bare triangles
    Stl,
    /// File: the surface as faces, for programs that draw plans
    Dxf,
    /// File: the surface with its picture, for telephones and programs of animation
    Usdz,
    /// File: the semi-dense cloud with colours, for programs that survey
    Las,
    /// File: the map with colours (OctoMap's ColorOcTree)
    Ot,
}

/// Writes a run in another format.
pub fn execute(args: &ExportArgs) -> CommandResult {
    let beside = |path: &Path| OutputFile::new(path, args.write.force, &inputs_of(&args.run));
    let mesh =
        |format| move |run: &Path, out: &OutputFile| files::write_mesh(run, out, (format, beside));
    match args.to {
        Target::Colmap => export_images(args, |folder, scene, _| colmap::write(folder, scene)),
        Target::Nerf => export_images(args, nerf::write),
        Target::Obj => export_file(args, "triangles", mesh(MeshFormat::Obj)),
        Target::Stl => export_file(args, "triangles", mesh(MeshFormat::Stl)),
        Target::Dxf => export_file(args, "triangles", mesh(MeshFormat::Dxf)),
        Target::Usdz => export_file(args, "triangles", mesh(MeshFormat::Usdz)),
        Target::Ot => export_file(args, "cells in colour", files::write_ot),
        Target::Las => export_file(args, "points", files::write_las),
    }
}

fn inputs_of(run: &Path) -> Inputs {
    let own = [
        files::MESH,
        files::MODEL,
        CLOUD,
        files::CELLS,
        MAP,
        MAP_FROM_WORLD,
        SUMMARY,
    ];
    let own = own.map(|name| run.join(name));
    Inputs::of("the run", run)
        .and_all("the run", own)
        .and_all("the run", files_of(run))
}

/// Images with poses, and the points that they see: `write` is given the folder, these and the
/// folder of the run.
fn export_images(
    args: &ExportArgs,
    write: impl Fn(&OutputFolder, &Reconstruction, &Path) -> Result<(), Failure>,
) -> CommandResult {
    let source = Source::find(&args.run)?;
    let recording = source.read()?;
    let scene = Reconstruction::new(&recording, &source.file)?;
    let folder = OutputFolder::replace(&args.out, args.write.force, &inputs_of(&args.run))?;
    images::write(&folder, &recording, &scene)?;
    write(&folder, &scene, &source.folder_of_run())?;
    let report = json!({
        "images": scene.views.len(),
        "cameras": scene.cameras.len(),
        "points": scene.points.len(),
        "observations": scene.num_observations(),
        "mean_reprojection_error_px": scene.mean_error(),
        "left_out": scene.left_out,
        "limit_px": scene.limit,
    });
    args.write.json.print(&report, || {
        let (out, images) = (args.out.display(), scene.views.len());
        match scene.mean_error() {
            Some(error) => println!(
                "{out}: {images} images, {} points seen {} times, mean reprojection error \
                 {error:.2} px ({} times something else was seen, more than {:.1} px away)",
                scene.points.len(),
                scene.num_observations(),
                scene.left_out,
                scene.limit
            ),
            None => println!(
                "{out}: {images} images; the recording holds no points that several of them see"
            ),
        }
    })
}

/// One file made of one file of the run: `write` says how many of `what` it holds.
fn export_file(
    args: &ExportArgs,
    what: &str,
    write: impl Fn(&Path, &OutputFile) -> Result<usize, Failure>,
) -> CommandResult {
    let output = OutputFile::new(&args.out, args.write.force, &inputs_of(&args.run))?;
    let count = write(&args.run, &output)?;
    let report = json!({ what: count });
    args.write.json.print(&report, || {
        println!("{}: {count} {what}", args.out.display());
    })
}
