//! `study decoders`: information of masks beside the image quality of decoders (resumable).

use std::ops::ControlFlow;
use std::path::PathBuf;

use clap::Args;

use super::choices::{BudgetChoice, PublishedChoice, check_count, check_folder, layout, objects_argument};
use super::failure::Failure;
use super::output;
use super::output::ProgressLine;
use crate::evaluation::format_duration;
use crate::information::{Protocol, with_interval};
use crate::objects::ObjectSource;
use crate::plural::counted;
use crate::reconstruction::DecoderKind;
use crate::studies::{
    DecoderStudy, DecoderStudyCell, DecoderStudyEvent, DecoderStudySettings, StudyDesign, StudyObjects,
};

/// Fewest test objects, as one has no interval, and most.
const TEST_OBJECTS: std::ops::RangeInclusive<usize> = 2..=1_000_000;

/// Arguments of `study decoders`.
#[derive(Args, Debug)]
pub(super) struct DecodersArgs {
    /// Folder of the study. An unfinished study in it is resumed.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Objects in place of beads of density 0.02, as in estimate; repeat the flag for several.
    #[arg(long, value_name = "OBJECTS", value_parser = objects_argument())]
    objects: Vec<ObjectSource>,

    /// Published image set of each --objects (or of each that is read from files), in the same order.
    #[arg(long, value_enum, value_name = "NAME", requires = "objects")]
    published_as: Vec<PublishedChoice>,

    /// Heuristic layouts by their number of lenslets [default: 1 to 9].
    #[arg(long, value_name = "COUNTS", value_delimiter = ',', value_parser = layout)]
    lenslets: Vec<usize>,

    /// Decoders; posterior is for beads alone.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "linear,posterior")]
    decoders: Vec<DecoderKind>,

    /// Markov chains of this many sweeps for each image refine the posterior mean.
    #[arg(long, value_name = "N")]
    sweeps: Option<usize>,

    /// default: background and light of the scene; paper: no background, each object alone scaled to 100 photons per pixel.
    #[arg(long, default_value_t = Protocol::Default)]
    protocol: Protocol,

    /// Test objects of each decoder.
    #[arg(long, default_value_t = 500)]
    test: usize,

    /// Time of training of a network for one mask.
    #[arg(long, default_value = "60s")]
    training: BudgetChoice,

    /// Time for the information of one mask, such as 60s or 5m.
    #[arg(long, default_value = "60s")]
    information: BudgetChoice,

    /// Seed of objects, noise and fits.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Print the result file.
    #[arg(long)]
    json: bool,
}

impl DecodersArgs {
    fn settings(&self) -> anyhow::Result<DecoderStudySettings> {
        let usual = DecoderStudySettings::beads();
        let objects = objects_of(&self.objects, &self.published_as)?;
        let layouts = self.lenslets.iter().map(|&count| StudyDesign::heuristic(count));
        Ok(DecoderStudySettings {
            objects: if objects.is_empty() { usual.objects.clone() } else { objects },
            designs: if self.lenslets.is_empty() { usual.designs.clone() } else { layouts.collect() },
            decoders: self.decoders.clone(),
            protocol: self.protocol,
            test: self.test,
            sweeps: self.sweeps,
            training_seconds: self.training.0.as_secs_f64(),
            information_seconds: self.information.0.as_secs_f64(),
            seed: self.seed,
            ..usual
        })
    }

    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        check_count("--test", self.test, TEST_OBJECTS)?;
        let settings = self.settings()?;
        settings.check()?;
        check_folder(&self.out)?;
        let mut study = DecoderStudy::open(settings, &self.out)?;
        let progress_line = ProgressLine::new();
        let (cells, fits) = study.missing();
        if cells > 0 {
            let (cells, fits) = (counted(cells, "cell"), format_duration(fits));
            progress_line
                .report(format_args!("{cells} to go: fits take {fits}, reading and reconstruction come on top"));
        }
        study.run(&mut |event: &DecoderStudyEvent<'_>| {
            match event.finished {
                None => progress_line.show(event.done, event.cells, event.name),
                Some(cell) => progress_line.report(finished(event, cell)),
            }
            ControlFlow::Continue(())
        })?;
        progress_line.finish();
        let record = study.record();
        let printed = if self.json {
            output::print_json(record)
        } else {
            let files = study.files().iter().map(|file| format!("  {}", file.display())).collect::<Vec<_>>().join("\n");
            output::print(&format!("{}\nWritten:\n{files}", study.markdown()))
        };
        let failed = record.cells.iter().filter(|cell| cell.failure.is_some()).count();
        if failed > 0 {
            return Err(Failure::Incomplete(anyhow::anyhow!(
                "{}: expected a result in every cell, found {failed} of {} failed; run the same command to retry them",
                self.out.display(),
                counted(record.cells.len(), "cell")
            )));
        }
        printed
    }
}

fn finished(event: &DecoderStudyEvent<'_>, cell: &DecoderStudyCell) -> String {
    let result = match (&cell.information, &cell.quality, &cell.failure) {
        (Some(information), ..) => format!("{:.4} bits per pixel", information.best()),
        (_, Some(quality), _) => format!("{} dB", with_interval(quality.psnr_db, quality.psnr_db_interval_95)),
        (.., failure) => format!("failed: {}", failure.as_deref().unwrap_or_default()),
    };
    format!("Cell {} of {}: {}: {result}", event.done, event.cells, event.name)
}

/// Objects with the published set that each corresponds to; no names for objects without published values.
fn objects_of(sources_of: &[ObjectSource], published_as: &[PublishedChoice]) -> anyhow::Result<Vec<StudyObjects>> {
    let (sources, names) = (sources_of.len(), published_as.len());
    let read = sources_of.iter().filter(|source| source.is_read()).count();
    if ![0, sources, read].contains(&names) {
        anyhow::bail!(
            "--published-as: expected one for each of {sources} --objects in the same order, or for each of {read} that are \
             read from files, found {names}; give none for objects without published values"
        );
    }
    let mut choices = published_as.iter();
    let mut objects = Vec::with_capacity(sources);
    for source in sources_of {
        let choice = if names == sources || source.is_read() { choices.next() } else { None };
        let set = choice.and_then(|choice| choice.set());
        if !source.is_read() && set.is_some() {
            anyhow::bail!(
                "{source}: expected images of a published set, found beads; give --published-as none for beads"
            );
        }
        objects.push(StudyObjects::new(source.clone(), set));
    }
    Ok(objects)
}
