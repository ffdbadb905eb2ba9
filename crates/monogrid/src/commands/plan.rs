//! `monogrid plan`: a path for a robot through a map.

use super::print_json;
use super::tools::point;
use crate::args::{JsonArg, positive};
use crate::failure::{Classify, CommandResult, Outcome};
use crate::mapfile;
use clap::Args;
use monogrid_evaluation::{PlanConfig, plan_path};
use std::path::PathBuf;

/// `monogrid plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Map to read (.ot, .bt or .mgo)
    pub map: PathBuf,
    /// Where the robot's centre is, in the unit of the map
    #[arg(value_name = "FROM", value_parser = point, allow_hyphen_values = true)]
    pub from: [f64; 3],
    /// Where it is to go
    #[arg(value_name = "TO", value_parser = point, allow_hyphen_values = true)]
    pub to: [f64; 3],
    /// Radius of the robot, a ball, in the unit of the map
    #[arg(long, value_name = "R", value_parser = positive)]
    pub robot_radius: f64,
    /// The robot may enter cells of which nothing is known
    #[arg(long)]
    pub through_unknown: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Plans and prints the path.
pub fn execute(args: &PlanArgs) -> CommandResult {
    let (map, _) = mapfile::load(&args.map)?;
    let config = PlanConfig {
        through_unknown: args.through_unknown,
        ..PlanConfig::with_radius(args.robot_radius)
    };
    let path = plan_path(&map, args.from, args.to, &config).bad_input()?;
    if args.json.json {
        print_json(&path)?;
        return Ok(Outcome::Done);
    }
    println!(
        "# x y z in the unit of the map; length {:.3}, at least {:.3} from every obstacle, cells of {}",
        path.length, path.clearance, path.planning_cell
    );
    for [x, y, z] in &path.points {
        println!("{x:.4} {y:.4} {z:.4}");
    }
    Ok(Outcome::Done)
}
