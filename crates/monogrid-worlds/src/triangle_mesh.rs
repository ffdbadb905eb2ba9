//! Triangles without what they look like.

/// Triangles of a world or mesh, with the grey reflectance of each vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertices in the world, m.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Reflectance in [0, 1] per vertex; empty when unknown.
    pub albedo: Vec<f32>,
    /// Red, green and blue per vertex, as displayed; empty when unknown.
    pub colours: Vec<[u8; 3]>,
}
