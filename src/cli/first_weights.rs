//! `first-weights`: what bounds from both sides start from, fitted to many designs and scenes.

use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};

use super::choices::BudgetChoice;
use super::{Failure, output};
use crate::evaluation::format_duration;
use crate::formats::{check_writable, read_bytes, write_safely};
use crate::information::{Decoder, DecoderFit, InformationError, PretrainedWeights};
use crate::workbench::{first_channel, first_scene};

/// Largest file of weights that is read, bytes.
const LARGEST_WEIGHTS: u64 = 1 << 28;
/// Time between two files.
const WRITTEN_EVERY: Duration = Duration::from_mins(1);

/// Arguments of `first-weights`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// What is fitted.
    #[arg(value_enum)]
    of: Of,

    /// Time to fit, such as 30m or 2h.
    #[arg(long, default_value = "1h", value_name = "TIME")]
    budget: BudgetChoice,

    /// Seed of first weights, designs and scenes.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Weights to go on from, of an earlier call; those of a decoder at a third of the rate.
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,

    /// Unrolled steps of the decoder; those of --start are taken again where it has fewer [default: those of --start, or of the
    /// decoder of the program].
    #[arg(long, value_name = "COUNT")]
    unrolled: Option<usize>,

    /// File to write the weights to, every minute and at the end.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// What has first weights.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Of {
    /// The decoder that bounds from below start from.
    Decoder,
    /// The density model of live and full estimates.
    Density,
}

impl Arguments {
    /// Does it.
    pub fn run(self) -> Result<(), Failure> {
        let start = self.start.as_deref().map(|path| read_bytes(path, LARGEST_WEIGHTS)).transpose()?;
        let of_start = || self.start.as_deref().unwrap_or(Path::new("")).display().to_string();
        check_writable(&self.out)?;
        let (seed, budget) = (self.seed, self.budget.0);
        let mut writer = Writer::new(&self.out);
        let (fitted, bytes) = match self.of {
            Of::Decoder => {
                let (mut decoder, rate) = if let Some(bytes) = &start {
                    let start = Decoder::from_bytes(bytes).with_context(of_start)?;
                    let unrolled = self.unrolled.unwrap_or(start.unrolled());
                    (start.deepened(unrolled).context("--unrolled")?, DecoderFit::RATE_ON)
                } else {
                    let unrolled = self.unrolled.unwrap_or(Decoder::UNROLLED);
                    (Decoder::new(unrolled, seed).context("--unrolled")?, DecoderFit::RATE)
                };
                let fit = (budget, seed, rate);
                let fitted = decoder.fit_generally(&|number| first_channel(seed, number), fit, &mut |now, snapshot| {
                    let (steps, channels, bits) = (now.steps, now.channels, now.saved_bits);
                    let told = format_args!("{steps} steps, {channels} channels, {bits:.4} bits/px saved of late");
                    writer.hear(now.elapsed, told, &mut || snapshot().to_bytes())
                });
                (fitted, decoder.to_bytes())
            }
            Of::Density => {
                if self.unrolled.is_some() {
                    return Err(anyhow!("--unrolled is for decoders; leave it out").into());
                }
                let mut weights = match &start {
                    Some(bytes) => PretrainedWeights::from_bytes(bytes).with_context(of_start)?,
                    None => PretrainedWeights::new(seed),
                };
                let fitted = weights.fit(&|number| first_scene(seed, number), (budget, seed), &mut |now, snapshot| {
                    let (steps, scenes, bits) = (now.steps, now.scenes, now.bits);
                    let told = format_args!("{steps} steps, {scenes} scenes, {bits:.4} bits/px of late");
                    writer.hear(now.elapsed, told, &mut || snapshot().to_bytes())
                });
                (fitted, weights.to_bytes())
            }
        };
        if let Some(failure) = writer.failure {
            return Err(failure);
        }
        fitted?;
        writer.write(&bytes?)?;
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
        elapsed: Duration,
        told: fmt::Arguments<'_>,
        bytes: &mut dyn FnMut() -> Result<Vec<u8>, InformationError>,
    ) -> ControlFlow<()> {
        if self.written.elapsed() < WRITTEN_EVERY {
            return ControlFlow::Continue(());
        }
        self.written = Instant::now();
        output::report(format_args!("{}: {told}", format_duration(elapsed)));
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
