//! How good is a map of `generate_scans.py`'s room? Compares `.ot` maps with its mesh of boxes.
//!
//! `box_room_quality office.obj MAP.ot ...` prints AUC (exact, ties counted half) and MCC at
//! p >= 0.5 over the cells that the map has observed and the mesh knows: a cell is occupied if a
//! face of a box crosses it, free if it lies in the room and outside all furniture.
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use std::error::Error;
use std::fs::File;

use monogrid_occupancy::*;

type Bounds = ([f64; 3], [f64; 3]);

/// The boxes of the mesh: the room first, then the furniture.
fn read_boxes(path: &str) -> Result<Vec<Bounds>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path)?;
    let vertices: Vec<[f64; 3]> = text
        .lines()
        .filter_map(|line| line.strip_prefix("v "))
        .map(|line| {
            let mut words = line.split(' ').map(str::parse);
            let mut next = || words.next().unwrap_or(Ok(f64::NAN));
            Ok([next()?, next()?, next()?])
        })
        .collect::<Result<_, std::num::ParseFloatError>>()?;
    let bounds = vertices.chunks(8).map(|corners| {
        corners
            .iter()
            .fold(([f64::MAX; 3], [f64::MIN; 3]), |(low, high), c| {
                (
                    std::array::from_fn(|i| low[i].min(c[i])),
                    std::array::from_fn(|i| high[i].max(c[i])),
                )
            })
    });
    Ok(bounds.collect())
}

/// How a cell lies to a box: 0 outside, 1 crossed by a face, 2 inside.
fn relation(cell: &Bounds, bounds: &Bounds) -> u8 {
    let overlaps = (0..3).all(|i| cell.0[i] <= bounds.1[i] && cell.1[i] >= bounds.0[i]);
    let inside = (0..3).all(|i| cell.0[i] > bounds.0[i] && cell.1[i] < bounds.1[i]);
    u8::from(overlaps) + u8::from(inside)
}

fn truth(cell: &Bounds, boxes: &[Bounds]) -> Occupancy {
    let mut state = match relation(cell, &boxes[0]) {
        0 => return Occupancy::Unknown,
        1 => return Occupancy::Occupied,
        _ => Occupancy::Free,
    };
    for furniture in &boxes[1..] {
        match relation(cell, furniture) {
            1 => return Occupancy::Occupied,
            2 => state = Occupancy::Unknown,
            _ => {}
        }
    }
    state
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let boxes = read_boxes(&arguments.next().ok_or("usage: OBJ MAP.ot ...")?)?;
    for path in arguments {
        let map = read_ot(File::open(&path)?, 8 << 30)?;
        let resolution = map.resolution();
        // Observed cells by log-odds in 1/4096: occupied and free ones.
        let mut histogram = vec![[0_u64; 2]; 1 << 16];
        for cell in map.cells() {
            let low = cell.key.to_array().map(|c| f64::from(c) * resolution);
            let bounds = (low, low.map(|c| c + resolution));
            let bin = ((cell.log_odds * 4096.0) as i32 + (1 << 15)) as usize;
            match truth(&bounds, &boxes) {
                Occupancy::Occupied => histogram[bin][0] += 1,
                Occupancy::Free => histogram[bin][1] += 1,
                Occupancy::Unknown => {}
            }
        }
        let total = histogram
            .iter()
            .fold([0.0, 0.0], |t, h| [t[0] + h[0] as f64, t[1] + h[1] as f64]);
        let (mut below, mut area) = (0.0, 0.0);
        for [occupied, free] in histogram.iter().map(|h| h.map(|c| c as f64)) {
            area += occupied * (below + 0.5 * free);
            below += free;
        }
        let above = histogram[1 << 15..]
            .iter()
            .fold([0.0, 0.0], |t, h| [t[0] + h[0] as f64, t[1] + h[1] as f64]);
        let (tp, fp) = (above[0], above[1]);
        let (fn_, tn) = (total[0] - tp, total[1] - fp);
        let mcc = (tp * tn - fp * fn_) / ((tp + fp) * (tp + fn_) * (tn + fp) * (tn + fn_)).sqrt();
        println!(
            "{path}: res {resolution} auc_observed {:.4} mcc {mcc:.4} precision {:.4} recall {:.4} \
             occupied {} free {}",
            area / (total[0] * total[1]),
            tp / (tp + fp),
            tp / (tp + fn_),
            total[0],
            total[1],
        );
    }
    Ok(())
}
