//! Damaged meshes: an error, or no more than the file has bytes, never a panic.

use monogrid_worlds::{MeshLighting, MeshModel, World};
use proptest::prelude::*;

const OBJ: &[u8] = b"v 0 0 0\nv 1 0 0\nv 0 1 0.5\nv 1 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nf 1 2 3\n\
    f 2/1/1 3/2/1 4/1/1\nusemtl a\nf -1 -2 -3 1\n";
const PLY: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
    property float z\nproperty uchar red\nelement face 2\nproperty list uchar int vertex_indices\n\
    element other 1\nproperty int a\nend_header\n\
    0 0 0 9\n1 0 0 9\n0 1 0 9\n1 1 0 9\n3 0 1 2\n3 1 2 3\n7\n";

fn binary_ply() -> Vec<u8> {
    let mut binary = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n\
        property float y\nproperty float z\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n"
        .to_vec();
    for value in [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0_f32] {
        binary.extend(value.to_le_bytes());
    }
    binary.push(3);
    binary.extend((0..3_i32).flat_map(i32::to_le_bytes));
    binary
}

/// Something that replaces a stretch of a file.
fn piece() -> impl Strategy<Value = Vec<u8>> {
    let words: Vec<&[u8]> = vec![
        b"nan",
        b"1e999",
        b"-1",
        b"4294967295",
        b"99999999999999999999",
        b"\n",
        b" ",
        b"/",
        b"\xff",
    ];
    prop_oneof![
        prop::sample::select(words).prop_map(<[u8]>::to_vec),
        prop::collection::vec(any::<u8>(), 0..3),
    ]
}

/// Arithmetic with such indices overflows.
#[test]
fn indices_that_lead_nowhere_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.obj");
    for face in [
        "f 1 2 -11",
        "f 1/1/-9 2/1/1 3/1/1",
        "f 1/-9/1 2/1/1 3/1/1",
        "f 0 1 2",
        "f /1 2 3",
        "f 1 2 6148914691236517206",
        "f 1/1/6148914691236517206 2/1/1 3/1/1",
        "f -9223372036854775808 1 2",
        "l 1 -11",
    ] {
        let text = format!("{}{face}\n", String::from_utf8_lossy(OBJ));
        std::fs::write(&path, text).unwrap();
        let error = MeshModel::read(&path).expect_err(face).to_string();
        assert!(
            error.contains("an index that leads nowhere, in line 12"),
            "{face}: {error}"
        );
    }
    std::fs::write(&path, OBJ).unwrap();
    assert_eq!(MeshModel::read(&path).unwrap().mesh.triangles.len(), 4);
}

#[test]
fn a_mesh_without_its_materials_is_grey() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.obj");
    let text = "mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nusemtl wall\nf 1/1 \
        2/1 3/1 4/1\n";
    std::fs::write(&path, text).unwrap();
    let model = MeshModel::read(&path).unwrap();
    assert_eq!(model.mesh.triangles.len(), 2);
    assert!(model.materials.is_empty());
    World::from_file(&path, MeshLighting::Shaded).unwrap();
    // one that is there and no library is not passed over
    std::fs::write(folder.path().join("gone.mtl"), "newmtl wall\nKd a b c\n").unwrap();
    let error = MeshModel::read(&path).unwrap_err().to_string();
    assert!(error.contains("library of materials"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 1500,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn damaged_meshes_hold_no_more_than_their_files(
        kind in 0..3_usize,
        damages in prop::collection::vec(
            (any::<prop::sample::Index>(), 0..12_usize, piece()),
            1..4,
        ),
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
    ) {
        let (name, mut bytes) = match kind {
            0 => ("m.obj", OBJ.to_vec()),
            1 => ("m.ply", PLY.to_vec()),
            _ => ("m.ply", binary_ply()),
        };
        for (at, length, piece) in damages {
            let at = at.index(bytes.len());
            let end = (at + length).min(bytes.len());
            bytes.splice(at..end, piece);
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len().max(1)));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(MeshModel { mesh, .. }) = MeshModel::read(&path) {
            let count = mesh.vertices.len();
            prop_assert!(count <= bytes.len() && mesh.triangles.len() <= bytes.len());
            prop_assert!(mesh.triangles.iter().flatten().all(|i| (*i as usize) < count));
        }
    }
}
