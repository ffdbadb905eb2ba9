//! `monogrid thesis vocabulary`: what FAB-MAP knows of the appearance of the world.

use clap::Args;
use indicatif::ProgressBar;
use monogrid_app::args::WriteArgs;
use monogrid_app::output::{Inputs, OutputFile};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_app::process::use_threads;
use monogrid_datasets::{Dataset, PixelBudget, SourceOptions, read_gray};
use monogrid_features::{
    Descriptor, FeatureConfig, FeatureExtractor, PlaceVocabulary, VocabularyConfig,
    VocabularyProgress,
};
use monogrid_image::{GrayImage, Pyramid};
use rayon::prelude::*;
use serde::Serialize;
use std::cell::RefCell;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

/// `monogrid thesis vocabulary`.
#[derive(Debug, Args)]
pub struct VocabularyArgs {
    /// Folders of images, in any layout that `run` reads
    #[arg(value_name = "IMAGES", required = true)]
    pub images: Vec<PathBuf>,
    /// The file
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Use every N-th image: neighbours in a video show the same
    #[arg(long, value_name = "N", default_value = "10")]
    pub every: NonZeroUsize,
    /// Most words
    #[arg(long, value_name = "N", default_value_t = VocabularyConfig::default().max_words)]
    pub words: usize,
    /// Images that are kept as examples of places never seen
    #[arg(long, value_name = "N", default_value_t = VocabularyConfig::default().max_samples)]
    pub samples: usize,
    /// Seed of everything random
    #[arg(long, value_name = "SEED", default_value_t = VocabularyConfig::default().seed)]
    pub seed: u64,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// How the output file is written
    #[command(flatten)]
    pub write: WriteArgs,
}

#[derive(Serialize)]
struct Report<'a> {
    out: &'a Path,
    images: usize,
    descriptors: usize,
    words: usize,
    samples: usize,
    bytes: usize,
}

/// Pyramid levels, as tracking makes them.
const NUM_LEVELS: usize = 4;

/// Trains and writes.
pub fn execute(args: &VocabularyArgs) -> CommandResult {
    use_threads(args.threads)?;
    let open = |path: &PathBuf| Dataset::open(path, SourceOptions::default()).bad_input();
    // images in an archive can be read as long as these live
    let datasets = args.images.iter().map(open);
    let datasets = datasets.collect::<Result<Vec<_>, _>>()?;
    let budgets = datasets.iter().map(Dataset::pixel_budget);
    let budgets: Vec<RefCell<PixelBudget>> = budgets.map(RefCell::new).collect();
    let files = image_files(&datasets, &budgets, args.every.get());
    let paths: Vec<PathBuf> = files.iter().map(|(path, _)| path.clone()).collect();
    let inputs = Inputs::default()
        .and_all("an image", &paths)
        .and_all("a list of images", &args.images);
    let output = OutputFile::new(&args.out, args.write.force, &inputs)?;
    let images = describe(&files)?;
    let config = VocabularyConfig {
        max_words: args.words,
        max_samples: args.samples,
        seed: args.seed,
        ..VocabularyConfig::default()
    };
    let bar = ProgressBar::new_spinner();
    let vocabulary = PlaceVocabulary::train(&images, &config, |progress| {
        bar.set_message(match progress {
            VocabularyProgress::Clustering(n) => {
                format!("words, iteration {n} of at most {}", config.max_iterations)
            }
            VocabularyProgress::Words(n) => format!("words of {n} of {} images", images.len()),
            VocabularyProgress::Tree => "tree over the words".to_owned(),
        });
        bar.tick();
    })
    .map_err(Failure::input)?;
    bar.finish_and_clear();
    let bytes = vocabulary.to_bytes();
    output.write(&bytes)?;
    let report = Report {
        out: &args.out,
        images: images.len(),
        descriptors: images.iter().map(Vec::len).sum(),
        words: vocabulary.num_words(),
        samples: vocabulary.num_samples(),
        bytes: bytes.len(),
    };
    args.write.json.print(&report, || {
        let (out, megabytes) = (args.out.display(), report.bytes as f64 / 1e6);
        println!(
            "{out}: {} words of {} corners in {} images, {megabytes:.2} MB",
            report.words, report.descriptors, report.images
        );
    })
}

/// An image file, and what the images of its source may show together.
type ImageFile<'a> = (PathBuf, &'a RefCell<PixelBudget>);

/// The images to learn from, in the order of the folders.
fn image_files<'a>(
    datasets: &[Dataset],
    budgets: &'a [RefCell<PixelBudget>],
    every: usize,
) -> Vec<ImageFile<'a>> {
    let of_one = |(dataset, budget): (&Dataset, &'a RefCell<PixelBudget>)| {
        let frames = dataset.frames.iter().step_by(every);
        let files = frames.map(|frame| (frame.path.clone(), budget));
        files.collect::<Vec<ImageFile>>()
    };
    datasets.iter().zip(budgets).flat_map(of_one).collect()
}

/// Pixels of the images that are described at once, with any number of threads: each takes 16
/// bytes.
const PIXELS_AT_ONCE: usize = 12_000_000;

/// The descriptors of each image.
fn describe(files: &[ImageFile]) -> Result<Vec<Vec<Descriptor>>, Failure> {
    let extractor = FeatureExtractor::new(FeatureConfig::default());
    let bar = ProgressBar::new(files.len() as u64);
    let describe = |image: GrayImage| -> Vec<Descriptor> {
        let pyramid = Pyramid::new(image, NUM_LEVELS);
        let features = extractor.extract(&pyramid, None);
        bar.inc(1);
        features.iter().map(|f| f.descriptor).collect()
    };
    let mut described = Vec::with_capacity(files.len());
    let mut files = files.iter().peekable();
    while files.peek().is_some() {
        let (mut images, mut pixels) = (Vec::new(), 0);
        while pixels < PIXELS_AT_ONCE
            && let Some((path, budget)) = files.next()
        {
            let image = read_gray(path).bad_input()?;
            let (width, height) = (image.width(), image.height());
            budget.borrow_mut().spend(width, height).bad_input()?;
            pixels += width * height;
            images.push(image);
        }
        described.par_extend(images.into_par_iter().map(describe));
    }
    bar.finish_and_clear();
    Ok(described)
}
