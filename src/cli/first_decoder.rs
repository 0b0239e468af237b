//! `first-decoder`: the decoder that bounds from below start from, fitted to many designs and scenes.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;

use super::choices::BudgetChoice;
use super::{Failure, output};
use crate::formats::{read_if_there, write_safely};
use crate::information::{Decoder, DecoderFit, DecoderKind, FirstProgress, InformationError};
use crate::workbench::{first_channel, spoken};

/// Time between two files.
const WRITTEN_EVERY: Duration = Duration::from_mins(1);

/// Arguments of `first-decoder`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Time to fit, such as 30m or 2h.
    #[arg(long, default_value = "1h", value_name = "TIME")]
    budget: BudgetChoice,

    /// Seed of first weights, designs and scenes.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Weights to go on from, of an earlier call.
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,

    /// File to write the weights to, every minute and at the end.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let start =
            match &self.start {
                Some(path) => Some(read_if_there(path)?.ok_or_else(|| {
                    anyhow::anyhow!("{}: expected weights to go on from, found no file", path.display())
                })?),
                None => None,
            };
        let (seed, length) = (self.seed, (self.budget.0, self.seed));
        let mut writer = Writer::new(&self.out);
        let mut decoder = match &start {
            Some(bytes) => Decoder::from_bytes(bytes)?,
            None => Decoder::new(DecoderFit::of_steps(0, DecoderKind::Autoregressive, 0).unrolled, seed)?,
        };
        let channel = |number| first_channel(seed, number);
        let fitted = decoder
            .fit_generally(&channel, length, &mut |now, snapshot| writer.hear(now, &mut || snapshot().to_bytes()));
        if let Some(failure) = writer.failure {
            return Err(failure);
        }
        fitted?;
        writer.write(&decoder.to_bytes()?)?;
        output::print(&format!("Wrote {}", self.out.display()))
    }
}

/// Writes and tells what becomes of a fit.
struct Writer<'a> {
    out: &'a Path,
    written: Instant,
    failure: Option<Failure>,
}

impl<'a> Writer<'a> {
    fn new(out: &'a Path) -> Self {
        Self { out, written: Instant::now(), failure: None }
    }

    fn hear(
        &mut self,
        now: &FirstProgress,
        bytes: &mut dyn FnMut() -> Result<Vec<u8>, InformationError>,
    ) -> ControlFlow<()> {
        if self.written.elapsed() < WRITTEN_EVERY {
            return ControlFlow::Continue(());
        }
        self.written = Instant::now();
        let FirstProgress { steps, channels, saved_bits, elapsed } = *now;
        output::tell(format_args!(
            "{}: {steps} steps, {channels} channels, {saved_bits:.4} bits/px saved of late",
            spoken(elapsed)
        ));
        match bytes().map_err(Failure::from).and_then(|bytes| self.write(&bytes)) {
            Ok(()) => ControlFlow::Continue(()),
            Err(failure) => {
                self.failure = Some(failure);
                ControlFlow::Break(())
            }
        }
    }

    fn write(&self, bytes: &[u8]) -> Result<(), Failure> {
        Ok(write_safely(self.out, |file| file.write_all(bytes))?)
    }
}
