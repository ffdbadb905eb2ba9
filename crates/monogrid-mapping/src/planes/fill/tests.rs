//! Plain panels whose true depth is known.

use super::*;

const WIDTH: usize = 120;
const HEIGHT: usize = 90;

/// Inverse depth of a slanted wall.
fn wall(x: f64, y: f64) -> f64 {
    0.4 + 0.0005 * x - 0.0003 * y
}

/// A picture with a checkered rim and a plain panel, columns 20 to 99 and rows 20 to 69.
fn panel() -> Image<u8> {
    Image::from_fn(WIDTH, HEIGHT, |x, y| {
        if is_panel(x, y) {
            128
        } else {
            40 + 160 * u8::from((x / 3 + y / 3) % 2 == 0)
        }
    })
}

fn is_panel(x: usize, y: usize) -> bool {
    (20..100).contains(&x) && (20..70).contains(&y)
}

/// Measurements of all pixels around the panel, of the given inverse depth, with 0.5 % of noise
/// from a fixed sequence.
fn rim(idepth: impl Fn(usize, usize) -> f64) -> Vec<Measurement> {
    let mut state = 1u32;
    let mut out = Vec::new();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            if !is_panel(x, y) {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let noise = f64::from(state >> 8) / f64::from(1 << 24) - 0.5;
                let d = idepth(x, y) * (1.0 + 0.01 * noise);
                out.push(Measurement {
                    x: x as u16,
                    y: y as u16,
                    idepth: d as f32,
                    sigma_idepth: (0.01 * d) as f32,
                });
            }
        }
    }
    out
}

fn filled(measured: &[Measurement]) -> Vec<Measurement> {
    fill_plain_regions(&panel(), measured, 0.035)
}

#[test]
fn a_plain_panel_gets_the_plane_of_its_outline() {
    let filled = filled(&rim(|x, y| wall(x as f64, y as f64)));
    assert!(filled.len() > 3200, "{}", filled.len());
    for p in &filled {
        assert!(is_panel(p.x.into(), p.y.into()));
        let truth = wall(p.x.into(), p.y.into());
        let error = (f64::from(p.idepth) / truth - 1.0).abs();
        assert!(error < 0.005, "{} {}: {error}", p.x, p.y);
        assert!(f64::from(p.sigma_idepth) < 0.035 * f64::from(p.idepth));
    }
    let ordered = filled
        .windows(2)
        .all(|w| (w[0].y, w[0].x) < (w[1].y, w[1].x));
    assert!(ordered);
}

#[test]
fn what_stands_before_a_wall_does_not_bend_it() {
    // a cupboard covers everything below the panel
    let filled = filled(&rim(|x, y| {
        wall(x as f64, y as f64) * if y < 70 { 1.0 } else { 1.6 }
    }));
    assert!(filled.len() > 2500, "{}", filled.len());
    for p in &filled {
        let error = (f64::from(p.idepth) / wall(p.x.into(), p.y.into()) - 1.0).abs();
        assert!(error < 0.01, "{} {}: {error}", p.x, p.y);
    }
}

#[test]
fn a_wall_lies_behind_the_frames_and_skirtings_that_outline_it() {
    // some of the outline stands 1 % before the wall
    let error = |is_wall: fn(usize) -> bool| {
        let factor = |x, y| if is_wall(x + y) { 1.0 } else { 1.01 };
        let measured = rim(|x, y| wall(x as f64, y as f64) * factor(x, y));
        let filled = fill_plain_regions(&panel(), &measured, 0.035);
        let errors = filled.iter().map(|p| {
            let truth = wall(p.x.into(), p.y.into());
            f64::from(p.idepth) / truth - 1.0
        });
        errors.sum::<f64>() / filled.len() as f64
    };
    // one of three points; with the weight of the others it draws the plane by 0.0015 to 0.004
    let behind = error(|k| k % 3 > 0);
    assert!(behind.abs() < 0.001, "{behind}");
    // where nothing stands before it, noise moves it by half its deviation at most, though this has
    // no peak to come back to
    let alone = error(|_| true);
    assert!(alone.abs() < 0.0015, "{alone}");
}

#[test]
fn an_outline_that_is_no_plane_fills_nothing() {
    // a quarter of the outline lies on one plane and the rest behind it, at many depths
    let filled = filled(&rim(|x, y| {
        if x < 20 {
            0.8
        } else {
            0.2 + 0.05 * ((x * 7 + y * 13) % 9) as f64
        }
    }));
    assert_eq!(filled.len(), 0);
}

#[test]
fn far_from_a_small_outline_nothing_is_filled() {
    // depth is known in one corner of the rim only
    let near_corner = |p: &Measurement| p.x < 32 && p.y < 32;
    let measured: Vec<Measurement> = rim(|x, y| wall(x as f64, y as f64))
        .into_iter()
        .filter(near_corner)
        .collect();
    let filled = filled(&measured);
    assert!(!filled.is_empty());
    // the corner of the panel is (20, 20), the opposite one (99, 69)
    let farthest = filled.iter().map(|p| p.x + p.y).max();
    assert!(farthest < Some(120), "{farthest:?}");
}

#[test]
fn a_plane_is_not_continued_beyond_its_outline() {
    // what bounds the panel on the right was not measured: the wall may end anywhere
    let is_left = |p: &Measurement| p.x < 60;
    let measured: Vec<Measurement> = rim(|x, y| wall(x as f64, y as f64))
        .into_iter()
        .filter(is_left)
        .collect();
    let filled = filled(&measured);
    let farthest = filled.iter().map(|p| p.x).max();
    assert!((Some(58)..Some(70)).contains(&farthest), "{farthest:?}");
}

#[test]
fn textured_pictures_and_empty_ones_stay_as_they_are() {
    let texture = Image::from_fn(WIDTH, HEIGHT, |x, y| ((x * 37 + y * 91) % 200) as u8);
    let measured = rim(|x, y| wall(x as f64, y as f64));
    assert!(fill_plain_regions(&texture, &measured, 0.035).is_empty());
    assert!(fill_plain_regions(&panel(), &[], 0.035).is_empty());
}
