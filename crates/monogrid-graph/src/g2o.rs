//! Pose graphs as g2o text files.
//!
//! Written, one record per line, numbers in the shortest form that reads back exactly:
//!
//! ```text
//! VERTEX_SIM3:QUAT id  x y z  qx qy qz qw  s          world_from_keyframe, p_w = s R p_k + t
//! EDGE_SIM3:QUAT i j  x y z  qx qy qz qw  s  I        i_from_j, then the upper triangle of the
//!                                                     7x7 information, row by row
//! FIX id                                              keyframe that does not move
//! ```
//!
//! The information of `EDGE_SIM3:QUAT` is that of a **left** update `[v, w, s]` of `i_from_j` (see
//! [`crate::pose_graph`]). Robust kernels have no place in the format.
//!
//! `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT` are read as g2o defines them: the 6x6 information belongs
//! to `[t, q_xyz]` of `M^-1 T_i^-1 T_j`, and is moved to the left side and to rotation vectors to
//! first order. Such an edge holds the ratio of the two scales at one with [`RIGID_SCALE_SIGMA`].
//! When every scale is one, [`write_rigid`] writes these records, for viewers and solvers without
//! similarities.

use crate::RobustKernel;
use crate::pose_graph::{GraphEdge, GraphNode, PoseGraph, PoseGraphError};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Mat6, Mat7, Rotation, Se3, Sim3, Vec3};
use std::fmt::Write as _;

/// Standard deviation of the log-scale of an edge that was read from a rigid record.
pub const RIGID_SCALE_SIGMA: f64 = 1e-4;

/// What is wrong with a g2o text.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum G2oError {
    /// A record that is too short, or a field that is not a number.
    #[error("line {line}: {tag} needs {expected} numbers, found {found}")]
    Fields {
        /// Line, from 1.
        line: usize,
        /// The record's tag.
        tag: String,
        /// Numbers that the record has.
        expected: usize,
        /// Numbers that could be read.
        found: usize,
    },
    /// An identity that is not a whole number, or a quaternion of length zero.
    #[error("line {line}: {what}")]
    Value {
        /// Line, from 1.
        line: usize,
        /// What was found.
        what: String,
    },
    /// The graph refuses a record.
    #[error("line {line}: {source}")]
    Graph {
        /// Line, from 1.
        line: usize,
        /// Why.
        source: PoseGraphError,
    },
}

/// A graph that was read, and what of the text was not understood.
#[derive(Clone, Debug, PartialEq)]
pub struct G2oFile {
    /// The graph.
    pub graph: PoseGraph,
    /// Tags of other records, each once, in order of appearance; they were skipped.
    pub skipped_tags: Vec<String>,
}

/// The text of a graph with `SIM3` records.
#[must_use]
pub fn write(graph: &PoseGraph) -> String {
    let mut out = String::new();
    for node in graph.nodes() {
        let pose = numbers(&node.world_from_keyframe);
        line(&mut out, &format!("VERTEX_SIM3:QUAT {}", node.id), &pose);
    }
    fixed(&mut out, graph);
    for edge in graph.edges() {
        let mut values = numbers(&edge.i_from_j);
        for r in 0..7 {
            values.extend((r..7).map(|c| edge.information[(r, c)]));
        }
        let tag = format!("EDGE_SIM3:QUAT {} {}", edge.i, edge.j);
        line(&mut out, &tag, &values);
    }
    out
}

/// The text of a graph with `SE3` records: scales are dropped, translations are written in world
/// units at the present scale of keyframe `i`.
#[must_use]
pub fn write_rigid(graph: &PoseGraph) -> String {
    let mut out = String::new();
    for node in graph.nodes() {
        let values = &numbers(&node.world_from_keyframe)[..7];
        line(&mut out, &format!("VERTEX_SE3:QUAT {}", node.id), values);
    }
    fixed(&mut out, graph);
    for edge in graph.edges() {
        let scale = graph.pose(edge.i).map_or(1.0, |pose| pose.scale);
        let measured = edge.i_from_j.to_se3().stretched(scale);
        let mut values = numbers(&Sim3::from(measured));
        values.truncate(7);
        // A translation that is longer by the scale has less information by its square.
        let mut information: Mat6 = edge.information.fixed_view::<6, 6>(0, 0).into_owned();
        for r in 0..6 {
            for c in 0..6 {
                let lengths = i32::from(r < 3) + i32::from(c < 3);
                information[(r, c)] /= scale.powi(lengths);
            }
        }
        // e = D^-1 Ad(M^-1) r  =>  W_e = (Ad(M) D)' W_r (Ad(M) D)
        let move_right = measured.adjoint() * quaternion_to_vector();
        let information = move_right.transpose() * information * move_right;
        for r in 0..6 {
            values.extend((r..6).map(|c| information[(r, c)]));
        }
        let tag = format!("EDGE_SE3:QUAT {} {}", edge.i, edge.j);
        line(&mut out, &tag, &values);
    }
    out
}

/// Rotation vector from the vector part of a quaternion, to first order; translations as they are.
fn quaternion_to_vector() -> Mat6 {
    Mat6::from_diagonal(&monogrid_geometry::Vec6::new(1.0, 1.0, 1.0, 2.0, 2.0, 2.0))
}

fn fixed(out: &mut String, graph: &PoseGraph) {
    for node in graph.nodes().iter().filter(|n| n.is_fixed) {
        line(out, &format!("FIX {}", node.id), &[]);
    }
}

fn numbers(t: &Sim3) -> Vec<f64> {
    let (p, q) = (t.translation, t.rotation.coords);
    vec![p.x, p.y, p.z, q.x, q.y, q.z, q.w, t.scale]
}

fn line(out: &mut String, head: &str, values: &[f64]) {
    out.push_str(head);
    for value in values {
        // Writing into a string cannot fail.
        let _ = write!(out, " {value}");
    }
    out.push('\n');
}

/// Reads a graph. Records of one file may come in any order; every edge gets `kernel`.
///
/// # Errors
/// When a record is incomplete, names an unknown keyframe or holds values that no graph accepts.
pub fn read(text: &str, kernel: RobustKernel) -> Result<G2oFile, G2oError> {
    let mut graph = PoseGraph::new();
    let mut skipped_tags: Vec<String> = vec![];
    let (mut edges, mut fixed) = (vec![], vec![]);
    for (index, content) in text.lines().enumerate() {
        let record = Record::new(index + 1, content);
        let refuse = |source| G2oError::Graph {
            line: record.line,
            source,
        };
        match record.tag {
            "" => {}
            tag if tag.starts_with('#') => {}
            "VERTEX_SIM3:QUAT" | "VERTEX_SE3:QUAT" => {
                let is_sim3 = record.tag == "VERTEX_SIM3:QUAT";
                let values = record.values(1, if is_sim3 { 8 } else { 7 })?;
                let node = GraphNode {
                    id: record.id(0)?,
                    world_from_keyframe: record.similarity(&values)?,
                    is_fixed: false,
                };
                graph.add_node(node).map_err(refuse)?;
            }
            "EDGE_SIM3:QUAT" | "EDGE_SE3:QUAT" => edges.push((record.line, record.edge(kernel)?)),
            "FIX" => fixed.push((record.line, record.id(0)?)),
            tag => {
                if !skipped_tags.iter().any(|t| t == tag) {
                    skipped_tags.push(tag.to_owned());
                }
            }
        }
    }
    for (line, edge) in edges {
        let refuse = |source| G2oError::Graph { line, source };
        graph.add_edge(edge).map_err(refuse)?;
    }
    for (line, id) in fixed {
        let refuse = |source| G2oError::Graph { line, source };
        graph.set_fixed(id, true).map_err(refuse)?;
    }
    Ok(G2oFile {
        graph,
        skipped_tags,
    })
}

/// One line, split into its tag and its fields.
struct Record<'a> {
    line: usize,
    tag: &'a str,
    fields: Vec<&'a str>,
}

impl<'a> Record<'a> {
    fn new(line: usize, content: &'a str) -> Self {
        let mut words = content.split_whitespace();
        Self {
            line,
            tag: words.next().unwrap_or(""),
            fields: words.collect(),
        }
    }

    fn id(&self, at: usize) -> Result<u64, G2oError> {
        let field = self.fields.get(at).copied().unwrap_or("");
        field.parse().map_err(|_| G2oError::Value {
            line: self.line,
            what: format!("keyframe {field:?} is not a whole number"),
        })
    }

    /// `count` numbers after the first `skip` fields.
    fn values(&self, skip: usize, count: usize) -> Result<Vec<f64>, G2oError> {
        let fields = self.fields.iter().skip(skip);
        let values: Vec<f64> = fields.map_while(|f| f.parse().ok()).take(count).collect();
        if values.len() == count {
            return Ok(values);
        }
        Err(G2oError::Fields {
            line: self.line,
            tag: self.tag.to_owned(),
            expected: count,
            found: values.len(),
        })
    }

    /// A similarity from `x y z qx qy qz qw [s]`.
    fn similarity(&self, v: &[f64]) -> Result<Sim3, G2oError> {
        let quaternion = Quaternion::new(v[6], v[3], v[4], v[5]);
        let rotation = Rotation::try_new(quaternion, 1e-6).ok_or_else(|| G2oError::Value {
            line: self.line,
            what: "quaternion of length zero".to_owned(),
        })?;
        // Keep the bits of a quaternion that is already of unit length.
        let rotation = if (quaternion.norm() - 1.0).abs() < 1e-12 {
            Rotation::new_unchecked(quaternion)
        } else {
            rotation
        };
        let scale = v.get(7).copied().unwrap_or(1.0);
        Ok(Sim3::new(scale, rotation, Vec3::new(v[0], v[1], v[2])))
    }

    fn edge(&self, kernel: RobustKernel) -> Result<GraphEdge, G2oError> {
        let is_sim3 = self.tag == "EDGE_SIM3:QUAT";
        let (pose_len, size) = if is_sim3 { (8, 7) } else { (7, 6) };
        let values = self.values(2, pose_len + size * (size + 1) / 2)?;
        let (pose, upper) = values.split_at(pose_len);
        let i_from_j = self.similarity(pose)?;
        let mut information = Mat7::zeros();
        let mut next = upper.iter();
        for r in 0..size {
            for c in r..size {
                let value = next.next().copied().unwrap_or(0.0);
                information[(r, c)] = value;
                information[(c, r)] = value;
            }
        }
        if !is_sim3 {
            information = rigid_information(&information, &i_from_j.to_se3());
        }
        Ok(GraphEdge {
            i: self.id(0)?,
            j: self.id(1)?,
            i_from_j,
            information,
            kernel,
        })
    }
}

/// Information of a left update from that of g2o's `[t, q_xyz]` on the right:
/// `e = D^-1 Ad(M^-1) r`.
fn rigid_information(right: &Mat7, measured: &Se3) -> Mat7 {
    let right: Mat6 = right.fixed_view::<6, 6>(0, 0).into_owned();
    let halve = Mat6::from_diagonal(&quaternion_to_vector().diagonal().map(|x| 1.0 / x));
    let move_left = halve * measured.inverse().adjoint();
    let left = move_left.transpose() * right * move_left;
    let mut out = Mat7::zeros();
    out.fixed_view_mut::<6, 6>(0, 0)
        .copy_from(&((left + left.transpose()) * 0.5));
    out[(6, 6)] = 1.0 / (RIGID_SCALE_SIGMA * RIGID_SCALE_SIGMA);
    out
}
