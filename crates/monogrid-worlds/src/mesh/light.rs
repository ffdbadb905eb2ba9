//! Light on meshes of others, per vertex: an even sky dimmed by what is near.

use super::super::bvh::{Bvh, P3};
use super::super::lighting::across;
use super::super::triangle_mesh::TriangleMesh;
use super::MeshLighting;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Directions per side of a vertex.
const RAYS: usize = 8;
/// Share of the diagonal beyond which nothing dims.
const REACH: f32 = 0.05;

/// Light at every vertex, about 1 where nothing is near.
pub(crate) fn vertex_light(mesh: &TriangleMesh, bvh: &Bvh, lighting: MeshLighting) -> Vec<f32> {
    if lighting == MeshLighting::AsColoured {
        return vec![1.0; mesh.vertices.len()];
    }
    let normals = vertex_normals(mesh);
    let size = bvh.bounds().size();
    let reach_m = REACH * size.iter().map(|s| s * s).sum::<f32>().sqrt();
    mesh.vertices
        .par_iter()
        .zip(&normals)
        .map(|(vertex, normal)| {
            let point = P3::from(*vertex);
            // nobody says which side is the outside: the more open one is
            let front = openness(bvh, &point, normal, reach_m);
            let back = openness(bvh, &point, &-normal, reach_m);
            let (open, outward) = if front >= back {
                (front, *normal)
            } else {
                (back, -normal)
            };
            // a sky that is brighter above and to one side
            let slope = 0.80 + 0.13 * outward.z + 0.07 * outward.x;
            slope * (0.35 + 0.65 * open)
        })
        .collect()
}

/// Share of the cosine-weighted hemisphere in which nothing is within reach, softened by distance.
fn openness(bvh: &Bvh, point: &P3, normal: &P3, reach_m: f32) -> f32 {
    let [a, b] = across(normal);
    let origin = point + normal * (1e-3 * reach_m);
    let mut open = 0.0;
    for k in 0..RAYS {
        let radius2 = (k as f32 + 0.5) / RAYS as f32;
        // golden angle: even in all directions
        let angle = TAU * 0.381_966 * k as f32;
        let radius = radius2.sqrt();
        let d = a * (radius * angle.cos())
            + b * (radius * angle.sin())
            + normal * (1.0 - radius2).sqrt();
        open += match bvh.nearest(&origin, &d, 0.0, reach_m) {
            Some(hit) => hit.t / reach_m,
            None => 1.0,
        };
    }
    open / RAYS as f32
}

/// Area-weighted means of the normals around each vertex.
fn vertex_normals(mesh: &TriangleMesh) -> Vec<P3> {
    let mut normals = vec![P3::zeros(); mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|k| P3::from(mesh.vertices[k as usize]));
        let normal = (b - a).cross(&(c - a));
        for k in triangle {
            normals[*k as usize] += normal;
        }
    }
    let unit = |normal: P3| normal.try_normalize(1e-20).unwrap_or_else(P3::z);
    normals.into_iter().map(unit).collect()
}
