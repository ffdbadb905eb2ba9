//! A run in the formats of other programs.

use crate::common::{assert_fails, code, json, monogrid, stderr};
use crate::runs::sessions::first_run;
use std::path::Path;

fn export(run: &Path, to: &str, out: &Path) -> std::process::Output {
    let (run, out) = (run.to_str().unwrap(), out.to_str().unwrap());
    monogrid(["export", run, "--to", to, "--out", out, "--json"])
}

#[test]
fn images_and_points_agree_to_a_pixel() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("colmap");
    let output = export(first_run(), "colmap", &out);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    let error = report["mean_reprojection_error_px"].as_f64().unwrap();
    assert!(error > 0.0 && error < 1.0, "{error}");
    let count = |name: &str| report[name].as_u64().unwrap() as usize;
    assert!(count("points") > 100 && count("observations") >= 2 * count("points"));
    let images = std::fs::read_dir(out.join("images")).unwrap().count();
    assert_eq!(images, count("images"));
    assert!(out.join("sparse/0/points3D.bin").is_file());

    let out = dir.path().join("nerf");
    let output = export(first_run(), "nerf", &out);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let text = std::fs::read_to_string(out.join("transforms.json")).unwrap();
    let transforms: serde_json::Value = serde_json::from_str(&text).unwrap();
    let frames = transforms["frames"].as_array().unwrap();
    assert_eq!(frames.len(), images);
    for frame in frames {
        assert!(out.join(frame["file_path"].as_str().unwrap()).is_file());
    }
    let points = transforms["ply_file_path"].as_str().unwrap();
    let [copy, cloud] = [out.join(points), first_run().join("cloud.ply")];
    assert_eq!(std::fs::read(copy).unwrap(), std::fs::read(cloud).unwrap());
}

/// The number behind a word of the header of a PLY file.
fn elements(ply: &Path, name: &str) -> usize {
    let bytes = std::fs::read(ply).unwrap();
    let header = String::from_utf8_lossy(&bytes[..bytes.len().min(600)]).into_owned();
    let line = header.lines().find_map(|line| line.strip_prefix(name));
    line.unwrap().trim().parse().unwrap()
}

#[test]
fn surface_and_cloud_become_files_of_others() {
    let dir = tempfile::tempdir().unwrap();
    let faces = elements(&first_run().join("mesh.ply"), "element face");
    for to in ["obj", "stl", "dxf", "usdz"] {
        let out = dir.path().join(format!("room.{to}"));
        let output = export(first_run(), to, &out);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        assert_eq!(json(&output)["triangles"], faces);
    }
    let obj = std::fs::read_to_string(dir.path().join("room.obj")).unwrap();
    assert_eq!(
        obj.lines().filter(|line| line.starts_with("f ")).count(),
        faces
    );
    let stl = std::fs::read(dir.path().join("room.stl")).unwrap();
    assert_eq!(stl.len(), 84 + 50 * faces);

    let dxf = std::fs::read_to_string(dir.path().join("room.dxf")).unwrap();
    assert_eq!(dxf.lines().filter(|line| *line == "3DFACE").count(), faces);
    let usdz = std::fs::read(dir.path().join("room.usdz")).unwrap();
    let has = |text: &[u8]| usdz.windows(text.len()).any(|w| w == text);
    assert!(usdz.starts_with(b"PK") && has(b"#usda 1.0") && has(b"int[] faceVertexIndices"));

    let out = dir.path().join("room.las");
    let output = export(first_run(), "las", &out);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let las = std::fs::read(&out).unwrap();
    let points = elements(&first_run().join("cloud.ply"), "element vertex");
    assert_eq!(
        (&las[..4], &las[24..26]),
        (b"LASF".as_slice(), [1, 2].as_slice())
    );
    // the legacy number of points (LAS 1.2, public header block)
    let stated = u32::from_le_bytes(las[107..111].try_into().unwrap());
    assert_eq!(stated as usize, points);
    // the same run gives the same bytes
    let again = dir.path().join("again.las");
    assert_eq!(code(&export(first_run(), "las", &again)), 0);
    assert_eq!(std::fs::read(&again).unwrap(), las);
}

#[test]
fn the_map_has_its_colours_where_the_source_has_any() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("room.ot");
    // built-in worlds are grey
    let output = export(first_run(), "ot", &out);
    assert_fails(
        &output,
        2,
        &["cells.ply", "the source is grey", "global.ot"],
    );
    // the same run with colours in its cells
    let run = dir.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::copy(first_run().join("global.ot"), run.join("global.ot")).unwrap();
    let grey = std::fs::read(first_run().join("cells.ply")).unwrap();
    let end = b"end_header\n";
    let at = grey.windows(end.len()).position(|w| w == end).unwrap();
    let header = String::from_utf8_lossy(&grey[..at]).into_owned();
    let mut cells = header.into_bytes();
    cells.extend(b"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n");
    for cell in grey[at + end.len()..].chunks(16) {
        cells.extend(cell.iter().chain(&[250, 120, 7]));
    }
    std::fs::write(run.join("cells.ply"), cells).unwrap();
    let output = export(&run, "ot", &out);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let count = elements(&run.join("cells.ply"), "element vertex");
    assert_eq!(json(&output)["cells in colour"], count);
    let tree = std::fs::read(&out).unwrap();
    let has = |bytes: &[u8]| tree.windows(bytes.len()).any(|w| w == bytes);
    assert!(has(b"id ColorOcTree") && has(&[250, 120, 7]));
    let [same, map] = [&out, &run.join("global.ot")].map(|path| {
        let output = monogrid(["info", path.to_str().unwrap(), "--json"]);
        json(&output)["cells_occupied"].clone()
    });
    assert_eq!(same, map);
}

#[test]
fn what_is_no_run_and_what_exists_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    for to in ["colmap", "obj", "las"] {
        let output = export(dir.path(), to, &dir.path().join("out"));
        assert_fails(&output, 2, &["expected the output folder of"]);
    }
    let taken = dir.path().join("room.stl");
    std::fs::write(&taken, "mine").unwrap();
    assert_fails(&export(first_run(), "stl", &taken), 2, &["room.stl"]);
    assert_eq!(std::fs::read(&taken).unwrap(), b"mine");
    // an output is never an input
    let run = first_run().to_str().unwrap();
    let output = monogrid(["export", run, "--to", "nerf", "--out", run, "--force"]);
    assert_eq!(code(&output), 2, "{}", stderr(&output));
}
