//! Command lines that reproduce what the window shows.
//!
//! A command holds the whole design: as flags for a published layout, as JSON on standard input otherwise. It gives the same result in
//! any folder.

use std::path::Path;

use crate::design::{Free, IdealEvent, IdealSettings, Preset, Rates};
use crate::evaluation::calibration::Calibration;
use crate::evaluation::measured::MeasuredOrder;
use crate::evaluation::request::{DensityModel, EstimateRequest};
use crate::formats::shell_word;
use crate::forward::Design;
use crate::information::{FitLength, Protocol};
use crate::optics::{Encoder, heuristic_layout};
use crate::reconstruction::{DarkLevel, DecoderKind};
use crate::workbench::cameras::comparison::ComparisonOrder;
use crate::workbench::cameras::previews::SystemCaptures;
use crate::workbench::captures::queue::CaptureOrder;
use crate::workbench::runs::segment_lengths;

/// Longest JSON of a design in a command line, bytes.
const LONGEST: usize = 40_000;

/// Command that prints the bounds and Tamura coefficients of a design.
///
/// # Errors
/// One sentence where the design is too large for a command line.
pub fn bounds_command(design: &Design) -> Result<String, String> {
    with_design("bounds", "--mask", design, "--json")
}

/// Command for an estimate of a design. The result is bit-identical on the same machine if the fit has a number of steps, or
/// if nothing is fitted.
///
/// # Errors
/// As [`bounds_command`].
pub fn estimate_command(design: &Design, request: &EstimateRequest) -> Result<String, String> {
    with_design("estimate", "--mask", design, &estimate_flags(request))
}

/// Command that tests a decoder on objects of a design, with the file of the weights of a trained one.
///
/// # Errors
/// As [`bounds_command`].
pub fn reconstruct_command(
    design: &Design,
    decoder: DecoderKind,
    weights: Option<&Path>,
    test_objects: usize,
) -> Result<String, String> {
    let decoder = name_of(decoder);
    let weights = weights.map_or(String::new(), |path| format!(" --weights {}", absolute(path)));
    with_design("reconstruct", "--mask", design, &format!("--decoder {decoder}{weights} --test {test_objects} --json"))
}

/// A path that means the same in every folder, quoted for a POSIX shell.
fn absolute(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    shell_word(&path.display().to_string())
}

/// Command that reconstructs a capture; it writes into the folder `capture`.
pub fn capture_command(CaptureOrder { files, decoder }: &CaptureOrder) -> String {
    let dark = match &files.dark {
        None => String::new(),
        Some(DarkLevel::Constant(level)) => format!(" --dark={level}"),
        Some(DarkLevel::File(path)) => format!(" --dark {}", absolute(path)),
    };
    let [measurement, psf] = [&files.measurement, &files.psf].map(|path| absolute(path));
    let (bin, decoder) = (files.bin, name_of(*decoder));
    format!(
        "lenslet-studio reconstruct --measurement {measurement} --psf {psf}{dark} --bin {bin} --decoder {decoder} --out capture"
    )
}

/// Name of a decoder on the command line.
fn name_of(decoder: DecoderKind) -> String {
    serde_json::to_value(decoder).ok().and_then(|name| name.as_str().map(String::from)).unwrap_or_default()
}

/// Command for an estimate of images of a camera, with the noise and the seed of a design.
pub fn images_command(measured: &MeasuredOrder, request: &EstimateRequest, design: &Design) -> String {
    let MeasuredOrder { source, calibration: Calibration { gain, offset, bin } } = measured;
    let path = source.to_string();
    let path = std::path::absolute(&path).map_or(path, |path| path.display().to_string());
    format!(
        "lenslet-studio estimate --measurements {} --gain {gain} --offset={offset} --bin {bin} --noise {} --seed {} {}",
        shell_word(&path),
        design.noise,
        design.seed,
        estimate_flags(request)
    )
}

/// Command that estimates and compares systems, at equal light or at their own.
pub fn comparison_command(order: &ComparisonOrder, at_equal_light: bool) -> String {
    let ComparisonOrder { captures, request, noise, equal_light, seed, is_simultaneous } = order;
    let SystemCaptures { sources, options } = &**captures;
    let mut flags: Vec<String> =
        sources.iter().map(|source| format!("--measurements {}", absolute(Path::new(&source.to_string())))).collect();
    let Calibration { gain, offset, bin } = options.calibration;
    match &options.camera {
        Some(camera) => flags.push(format!("--camera {}", absolute(camera))),
        None => flags.push(format!("--gain {gain}")),
    }
    if options.camera.is_none() && options.dark.is_none() {
        flags.push(format!("--offset={offset}"));
    }
    flags.extend(options.dark.iter().map(|path| format!("--dark {}", absolute(path))));
    flags.extend(options.flat.iter().map(|path| format!("--flat {}", absolute(path))));
    flags.extend(options.colour.channel.map(|channel| format!("--channel {channel}")));
    flags.extend(options.colour.bayer.map(|pattern| format!("--bayer {pattern}")));
    flags.extend(options.view.crop.map(|crop| format!("--crop {crop}")));
    if options.view.quarter_turns > 0 {
        flags.push(format!("--rotate {}", 90 * u16::from(options.view.quarter_turns)));
    }
    if options.view.is_mirrored {
        flags.push("--mirror".into());
    }
    flags.push(format!("--bin {bin}"));
    if *is_simultaneous {
        flags.push("--simultaneous".into());
    }
    flags.extend(equal_light.filter(|_| at_equal_light).map(|light| format!("--equal-light {light}")));
    // A camera file states its noise.
    if options.camera.is_none() {
        flags.push(format!("--noise {noise}"));
    }
    format!("lenslet-studio estimate {} --seed {seed} {}", flags.join(" "), estimate_flags(request))
}

fn estimate_flags(request: &EstimateRequest) -> String {
    let mut flags = vec![format!("--estimator {}", request.model.estimator())];
    if request.protocol == Protocol::Paper {
        flags.push("--protocol paper".into());
    }
    flags.push(format!("--patch {}", patch_name(request.patch)));
    flags.extend(request.model.length().map(|length| match length {
        FitLength::Steps(steps) => format!("--steps {steps}"),
        FitLength::Time(time) => format!("--budget {}s", time.as_secs_f64()),
    }));
    if let DensityModel::PixelCnn { engine, .. } = request.model {
        flags.push(format!("--engine {engine}"));
    }
    flags.push(format!("--patches-train {} --patches-test {}", request.patches_train, request.patches_test));
    if request.fresh {
        flags.push("--init random".into());
    }
    flags.push(format!("--trials {} --json", request.trials));
    flags.join(" ")
}

/// Command for a run of IDEAL from a design; it writes into the folder `run`. A run that was extended (`events`) takes one command for
/// each part, and each resumes at the end of the one before.
///
/// # Errors
/// As [`bounds_command`]; where the run was replanned or rewound on its way, which no command does.
pub fn run_command(start: &Design, settings: &IdealSettings, events: &[IdealEvent]) -> Result<String, String> {
    let ends = segment_lengths(settings, events)?;
    let parts = ends.into_iter().map(|steps| part_command(start, &IdealSettings { steps, ..settings.clone() }));
    Ok(parts.collect::<Result<Vec<_>, _>>()?.join("\n"))
}

fn part_command(start: &Design, settings: &IdealSettings) -> Result<String, String> {
    let mut flags =
        vec![format!("--preset {} --objective {} --steps {}", settings.preset, settings.objective, settings.steps)];
    flags.push(format!("--patch {}", patch_name(settings.patch)));
    if settings.free != Free::default() {
        let Free { positions, widths, weights } = settings.free;
        let names = [(positions, "positions"), (widths, "widths"), (weights, "weights")];
        let names: Vec<&str> = names.into_iter().filter(|(free, _)| *free).map(|(_, name)| name).collect();
        flags.push(format!("--free {}", names.join(",")));
    }
    if !settings.locked.is_empty() {
        let numbers: Vec<String> = settings.locked.iter().map(|index| (index + 1).to_string()).collect();
        flags.push(format!("--lock {}", numbers.join(",")));
    }
    if settings.min_separation_px > 0.0 {
        flags.push(format!("--min-separation {}", settings.min_separation_px));
    }
    flags.extend(settings.cardinality.map(|count| format!("--cardinality {count}")));
    if settings.anisotropic {
        flags.push("--anisotropic".into());
    }
    let published = [(Rates::PAPER_MNIST, "mnist"), (Rates::PAPER_CIFAR, "cifar10")];
    let published =
        published.into_iter().find(|(rates, _)| settings.preset == Preset::Paper && *rates == settings.rates);
    flags.extend(published.map(|(_, name)| format!("--published-as {name}")));
    let preset = IdealSettings::new(settings.preset, settings.objective, settings.seed);
    let preset = IdealSettings { rates: published.map_or(preset.rates, |(rates, _)| rates), ..preset };
    let mut overrides = settings.overrides(&preset);
    for given in ["steps", "patch", "free", "locked", "min_separation_px", "cardinality", "anisotropic", "seed"] {
        overrides.remove(given);
    }
    if !overrides.is_empty() {
        flags.push(format!("--config '{}'", serde_json::Value::Object(overrides)));
    }
    flags.push("--score none --out run".into());
    // A run takes its seed from the design.
    let start = Design { seed: settings.seed, ..start.clone() };
    with_design("optimize", "--start", &start, &flags.join(" "))
}

fn patch_name(patch: Option<(usize, usize)>) -> String {
    patch.map_or_else(|| "sensor".into(), |(rows, cols)| format!("{rows}x{cols}"))
}

/// Command for a design; `mask` is its flag for named masks.
fn with_design(command: &str, mask: &str, design: &Design, flags: &str) -> Result<String, String> {
    let design = Design { objects: design.objects.absolute(), ..design.clone() };
    let usual = Design::default();
    let (rows, cols) = design.encoder.grid();
    let layout = |count: usize| Encoder::Lenslets(heuristic_layout(count).on_grid(rows, cols));
    let published = (1..=9).find(|&count| rows == cols && design.encoder == layout(count));
    if let Some(count) = published.filter(|_| design.limits == usual.limits) {
        let Design { objects, mean_photons, bias_photons, noise, seed, .. } = &design;
        let scene = format!(
            "--objects {} --mean-photons {mean_photons} --bias {bias_photons} --noise {noise} --seed {seed}",
            shell_word(&objects.to_string())
        );
        let sizes = sizes_of(&design);
        return Ok(format!("lenslet-studio {command} {mask} heuristic:{count} {scene}{sizes} {flags}"));
    }
    let text = design.to_json().map_err(|error| error.to_string())?;
    if text.len() > LONGEST {
        return Err(format!(
            "the PSF of this design is too large for a command line; save the design and run \
             `lenslet-studio {command} FILE {flags}`"
        ));
    }
    Ok(format!("lenslet-studio {command} - {flags} <<'END'\n{text}\nEND"))
}

/// Flags for sizes of a design that are not the published ones.
fn sizes_of(design: &Design) -> String {
    let usual = Design::default();
    let ((rows, cols), (grid, _)) = (design.field, design.encoder.grid());
    let flags = [
        (grid != usual.encoder.grid().0).then(|| format!(" --grid {grid}")),
        (design.field != usual.field).then(|| format!(" --field {rows}x{cols}")),
        (design.placement != usual.placement).then(|| format!(" --placement {}", design.placement)),
    ];
    flags.into_iter().flatten().collect()
}

/// Command that reproduces a live estimate from its record.
pub fn reproduce_command(record: &Path) -> String {
    format!("lenslet-studio reproduce {}", shell_word(&record.display().to_string()))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::*;
    use crate::camera::{BayerPattern, ColourChannel, ColourChoice};
    use crate::design::Objective;
    use crate::evaluation::{MeasuredOptions, View};
    use crate::information::{EngineChoice, Estimator};
    use crate::objects::ObjectSource;
    use crate::optics::random_layout;
    use crate::reconstruction::CaptureFiles;
    use crate::sensor::Noise;

    fn request(model: DensityModel) -> EstimateRequest {
        EstimateRequest { model, ..EstimateRequest::default() }
    }

    #[test]
    fn commands_name_published_layouts_and_quote_paths() {
        let mut design = Design { objects: ObjectSource::Idx("/data/it's here".into()), ..Design::default() };
        let model = DensityModel::new(Estimator::Bracket, Some(Duration::from_secs(90)), EngineChoice::Cpu);
        let text = estimate_command(&design, &request(model)).unwrap();
        assert!(text.starts_with("lenslet-studio estimate --mask heuristic:9 --objects 'idx:/data/it'\\''s here'"));
        assert!(text.contains("--estimator bracket --patch 32x32 --budget 90s"), "{text}");
        let text = estimate_command(&design, &request(model.of_steps(700))).unwrap();
        assert!(text.contains("--steps 700") && !text.contains("--budget"), "{text}");
        let weights = Some(Path::new("/data/my net.safetensors"));
        let text = reconstruct_command(&design, DecoderKind::Network, weights, 64).unwrap();
        assert!(text.ends_with(" --decoder network --weights '/data/my net.safetensors' --test 64 --json"), "{text}");
        let text = reconstruct_command(&design, DecoderKind::TotalVariation, None, 64).unwrap();
        assert!(text.starts_with("lenslet-studio reconstruct --mask heuristic:9 "), "{text}");
        assert!(text.ends_with(" --decoder tv --test 64 --json"), "{text}");
        let sized = design.clone();
        let sized = Design { encoder: sized.encoder.on_grid(64, 64).unwrap(), field: (128, 160), ..sized };
        let text = bounds_command(&sized).unwrap();
        assert!(text.contains("--mask heuristic:9 ") && text.contains(" --grid 64 --field 128x160"), "{text}");
        design.objects = ObjectSource::Stack("here.npy".into());
        let text = bounds_command(&design).unwrap();
        assert!(text.contains("--objects stack:/"), "a path that means the same in every folder: {text}");
    }

    #[test]
    fn commands_name_images_of_a_camera() {
        let calibration = Calibration { gain: 0.5, offset: -3.0, bin: 2 };
        let order = MeasuredOrder { source: std::path::PathBuf::from("/data/a b.npy").into(), calibration };
        let model = DensityModel::new(Estimator::Causal, Some(Duration::from_secs(90)), EngineChoice::Cpu);
        let text = images_command(&order, &request(model), &Design::default());
        let head = "lenslet-studio estimate --measurements '/data/a b.npy' --gain 0.5 --offset=-3 --bin 2 --noise shot --seed 1";
        assert!(text.starts_with(head) && text.contains("--estimator causal --patch 32x32 --budget 90s"), "{text}");
    }

    #[test]
    fn commands_name_systems_and_their_options() {
        let view = View { crop: "8x9+1+2".parse().ok(), quarter_turns: 3, is_mirrored: true };
        let options = MeasuredOptions { dark: Some("/data/dark".into()), view, ..MeasuredOptions::default() };
        let sources = ["/data/a b", "/data/c.npy"].map(|path| std::path::PathBuf::from(path).into()).to_vec();
        let mut order = ComparisonOrder {
            captures: Arc::new(SystemCaptures { sources, options: options.clone() }),
            request: EstimateRequest::new(Estimator::GaussianStationary),
            noise: Noise::Shot,
            equal_light: Some(500.0),
            seed: 3,
            is_simultaneous: true,
        };
        let text = comparison_command(&order, true);
        let head = "lenslet-studio estimate --measurements '/data/a b' --measurements /data/c.npy --gain 1 --dark /data/dark \
                    --crop 8x9+1+2 --rotate 270 --mirror --bin 1 --simultaneous --equal-light 500 --noise shot --seed 3 \
                    --estimator gaussian-stationary";
        assert!(text.starts_with(head), "{text}");
        let colour = ColourChoice { channel: Some(ColourChannel::G1), bayer: Some(BayerPattern::Bggr) };
        let options = MeasuredOptions { camera: Some("/data/camera.json".into()), colour, ..options };
        order.captures = Arc::new(SystemCaptures { sources: order.captures.sources.clone(), options });
        let text = comparison_command(&order, false);
        assert!(text.contains(" --camera /data/camera.json --dark /data/dark --channel g1 --bayer BGGR "), "{text}");
        assert!(!text.contains("--noise") && !text.contains("--gain") && !text.contains("--equal-light"), "{text}");
    }

    #[test]
    fn commands_name_captures() {
        let dark = Some(DarkLevel::Constant(-3.0));
        let files = CaptureFiles { measurement: "/data/a b.tif".into(), psf: "/data/psf.tif".into(), dark, bin: 4 };
        let text = capture_command(&CaptureOrder { files, decoder: DecoderKind::TotalVariation });
        let expected = "lenslet-studio reconstruct --measurement '/data/a b.tif' --psf /data/psf.tif --dark=-3 --bin 4 \
                        --decoder tv --out capture";
        assert_eq!(text, expected);
    }

    #[test]
    fn commands_hold_other_designs_as_json() {
        let encoder = Encoder::Lenslets(random_layout(25, 3));
        let design = Design { encoder, seed: 9, ..Design::default() };
        let mut settings = IdealSettings::new(Preset::Default, Objective::Posterior, 11);
        settings.locked = vec![0, 4];
        settings.free.widths = false;
        settings.refit = 70;
        settings.rates.position = 0.05;
        let text = run_command(&design, &settings, &[]).unwrap();
        let (head, rest) = text.split_once(" <<'END'\n").unwrap();
        assert!(head.starts_with("lenslet-studio optimize - --preset default --objective posterior --steps"), "{head}");
        assert!(head.contains("--free positions,weights --lock 1,5") && head.ends_with("--out run"), "{head}");
        assert!(head.contains(r#"--config '{"rates":{"position":0.05},"refit":70}' "#), "{head}");
        let value = serde_json::from_str(rest.strip_suffix("\nEND").unwrap()).unwrap();
        assert_eq!(Design::from_value(value, "text").unwrap(), Design { seed: 11, ..design.clone() });
        // A run that was extended.
        settings.steps = 90;
        let published = Design { encoder: Encoder::Lenslets(heuristic_layout(2)), ..design };
        let text = run_command(&published, &settings, &[IdealEvent::Extended { step: 40 }]).unwrap();
        let steps: Vec<&str> = text.lines().map(|line| line.split("--steps ").nth(1).unwrap()).collect();
        assert!(steps.len() == 2 && steps[0].starts_with("40 ") && steps[1].starts_with("90 "), "{text}");
        let refusal = run_command(&published, &settings, &[IdealEvent::Unsupported]).unwrap_err();
        assert!(refusal.contains("cannot be reproduced"), "{refusal}");
    }
}
