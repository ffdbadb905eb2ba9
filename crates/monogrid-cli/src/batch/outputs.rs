//! Where tasks write beside their folders: no output is an input, and no two collide.

use super::task::Task;
use monogrid_app::output::resolved;
use monogrid_app::process::failure::Failure;
use monogrid_video::is_recording;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// All that a batch writes: its folder, and the files of its tasks.
#[derive(Debug, Default)]
pub struct Written {
    places: BTreeSet<PathBuf>,
}

impl Written {
    /// By these tasks, into this folder.
    pub fn of(tasks: &[Task], out: &Path) -> Self {
        let files = tasks.iter().filter_map(|task| task.mcap.as_deref());
        Self {
            places: files.chain([out]).map(resolved).collect(),
        }
    }

    /// What is written in a folder, by its name in it.
    pub fn below<'a>(&'a self, folder: &'a Path) -> impl Iterator<Item = &'a Path> {
        let from = self.places.range(folder.to_owned()..);
        from.map_while(move |place| place.strip_prefix(folder).ok())
    }
}

/// Refuses outputs that collide with each other, with the folder of the batch or with something
/// that is read, by whatever spelling or link. `inputs` are files that the call itself reads.
///
/// # Errors
/// Names both, and where the second was named.
pub fn refuse_collisions<'a>(
    tasks: &'a [Task],
    out: &Path,
    inputs: impl Iterator<Item = &'a Path>,
) -> Result<(), Failure> {
    if tasks.iter().all(|task| task.mcap.is_none()) {
        return Ok(());
    }
    let mut taken = Taken::default();
    taken.add(resolved(out), "the folder of the batch".to_owned());
    for task in tasks {
        let Some(file) = &task.mcap else { continue };
        let place = resolved(file);
        if let Some(what) = taken.meets(&place) {
            return Err(refused(task, file, &what));
        }
        taken.add(place, format!("that of {}", task.name));
    }
    let mut read = Taken::default();
    let files = tasks.iter().flat_map(|task| &task.option_files);
    let files = files.map(PathBuf::as_path).chain(inputs);
    files.for_each(|file| read.add(resolved(file), "a file that is read".to_owned()));
    let mut folders = BTreeMap::new();
    for task in tasks {
        let what = format!("the recording of {}", task.name);
        match task.source.is_dir() {
            true => folders.insert(resolved(&task.source), (&task.source, what)),
            false => {
                read.add(resolved(&task.source), what);
                None
            }
        };
    }
    for task in tasks {
        let Some(file) = &task.mcap else { continue };
        let place = resolved(file);
        if let Some(what) = read.meets(&place) {
            return Err(refused(task, file, &what));
        }
        // beside images it does no harm; in the folder of a recording in parts it would be one of
        // them
        let around = place.ancestors().find_map(|folder| folders.get(folder));
        if let Some((_, what)) = around.filter(|(source, _)| is_recording(source)) {
            return Err(refused(task, file, &format!("in {what}")));
        }
    }
    Ok(())
}

fn refused(task: &Task, file: &Path, what: &str) -> Failure {
    Failure::input(format!(
        "{}: the output {} of {} is {what}, or one lies in the other; expected a file of its own",
        task.place,
        file.display(),
        task.name
    ))
}

/// Places that are taken, and by what.
#[derive(Default)]
struct Taken {
    places: BTreeMap<PathBuf, String>,
}

impl Taken {
    fn add(&mut self, place: PathBuf, what: String) {
        self.places.entry(place).or_insert(what);
    }

    /// What is at a place, around it or in it.
    fn meets(&self, place: &Path) -> Option<String> {
        let around = place.ancestors().find_map(|folder| self.places.get(folder));
        // paths are in the order of their parts: what lies in a folder comes right after it
        let after = self.places.range(place.to_owned()..).next();
        let within = after.filter(|(other, _)| other.starts_with(place));
        around.or(within.map(|(_, what)| what)).cloned()
    }
}
