//! Somebody who walks through a world.

use super::{stairs, street};
use crate::lighting::LightingConfig;
use crate::patterns;
use crate::scene::{Scene, place};
use crate::world::World;
use monogrid_geometry::{Rotation, Se3, Vec3};

/// A figure of about a person's size around its own origin on the floor.
pub(crate) fn mover_world() -> World {
    let mut scene = Scene::default();
    let s = &mut scene;
    s.object("walker");
    let coat = s.tiled(patterns::fabric(0.28, 0.9, 30, 91), 0.5, 0.5);
    let skin = s.plain(0.45);
    let dark = s.plain(0.08);
    for x in [-0.10, 0.10] {
        s.at(place(x, 0.0, 0.0, 0.0), |s| {
            let radii = [0.08, 0.06, 0.05, 0.07];
            s.lathe(&radii, &[0.85, 0.45, 0.08, 0.0], 20, dark);
        });
    }
    let radii = [0.06, 0.19, 0.20, 0.17, 0.22, 0.0];
    s.lathe(&radii, &[1.48, 1.40, 1.1, 0.95, 0.75, 0.74], 28, coat);
    s.at(place(0.0, 0.0, 1.62, 0.0), |s| {
        s.cushion([0.09, 0.11, 0.13], 0.9, skin);
    });
    s.light_below([-0.5, -0.5, 2.6], [1.0; 2], 6.0);
    World::new("walker", &scene, &LightingConfig::quick())
}

/// The cars that drive through a world, in the order of their poses; none where there is no
/// traffic.
pub(crate) fn traffic_worlds(world: &World) -> Vec<World> {
    let paints: &[f32] = match world.name() {
        "street" => &street::PAINTS,
        _ => &[],
    };
    let quick = LightingConfig::quick();
    let car = |paint: &f32| World::new("car", &street::traffic_car(*paint), &quick);
    paints.iter().map(car).collect()
}

/// Pose of the walker, 0.6 m/s: up and down the stairs where there are some, else a line through
/// the middle of the world.
pub(crate) fn mover_pose(world: &World, secs: f64) -> Se3 {
    if world.name() == "stairs" {
        let (feet, heading) = stairs::walker(secs);
        let heading = Rotation::from_axis_angle(&Vec3::z_axis(), heading);
        return Se3::new(heading, Vec3::from(feet));
    }
    let bounds = world.bounds();
    let middle = |axis: usize| 0.5 * f64::from(bounds.min[axis] + bounds.max[axis]);
    let reach = 0.25 * f64::from(bounds.max[0] - bounds.min[0]).min(8.0);
    let turn = 0.6 / reach * secs;
    let x = middle(0) + reach * turn.sin();
    let y = middle(1) + 0.3 * reach * (0.7 * turn).cos();
    let heading = Rotation::from_axis_angle(&Vec3::z_axis(), 0.3 * turn.cos());
    Se3::new(heading, Vec3::new(x, y, f64::from(bounds.min[2])))
}
