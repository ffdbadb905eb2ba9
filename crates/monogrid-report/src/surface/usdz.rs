//! USDZ: a scene of Universal Scene Description in an archive that is not compressed.
//!
//! <https://openusd.org/release/spec_usdz.html>: a zip whose files are stored as they are and begin
//! at multiples of 64 bytes. The scene is text (`.usda`), first, with the picture behind it.

use super::files::{FACE, extent, linear};
use super::{ColouredMesh, Texture};
use std::fmt::Write as _;
use std::io::{self, Write};

const NAME: &str = "surface.usda";
const PICTURE: &str = "surface.jpg";
/// What the bytes of a file in the archive begin at a multiple of.
const ALIGNMENT: usize = 64;

/// Writes the surface, turned from z up to y up.
pub(super) fn write(mesh: &ColouredMesh, unit: &str, out: &mut dyn Write) -> io::Result<()> {
    let mut files = vec![(NAME, scene(mesh, unit).into_bytes())];
    files.extend(mesh.texture.iter().map(|texture| (PICTURE, texture.jpeg())));
    out.write_all(&archive(&files)?)
}

/// Values between brackets.
fn list(values: impl Iterator<Item = String>) -> String {
    format!("[{}]", values.collect::<Vec<String>>().join(", "))
}

fn triples<T: ToString>(values: impl Iterator<Item = [T; 3]>) -> String {
    list(values.map(|three| {
        let [x, y, z] = three.map(|value| value.to_string());
        format!("({x}, {y}, {z})")
    }))
}

fn scene(mesh: &ColouredMesh, unit: &str) -> String {
    let surface = &mesh.surface;
    let schema = match mesh.texture {
        Some(_) => " (prepend apiSchemas = [\"MaterialBindingAPI\"])",
        None => "",
    };
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"map\"\n    doc = \"monogrid, lengths in {unit}\"\n    \
         metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"map\"\n{{\n    \
         float xformOp:rotateX = -90\n    uniform token[] xformOpOrder = \
         [\"xformOp:rotateX\"]\n\n    \
         def Mesh \"surface\"{schema}\n    {{\n        uniform bool doubleSided = 1\n        \
         uniform token subdivisionScheme = \"none\"\n"
    );
    let colours = mesh.colours.iter();
    let colours = colours.map(|colour| colour.map(|value| format!("{:.4}", linear(value))));
    let lines = [
        (
            "float3[] extent",
            triples(extent(&surface.vertices).into_iter()),
            "",
        ),
        (
            "int[] faceVertexCounts",
            list(surface.triangles.iter().map(|_| "3".to_owned())),
            "",
        ),
        (
            "int[] faceVertexIndices",
            list(surface.triangles.iter().flatten().map(u32::to_string)),
            "",
        ),
        (
            "point3f[] points",
            triples(surface.vertices.iter().copied()),
            "",
        ),
        (
            "normal3f[] normals",
            triples(surface.normals.iter().copied()),
            " (interpolation = \"vertex\")",
        ),
        (
            "color3f[] primvars:displayColor",
            triples(colours),
            " (interpolation = \"vertex\")",
        ),
    ];
    // a surface without triangles has no extent
    let skipped = usize::from(surface.vertices.is_empty());
    for (name, values, metadata) in &lines[skipped..] {
        _ = writeln!(text, "        {name} = {values}{metadata}");
    }
    text += &mesh.texture.as_ref().map_or_else(String::new, |texture| {
        places_on(texture, surface.triangles.len())
    });
    text += "    }\n";
    if mesh.texture.is_some() {
        text += LOOK;
    }
    text + "}\n"
}

/// Where the corners of so many triangles are on the picture, from below.
fn places_on(texture: &Texture, triangles: usize) -> String {
    let places = (0..triangles).flat_map(|k| {
        let corners = texture.corners(k / 2);
        FACE[k % 2].map(|corner| corners[corner])
    });
    let places = list(places.map(|[u, v]| format!("({u:.6}, {:.6})", 1.0 - v)));
    format!(
        "        texCoord2f[] primvars:st = {places} (interpolation = \"faceVarying\")\n        \
         rel material:binding = </map/look>\n"
    )
}

/// The material that shows the picture.
const LOOK: &str = r#"
    def Material "look"
    {
        token outputs:surface.connect = </map/look/shown.outputs:surface>

        def Shader "shown"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </map/look/picture.outputs:rgb>
            float inputs:roughness = 1
            token outputs:surface
        }

        def Shader "picture"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @surface.jpg@
            token inputs:sourceColorSpace = "sRGB"
            float2 inputs:st.connect = </map/look/place.outputs:result>
            float3 outputs:rgb
        }

        def Shader "place"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
    }
"#;

/// Little-endian fields of two and four bytes, one after the other (PKWARE's APPNOTE.TXT, 4.3).
#[derive(Default)]
struct Fields(Vec<u8>);

impl Fields {
    fn two(mut self, values: &[u16]) -> Self {
        self.0
            .extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self
    }

    fn four(mut self, values: &[u32]) -> Self {
        self.0
            .extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self
    }

    fn bytes(mut self, values: &[u8]) -> Self {
        self.0.extend(values);
        self
    }
}

/// A zip of these files. Their date is always the first that there is, 1 January 1980.
fn archive(files: &[(&str, Vec<u8>)]) -> io::Result<Vec<u8>> {
    const LOCAL: u32 = 0x0403_4b50;
    const CENTRAL: u32 = 0x0201_4b50;
    const END: u32 = 0x0605_4b50;
    const LOCAL_BYTES: usize = 30;
    // version of the format, flags, method (stored), time, date
    const COMMON: [u16; 5] = [20, 0, 0, 0, 0x21];
    // of the field that fills up to the alignment: its number, which nobody else has, and its size
    const FILLER: u16 = 0x1986;
    const FILLER_HEAD: usize = 4;
    let number = |length: usize| u32::try_from(length).map_err(io::Error::other);
    let (mut local, mut directory) = (Fields::default(), Fields::default());
    for (name, content) in files {
        let size = number(content.len())?;
        let sizes = [crc32fast::hash(content), size, size];
        let at = number(local.0.len())?;
        let before = local.0.len() + LOCAL_BYTES + name.len() + FILLER_HEAD;
        let filled = before.next_multiple_of(ALIGNMENT) - before;
        let name_bytes = name.len() as u16;
        local = local
            .four(&[LOCAL])
            .two(&COMMON)
            .four(&sizes)
            .two(&[name_bytes, (FILLER_HEAD + filled) as u16])
            .bytes(name.as_bytes())
            .two(&[FILLER, filled as u16])
            .bytes(&vec![0; filled])
            .bytes(content);
        directory = directory
            .four(&[CENTRAL])
            .two(&COMMON[..1])
            .two(&COMMON)
            .four(&sizes)
            // no extra field, comment, other disk, attributes
            .two(&[name_bytes, 0, 0, 0, 0])
            .four(&[0, at])
            .bytes(name.as_bytes());
    }
    let (at, bytes) = (number(local.0.len())?, number(directory.0.len())?);
    let count = files.len() as u16;
    let end = Fields::default()
        .four(&[END])
        .two(&[0, 0, count, count])
        .four(&[bytes, at])
        .two(&[0]);
    Ok([local.0, directory.0, end.0].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_occupancy::{SurfaceMesh, VoxelKey};
    use std::io::Read;

    fn triangle() -> ColouredMesh {
        ColouredMesh {
            texture: None,
            surface: SurfaceMesh {
                vertices: vec![[0.0, 0.0, 1.0], [2.5, 0.0, 1.0], [0.0, -3.0, 1.0]],
                normals: vec![[0.0, 0.0, 1.0]; 3],
                cubes: vec![VoxelKey::new(0, 0, 0); 3],
                triangles: vec![[0, 1, 2]],
            },
            colours: vec![[255, 0, 188], [9, 9, 9], [1, 2, 3]],
        }
    }

    #[test]
    fn the_archive_is_one_that_others_read_and_its_file_is_aligned() {
        let mut bytes = Vec::new();
        write(&triangle(), "m", &mut bytes).unwrap();
        let mut zip = zip::ZipArchive::new(io::Cursor::new(&bytes)).unwrap();
        assert_eq!(zip.len(), 1);
        let files = [("a", vec![1; 70]), ("b", vec![2; 3])];
        let two = archive(&files).unwrap();
        let mut two = zip::ZipArchive::new(io::Cursor::new(&two)).unwrap();
        let at = |k| two.by_index(k).unwrap().data_start().unwrap() % ALIGNMENT as u64;
        assert_eq!([0, 1].map(at), [0, 0]);
        let mut file = zip.by_index(0).unwrap();
        assert_eq!(file.name().unwrap(), NAME);
        assert_eq!(file.compression(), zip::CompressionMethod::Stored);
        assert_eq!(file.data_start().unwrap() % ALIGNMENT as u64, 0);
        let mut text = String::new();
        file.read_to_string(&mut text).unwrap();
        assert!(text.starts_with("#usda 1.0\n"));
        for line in [
            "float3[] extent = [(0, -3, 1), (2.5, 0, 1)]",
            "int[] faceVertexCounts = [3]",
            "int[] faceVertexIndices = [0, 1, 2]",
            "point3f[] points = [(0, 0, 1), (2.5, 0, 1), (0, -3, 1)]",
        ] {
            assert!(text.contains(line), "{text}");
        }
        // 188 of sRGB is half of the light
        assert!(
            text.contains("displayColor = [(1.0000, 0.0000, 0.5029), "),
            "{text}"
        );
    }
}
