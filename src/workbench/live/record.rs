//! Records of live estimates: files with all that reproduces the numbers.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::evaluation::scene::{EvaluationError, Scene};
use crate::formats::{DocumentKind, FormatError, content_key, create_folder, json_of, write_json};
use crate::forward::Design;
use crate::information::{Bracket, CausalStart, NUMBERS_VERSION, NamedBound, PairedDifference};
use crate::objects::ReadProgress;
use crate::optics::{Encoder, MASK_DOCUMENT_VERSION};
use crate::progress::Progress;
use crate::workbench::live::estimate::{LiveEstimate, ReplayRecipe};
use crate::workbench::live::estimator::repeated;

/// The kind of the file.
pub(crate) const LIVE_ESTIMATE: DocumentKind =
    DocumentKind::new("lenslet-studio/live-estimate", "a record of a live estimate").at_version(MASK_DOCUMENT_VERSION);

/// A live estimate with its design and its recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct LiveRecord {
    format: String,
    format_version: u64,
    /// Version of the program that computed the estimate.
    program_version: String,
    /// The design, its objects by absolute path.
    pub design: Design,
    /// Fingerprint of the objects.
    objects_fingerprint: String,
    /// The numbers.
    pub numbers: LiveNumbers,
    /// Recipe of the numbers.
    recipe: ReplayRecipe,
    /// The start of the fit; none where it started from the pretrained weights.
    start: Option<CausalStart>,
    /// The mask before the last edit, where there was one that can be compared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    before: Option<Encoder>,
}

/// The numbers of a live estimate, bits per pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct LiveNumbers {
    /// The estimate, an upper bound.
    pub bits_per_pixel: f64,
    /// Its 95 % interval.
    pub interval_95: [f64; 2],
    /// Cross-entropy of the measurements.
    pub entropy_y: f64,
    /// Entropy of the noise.
    pub entropy_y_given_x: f64,
    /// Number of held-out patches of the score.
    pub test_patches: usize,
    /// Rows and columns of a patch.
    pub patch: [usize; 2],
    /// The largest lower bound, where the prior is known.
    pub lower: Option<NamedBound>,
    /// The upper bound by annealed importance sampling, where the prior is known.
    pub upper: Option<NamedBound>,
    /// Bounds for whole measurements, where the prior is known and the estimate had converged.
    #[serde(default)]
    pub sensor: Option<Bracket>,
    /// Information gain over the mask before the last edit, where the prior is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edit: Option<PairedDifference>,
}

impl LiveNumbers {
    fn of(live: &LiveEstimate) -> Self {
        Self {
            bits_per_pixel: live.bits_per_pixel,
            interval_95: live.interval_95,
            entropy_y: live.entropy_y,
            entropy_y_given_x: live.entropy_y_given_x,
            test_patches: live.recipe.test_patches,
            patch: live.patch.into(),
            lower: live.lower.clone(),
            upper: live.upper.clone(),
            sensor: live.sensor.as_ref().map(|sensor| sensor.bracket.clone()),
            edit: live.edit,
        }
    }
}

/// Result of recomputing a live estimate.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Repeated {
    /// The numbers now.
    pub numbers: LiveNumbers,
    /// The numbers of the record.
    pub recorded: LiveNumbers,
    /// Whether they are the same to the last bit.
    pub same: bool,
    /// Differences between then and now, where there are any.
    pub notes: Vec<String>,
}

impl LiveRecord {
    /// The record of an estimate of a design before a scene.
    pub fn new(design: &Design, scene: &Scene, live: &LiveEstimate) -> Self {
        let before = live.before.as_ref().map(|before| before.encoder.clone());
        let version_before = before.as_ref().map_or(1, Encoder::document_version);
        Self {
            format: LIVE_ESTIMATE.format.to_owned(),
            format_version: design.document_version().max(version_before),
            program_version: NUMBERS_VERSION.to_owned(),
            design: Design { objects: design.objects.absolute(), ..design.clone() },
            objects_fingerprint: scene.set.fingerprint(),
            numbers: LiveNumbers::of(live),
            recipe: live.recipe,
            start: live.start.as_deref().cloned(),
            before,
        }
    }

    /// Writes the record; the folder is created if it is missing.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FormatError> {
        if let Some(folder) = path.parent() {
            create_folder(folder)?;
        }
        write_json(path, self)
    }

    /// File name of the record. Records of the same numbers have the same name, others have different ones.
    pub fn file_name(&self) -> String {
        let mut weights = blake3::Hasher::new();
        for weight in self.start.iter().flat_map(CausalStart::weights) {
            weights.update(&weight.to_le_bytes());
        }
        let key = content_key(&json!({
            "objects": self.objects_fingerprint,
            "design": json_of(&self.design),
            "before": json_of(&self.before),
            "recipe": json_of(&self.recipe),
            "weights": weights.finalize().to_hex().to_string(),
        }));
        format!("live-{}.json", &key[..16])
    }

    /// Returns the record if a window may have written it; otherwise a description of what was found.
    pub(crate) fn checked(self) -> Result<Self, String> {
        self.design.check().map_err(|error| error.to_string())?;
        if let Some(before) = self.design_before() {
            before.check().map_err(|error| error.to_string())?;
        }
        if !self.recipe.is_valid() {
            return Err(format!("a recipe that no window makes, {:?}", self.recipe));
        }
        if self.start.as_ref().is_some_and(|start| !start.is_sound()) {
            return Err("a start of the fit that is damaged".to_owned());
        }
        Ok(self)
    }

    /// The design before the last edit.
    fn design_before(&self) -> Option<Design> {
        self.before.clone().map(|encoder| Design { encoder, ..self.design.clone() })
    }

    /// Steps of the fit.
    pub fn steps(&self) -> usize {
        self.recipe.steps
    }

    /// Recomputes the estimate: equal to the last bit on the same machine with the same version. Reports the number of steps of the fit,
    /// and once more before the score and before the bounds.
    ///
    /// # Errors
    /// Where the objects cannot be opened or the design allows no estimate, and when `progress` cancels.
    pub fn repeat(&self, progress: &mut dyn Progress<usize>) -> Result<Repeated, EvaluationError> {
        let scene = Scene::open(&self.design, &mut |_: &ReadProgress| progress.report(&0))?;
        let before = self.design_before().map(Arc::new);
        let (recipe, start) = (&self.recipe, self.start.as_ref());
        let live = repeated(&self.design, before.as_ref(), &scene, recipe, start, progress)?;
        let numbers = LiveNumbers::of(&live);
        let mut notes = Vec::new();
        if scene.set.fingerprint() != self.objects_fingerprint {
            notes.push("the objects are no longer those of the record".to_owned());
        }
        if self.program_version != NUMBERS_VERSION {
            notes.push(format!("the record was written by version {}", self.program_version));
        }
        Ok(Repeated { same: numbers == self.numbers, numbers, recorded: self.numbers.clone(), notes })
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::ops::ControlFlow;

    use super::*;
    use crate::evaluation::scene::{Optics, SceneTables};
    use crate::objects::ObjectSource;
    use crate::optics::heuristic_layout;
    use crate::progress::CancelToken;
    use crate::sensor::Noise;
    use crate::workbench::jobs::record::{Record, RecordError};
    use crate::workbench::live::bounds::BoundSource;
    use crate::workbench::live::estimator::LiveEstimator;
    use crate::workbench::live::inspection::{InspectionKey, InspectionRequest};

    fn open(path: &Path) -> Result<LiveRecord, RecordError> {
        let Record::Live(record) = Record::open(path)? else { panic!("a record of a run") };
        Ok(*record)
    }

    /// The first requested estimate of a design.
    fn first(
        refiner: &mut LiveEstimator,
        design: &Design,
        before: Option<&Arc<Design>>,
        scene: &Arc<Scene>,
        wanted: fn(&LiveEstimate) -> bool,
    ) -> LiveEstimate {
        let (found, cancel) = (RefCell::new(None), CancelToken::new());
        let mut publish = |estimate: LiveEstimate| {
            if wanted(&estimate) && found.borrow().is_none() {
                found.replace(Some(estimate));
                cancel.cancel();
            }
        };
        let ended = refiner.refine(design, before, scene, &mut publish, &cancel);
        assert!(ended.as_ref().is_err_and(EvaluationError::is_cancelled), "{ended:?}");
        found.into_inner().unwrap()
    }

    #[test]
    #[ignore = "takes a minute or more; run with --ignored"]
    fn live_estimates_come_out_the_same_from_their_records() {
        let folder = tempfile::tempdir().unwrap();
        let design = |count| Design { encoder: Encoder::Lenslets(heuristic_layout(count)), ..Design::default() };
        let (one, two) = (design(1), design(2));
        let scene = Arc::new(Scene::open(&one, &mut CancelToken::new()).unwrap());
        let mut refiner = LiveEstimator::default();
        let is_revised = |live: &LiveEstimate| live.recipe.revised.is_some_and(|by| live.recipe.steps > by.after);
        let cold = first(&mut refiner, &one, None, &scene, is_revised);
        let before = Arc::new(one.clone());
        let has_all = |live: &LiveEstimate| live.upper.is_some() && live.edit.is_some();
        let warm = first(&mut refiner, &two, Some(&before), &scene, has_all);
        // Two lenslets give more information than one, by about the difference of their bounds.
        let gain = warm.edit.unwrap();
        let [first_lower, then] = [&cold, &warm].map(|live| live.lower.as_ref().unwrap().bits_per_pixel);
        assert!(cold.edit.is_none() && gain.is_clear(), "{gain:?}");
        assert!((gain.bits_per_pixel - (then - first_lower)).abs() < 0.02, "{gain:?} {first_lower} {then}");
        assert!(cold.start.is_none() && warm.start.is_some() && warm.recipe.revised.is_none());
        assert!(matches!(warm.recipe.upper, Some(BoundSource::Ais { .. })));
        for (name, design, live) in [("cold", &one, &cold), ("warm", &two, &warm)] {
            let path = folder.path().join("new folder").join(name);
            let record = LiveRecord::new(design, &scene, live);
            record.save(&path).unwrap();
            let read = open(&path).unwrap();
            assert_eq!(read, record);
            let repeated = read.repeat(&mut CancelToken::new()).unwrap();
            assert!(repeated.same && repeated.notes.is_empty(), "{repeated:#?}");
            assert_eq!(repeated.numbers.bits_per_pixel, live.bits_per_pixel);
            assert!(read.repeat(&mut |_: &usize| ControlFlow::Break(())).is_err_and(|error| error.is_cancelled()));
        }
        // A record may be of the very first step, and a repetition be stopped when its fit is done.
        let record = LiveRecord::new(&one, &scene, &cold);
        let first = LiveRecord { recipe: ReplayRecipe { steps: 1, ..record.recipe }, ..record.clone() };
        assert!(first.repeat(&mut |_: &usize| ControlFlow::Break(())).is_err_and(|error| error.is_cancelled()));
        // The last step of the fit, the score and the bounds each report the same number.
        for last in 1..=3 {
            let mut reports = 0;
            let mut until_last = |steps: &usize| {
                reports += usize::from(*steps == first.steps());
                if reports < last { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            };
            assert!(first.repeat(&mut until_last).is_err_and(|error| error.is_cancelled()));
            assert_eq!(reports, last);
        }
        assert_ne!(LiveRecord::new(&one, &scene, &cold).file_name(), LiveRecord::new(&one, &scene, &warm).file_name());
    }

    #[test]
    #[ignore = "takes a minute or more; run with --ignored"]
    fn estimates_of_few_images_come_out_the_same_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("images.idx");
        let mut bytes: Vec<u8> = vec![0, 0, 8, 3, 0, 0, 0, 20, 0, 0, 0, 32, 0, 0, 0, 32];
        bytes.extend((0..20 * 32 * 32_u32).map(|i| if (i / 1024 + 3) * (i % 32) % 19 < 7 { 200 } else { 10 }));
        std::fs::write(&path, bytes).unwrap();
        let encoder = Encoder::Lenslets(heuristic_layout(2));
        let design = Design { objects: ObjectSource::Idx(path), encoder, ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        assert!(scene.set.fitting_parts().1.is_some());
        let mut refiner = LiveEstimator::default();
        refiner.set_pace(0.1);
        let on_the_way = first(&mut refiner, &design, None, &scene, |live| live.recipe.test_patches > 32);
        refiner.set_pace(0.1);
        let settled = first(&mut refiner, &design, None, &scene, |live| live.remaining.is_none());
        assert!(on_the_way.remaining.is_some() && settled.start.is_some());
        for live in [&on_the_way, &settled] {
            let repeated = LiveRecord::new(&design, &scene, live).repeat(&mut CancelToken::new()).unwrap();
            assert!(repeated.same, "{repeated:#?}");
        }
    }

    #[test]
    #[ignore = "takes a minute or more; run with --ignored"]
    fn last_bounds_that_were_interrupted_come_without_another_fit() {
        let design = Design { encoder: Encoder::Lenslets(heuristic_layout(1)), ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let mut refiner = LiveEstimator::default();
        // So slow that the fewest steps are planned.
        refiner.set_pace(1.0);
        let settled = first(&mut refiner, &design, None, &scene, |live| live.remaining.is_none());
        let mut published = Vec::new();
        refiner.refine(&design, None, &scene, &mut |live| published.push(live), &CancelToken::new()).unwrap();
        let [first, pulled, last, whole, done] = &published[..] else { panic!("{} estimates", published.len()) };
        assert!(pulled.pulls.is_some() && pulled.upper == first.upper);
        assert_eq!(first.upper, settled.upper);
        assert_eq!((last.bits_per_pixel, last.recipe.steps), (settled.bits_per_pixel, settled.recipe.steps));
        assert!(last.lower.is_some() && last.recipe.upper != settled.recipe.upper, "{:?}", last.recipe);
        // Whole measurements come last. They give less information per pixel, because patches also count what neighbouring patches share.
        let sensor = whole.sensor.as_ref().unwrap();
        assert!(last.sensor.is_none() && sensor.patch == (65, 65));
        assert_eq!([first.bounding, last.bounding, whole.bounding, done.bounding], [true, true, true, false]);
        assert_eq!(done.sensor, whole.sensor);
        let (lower, upper) = (sensor.bracket.lower.unwrap(), sensor.bracket.upper);
        assert!(lower > 0.15 && upper < 0.19 && whole.lower.as_ref().unwrap().bits_per_pixel > upper, "{sensor:?}");
        let repeated = LiveRecord::new(&design, &scene, whole).repeat(&mut CancelToken::new()).unwrap();
        assert!(repeated.same && repeated.numbers.sensor.is_some(), "{repeated:#?}");
    }

    #[test]
    fn where_weak_read_noise_is_left_out_of_bounds_the_map_is_of_the_counts() {
        let noise = Noise::ShotRead { sigma: 0.1 };
        let design = Design { encoder: Encoder::Lenslets(heuristic_layout(1)), noise, ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let live = first(&mut LiveEstimator::default(), &design, None, &scene, |_| true);
        let optics = Optics::of(&design, scene.set.planes()).unwrap();
        let prepared = SceneTables::new(&scene, design.encoder.grid()).unwrap();
        let measurements = Arc::new(prepared.measure(&design, &optics, &scene).unwrap());
        let counts = measurements.counts.as_ref().unwrap();
        let are_below = |(count, noisy): (&f32, &f32)| count.fract() == 0.0 && (count - noisy).abs() < 1.0;
        assert!(counts.iter().zip(&measurements.noisy).all(are_below));
        let key = InspectionKey { revision: 1, sample: 0, noisy: true, steps: Some(live.recipe.steps) };
        let closer =
            InspectionRequest { key, measurements, model: Some(live.model) }.look(&CancelToken::new()).unwrap();
        let map = closer.map.unwrap();
        let mean = map.iter().map(|&bits| f64::from(bits)).sum::<f64>() / map.len() as f64;
        assert!((0.0..2.0).contains(&mean), "{mean} bits per pixel");
    }

    #[test]
    fn other_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.json");
        let format = LIVE_ESTIMATE.format;
        let mut texts = vec!["{}".to_owned(), "[]".into(), format!("{{\"format\": \"{format}\"}}")];
        texts.push(format!("{{\"format\": \"{format}\", \"format_version\": 3}}"));
        texts.push(format!("{{\"format\": \"{format}\", \"format_version\": 1, \"recipe\": 3}}"));
        for text in texts {
            std::fs::write(&path, &text).unwrap();
            let refusal = open(&path).unwrap_err().to_string();
            assert!(refusal.contains("record.json") && refusal.contains("record of a live"), "{text}: {refusal}");
        }
    }

    #[test]
    fn damaged_records_are_refused_before_anything_is_computed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("record.json");
        let design = Design { encoder: Encoder::Lenslets(heuristic_layout(1)), ..Design::default() };
        let scene = Arc::new(Scene::open(&design, &mut CancelToken::new()).unwrap());
        let mut refiner = LiveEstimator::default();
        first(&mut refiner, &design, None, &scene, |_| true);
        let warm = first(&mut refiner, &design, None, &scene, |_| true);
        let record = serde_json::to_value(LiveRecord::new(&design, &scene, &warm)).unwrap();
        let opened = |change: &dyn Fn(&mut serde_json::Value)| {
            let mut changed = record.clone();
            change(&mut changed);
            std::fs::write(&path, changed.to_string()).unwrap();
            open(&path)
        };
        assert!(opened(&|_| {}).is_ok());
        let changes: [&dyn Fn(&mut serde_json::Value); 9] = [
            &|record| record["recipe"]["planned"] = 1_000_000_000_u64.into(),
            &|record| record["recipe"]["revised"] = serde_json::json!({ "after": 9, "planned": 1_u64 << 40 }),
            &|record| record["recipe"]["steps"] = 0.into(),
            &|record| record["recipe"]["upper"] = serde_json::json!({ "at_once": { "samples": 1_u64 << 62 } }),
            &|record| {
                record["recipe"]["lower"] = serde_json::json!({ "followed": { "levels": 1_u64 << 40, "samples": 9 } });
            },
            &|record| record["start"]["span"]["high"] = 1e300.into(),
            &|record| record["start"]["far"] = serde_json::json!([]),
            &|record| record["start"]["far"][0][0] = (1_i64 << 62).into(),
            &|record| record["start"]["weights"] = serde_json::json!([0.5]),
        ];
        for (number, change) in changes.into_iter().enumerate() {
            assert!(matches!(opened(change), Err(RecordError::Refused { .. })), "change {number}");
        }
    }
}
