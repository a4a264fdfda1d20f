//! The benchmark suite: speed beside error, measured as data. Nothing here prints or draws.
//!
//! A **group** measures one thing about the program on a few **subjects** (scenes or cases). A subject holds
//! **series** (one a method), a series **points** (one a setting), and a point keeps every sample of every
//! quantity ([`crate::report::record`]). [`crate::report`] turns that into CSV, JSON, Markdown and HTML.
//!
//! **How to add a group:** write `src/bench/NAME.rs` with a function `run(&Context) -> Result<Measurements>`, add a
//! variant to [`Group`] with its name, title and explanation, and a line to `Group::run`. Everything else follows: the
//! command line, the records, the tables and the report. Quantities are made by naming them in
//! [`Point::push`](crate::report::record::Point::push). A subject's [`Chart`](crate::report::record::Chart)s say which of them to draw.
//!
//! **How to measure:** whatever enters a ratio is measured in turn within one process, round by round, after a
//! round that does not count ([`rounds`]). Every round has a seed of its own, so the spread of an error is its spread
//! over randomisations. Timings are wall times of work on [`Context::threads`] threads unless a series says otherwise.

mod accuracy;
mod elements;
mod embree;
mod foreign;
mod form_factors;
mod frames;
mod hard_cases;
mod images;
mod machine;
mod memory;
mod methods;
mod pictures;
mod radiosity;
pub mod reference;
mod scaling;
mod scenes;
mod view;

pub use machine::machine;
pub use scenes::{Files, Glossy, SCENES, embedded, glossy_cornell};

use crate::embree::Device;
use crate::report::record::{Figure, GroupRecord, Subject, Suite};
use crate::{Error, Result};
use std::path::PathBuf;
use std::time::Instant;

/// What can be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Embree's own rate, and what is kept of it.
    Embree,
    /// Pass 1 against exact cases.
    Radiosity,
    /// Form factors by rays, hemi-cubes and closed forms.
    FormFactors,
    /// Error of images over time.
    Images,
    /// Uniform and adaptive elements.
    Elements,
    /// Images of a given error.
    Accuracy,
    /// The two-pass method beside what came before it.
    Methods,
    /// Cases on which other programs break.
    HardCases,
    /// Time over the number of elements.
    Scaling,
    /// Memory of whole runs.
    Memory,
}

impl Group {
    /// All groups, in the order in which they run and are shown.
    pub const ALL: [Group; 10] = [
        Group::Embree,
        Group::Radiosity,
        Group::FormFactors,
        Group::Images,
        Group::Elements,
        Group::Accuracy,
        Group::Methods,
        Group::HardCases,
        Group::Scaling,
        Group::Memory,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        self.words().0
    }

    /// Name, title and explanation.
    fn words(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Group::Embree => (
                "embree",
                "Embree's rate, and what is kept of it",
                "Embree finds where rays meet surfaces; everything else the program does costs time on top. This group tells how \
                 much: rays a second of Embree alone against the program's form-factor stage on the same rays.",
            ),
            Group::Radiosity => (
                "radiosity",
                "Pass 1 against exact cases",
                "Pass 1 finds the diffuse light of a scene. In the cases here the right answer is known, so the error needs no \
                 reference: how it falls with more rays, finer elements, and more steps of the solver.",
            ),
            Group::FormFactors => (
                "form-factors",
                "Form factors: rays, hemi-cubes and closed forms",
                "The comparison that the program was made for: how wrong a matrix of form factors after how long, for rays over the \
                 hemisphere, rays pair by pair, hemi-cubes and closed forms, on configurations from two squares to tens of thousands of \
                 elements. Every method is swept from fast to precise in the same run. Hemi-cubes are drawn by the program's own \
                 z-buffer; they need no tree, whose making counts as time of the rays.",
            ),
            Group::Images => (
                "images",
                "Error of images over time",
                "The question that a user has: how good a picture after how long? Every method renders the same views in the same run, \
                 and its error is measured against a converged reference.",
            ),
            Group::Elements => (
                "elements",
                "Uniform and adaptive elements",
                "Adaptive elements are fine only where the light asks for it. How many uniform ones show a picture as well, and how long \
                 either takes.",
            ),
            Group::Accuracy => (
                "accuracy",
                "Images of a given error",
                "With `--error` the program chooses how to make an image. Whether it is as wrong as was asked for, and as it says.",
            ),
            Group::Methods => (
                "methods",
                "The two-pass method beside what came before it",
                "One scene with a glossy floor and a mirror by every method that the literature of 1980 to 1987 offers, and by path \
                 tracing. Ray tracing after Whitted (1980) lacks light between diffuse surfaces, and radiosity (Goral et al. 1984) lacks \
                 reflections. Directional radiosity (Immel, Cohen and Greenberg 1986) has both, at the price of a value for every direction \
                 of every specular element. The two-pass method (Wallace, Cohen and Greenberg 1987) has both, too.",
            ),
            Group::HardCases => (
                "hard-cases",
                "Hard cases",
                "Geometry, light and amounts of work on which radiosity, form factors and single-precision rays are known to break. The \
                 answer of each case does not come from the program's own rays: a furnace (uniform emission E and albedo rho in a closed \
                 scene give E / (1 - rho) everywhere), quadrature of Lambert's formula, a closed form, or the independent path \
                 tracer. \"error\" is the largest over the surfaces compared, relative to the answer; \"standard error\" is what the \
                 program itself states. A case is right within its limit (1 %; 0.5 % for the furnace of albedo 0.9999; for rooms far \
                 away ten times the image's departure is shown, so that 1 % means 0.1 %) or four standard errors, whichever is larger. \
                 \"said so\" means that the program refuses or warns by name, as it must.",
            ),
            Group::Scaling => (
                "scaling",
                "From a thousand to a million elements",
                "How time, rate and memory of pass 1 grow with the number of elements, on one thread and on all.",
            ),
            Group::Memory => ("memory", "Memory", "How much memory whole runs of the program need."),
        }
    }

    fn run(self, context: &Context) -> Result<Measurements> {
        match self {
            Group::Embree => embree::run(context),
            Group::Radiosity => radiosity::run(context),
            Group::FormFactors => form_factors::run(context),
            Group::Images => images::run(context),
            Group::Elements => elements::run(context),
            Group::Accuracy => accuracy::run(context),
            Group::Methods => methods::run(context),
            Group::HardCases => hard_cases::run(context),
            Group::Scaling => scaling::run(context),
            Group::Memory => memory::run(context),
        }
    }

    /// The groups of these names, in the suite's own order; all without names.
    pub fn named(names: &[String]) -> Result<Vec<Group>> {
        if let Some(unknown) = names.iter().find(|n| Group::ALL.iter().all(|g| g.name() != n.as_str())) {
            let known: Vec<&str> = Group::ALL.iter().map(|g| g.name()).collect();
            return Err(Error::Usage(format!(
                "no group is called {unknown:?}; there are {}",
                known.join(", ")
            )));
        }
        let chosen = |g: &Group| names.is_empty() || names.iter().any(|n| n == g.name());
        Ok(Group::ALL.into_iter().filter(chosen).collect())
    }
}

/// What a group hands back.
#[derive(Debug, Default)]
pub struct Measurements {
    /// The few figures that matter, for the front page.
    pub figures: Vec<Figure>,
    /// Scene by scene, case by case.
    pub subjects: Vec<Subject>,
}

/// What the suite is asked for.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Fewer and smaller measurements: the whole suite within two minutes on two cores.
    pub quick: bool,
    /// Seed of the first round.
    pub seed: u32,
    /// Folder of cached references.
    pub cache: PathBuf,
    /// This program, to measure the memory of whole processes; without it that is skipped.
    pub program: Option<PathBuf>,
    /// Folder of another renderer's images of known scenes; without it the comparison is skipped.
    pub foreign: Option<PathBuf>,
}

/// What every group is given.
pub struct Context<'a> {
    /// What was asked for.
    pub settings: &'a Settings,
    /// Embree.
    pub device: &'a Device,
    /// Hears what is being measured.
    pub observer: &'a (dyn Fn(&str) + Sync),
}

impl Context<'_> {
    /// `quick` in a quick run, `full` otherwise.
    pub fn choose<T>(&self, quick: T, full: T) -> T {
        if self.settings.quick { quick } else { full }
    }

    /// Threads that measurements run on.
    pub fn threads(&self) -> usize {
        rayon::current_num_threads()
    }
}

/// A pool of `n` threads, for measurements that compare their number.
fn pool(n: usize) -> Result<rayon::ThreadPool> {
    let built = rayon::ThreadPoolBuilder::new().num_threads(n).build();
    built.map_err(|e| Error::Usage(format!("{n} threads: {e}")))
}

/// One thread, and all of them.
fn thread_counts(context: &Context) -> Vec<usize> {
    let all = context.threads();
    if all == 1 { vec![1] } else { vec![1, all] }
}

/// `1 thread`, `2 threads`.
fn threads_in_words(n: usize) -> String {
    if n == 1 { "1 thread".into() } else { format!("{n} threads") }
}

/// Runs `work` once unheard as a warm-up, then `count` times with the seeds from `seed` on.
pub fn rounds(seed: u32, count: u32, mut work: impl FnMut(u32, bool) -> Result<()>) -> Result<()> {
    work(seed, false)?;
    (0..count).try_for_each(|k| work(seed.wrapping_add(k), true))
}

/// Measures groups one after the other. `keep` is given all that has been measured after each, so that whoever ends the run
/// early loses no more than one group.
pub fn run(groups: &[Group], context: &Context, mut keep: impl FnMut(&Suite) -> Result<()>) -> Result<()> {
    let mut suite = Suite { machine: machine(context), groups: Vec::new() };
    for &group in groups {
        let (name, title, about) = group.words();
        (context.observer)(name);
        let start = Instant::now();
        let found = group.run(context)?;
        suite.groups.push(GroupRecord {
            name: name.into(),
            title: title.into(),
            about: about.into(),
            seconds: start.elapsed().as_secs_f64(),
            figures: found.figures,
            subjects: found.subjects,
        });
        suite.check()?;
        keep(&suite)?;
    }
    Ok(())
}
