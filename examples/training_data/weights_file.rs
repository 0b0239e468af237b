//! Arguments of the two examples, and the file that receives the weights.

use std::error::Error;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use lenslet_studio::formats::write_safely;
use lenslet_studio::information::InformationError;

/// Time between two writes of the weights.
const WRITE_INTERVAL: Duration = Duration::from_mins(1);

/// Arguments of an example: `OUT MINUTES [SEED] [START] [UNROLLED]`.
pub struct Arguments {
    /// File that receives the weights.
    pub out: PathBuf,
    /// Time of the fit.
    pub budget: Duration,
    /// Seed of initial weights and training data.
    pub seed: u64,
    /// Bytes of the weights that the fit starts from, if given.
    pub start: Option<Vec<u8>>,
    /// Unrolled steps of a decoder.
    pub unrolled: Option<usize>,
}

impl Arguments {
    /// Reads the arguments of the process.
    pub fn from_env() -> Result<Self, Box<dyn Error>> {
        let mut arguments = std::env::args().skip(1);
        let (Some(out), Some(minutes)) = (arguments.next(), arguments.next()) else {
            return Err("expected OUT MINUTES [SEED] [START] [UNROLLED]".into());
        };
        let budget = Duration::try_from_secs_f64(60.0 * minutes.parse::<f64>()?)?;
        let seed = arguments.next().map_or(Ok(1), |seed| seed.parse())?;
        let start = arguments.next().map(std::fs::read).transpose()?;
        let unrolled = arguments.next().map(|steps| steps.parse()).transpose()?;
        Ok(Self { out: out.into(), budget, seed, start, unrolled })
    }
}

/// File that receives the weights every minute and at the end.
pub struct WeightsFile<'a> {
    path: &'a Path,
    written: Instant,
    failure: Option<Box<dyn Error>>,
}

impl<'a> WeightsFile<'a> {
    /// A file at `path`, not yet written.
    pub fn new(path: &'a Path) -> Self {
        Self { path, written: Instant::now(), failure: None }
    }

    /// Writes the weights and prints `status`, once a minute. Breaks if the file cannot be written.
    pub fn update(&mut self, status: &str, bytes: &dyn Fn() -> Result<Vec<u8>, InformationError>) -> ControlFlow<()> {
        if self.written.elapsed() < WRITE_INTERVAL {
            return ControlFlow::Continue(());
        }
        self.written = Instant::now();
        println!("{status}");
        let written = bytes().map_err(Box::from).and_then(|bytes| self.write(&bytes));
        match written {
            Ok(()) => ControlFlow::Continue(()),
            Err(failure) => {
                self.failure = Some(failure);
                ControlFlow::Break(())
            }
        }
    }

    /// Writes the final weights, or returns the error that stopped the fit.
    pub fn finish(
        self,
        fitted: Result<(), InformationError>,
        bytes: Result<Vec<u8>, InformationError>,
    ) -> Result<(), Box<dyn Error>> {
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        fitted?;
        self.write(&bytes?)
    }

    fn write(&self, bytes: &[u8]) -> Result<(), Box<dyn Error>> {
        Ok(write_safely(self.path, |file| file.write_all(bytes))?)
    }
}
