//! Meshes (`.ply`, `.obj`, `.glb`, `.stl`): no more than their file holds, indices in range. Goes
//! through a file, since the format follows from the name.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_worlds::MeshModel;

fuzz_target!(|bytes: &[u8]| {
    for extension in ["ply", "obj", "glb", "stl"] {
        let name = format!("monogrid-fuzz-{}.{extension}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, bytes).expect("a writable temporary folder");
        if let Ok(model) = MeshModel::read(&path) {
            let mesh = model.mesh;
            let count = mesh.vertices.len();
            assert!(count <= bytes.len());
            assert!(
                mesh.triangles
                    .iter()
                    .flatten()
                    .all(|i| (*i as usize) < count)
            );
        }
    }
});
