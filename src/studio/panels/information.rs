//! Information and Tamura coefficient of the design, with their estimators.

use egui::{Color32, RichText, Sense, Stroke, Ui, pos2, vec2};

use crate::information::{Bracket, NamedBound, PairedDifference, between, rounded, with_interval};
use crate::studio::panels::parts::{action_entry, tamura_gauge};
use crate::studio::state::action::Action;
use crate::studio::state::bound_summary::{BoundSummary, PatchBracket};
use crate::studio::state::request::Request;
use crate::studio::state::view::View;
use crate::studio::widgets::colours::{DENSITY, ENTROPY_BOUND, FITTED, GAUSSIAN, LOWER, SAMPLED};
use crate::studio::widgets::controls::{name_widget, placeholder};
use crate::studio::widgets::format::format_significant;
use crate::workbench::RunBounds;

/// Minimal width beside the number of the headline, points: its longest word and "bits per pixel".
const LEAST_BESIDE: f32 = 90.0;
/// Minimal width of a value in the table, points.
const LEAST_VALUE: f32 = 80.0;

/// Shows the panel.
pub fn show(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let failure = view.failure();
    if let Some(failure) = failure {
        ui.colored_label(ui.visuals().error_fg_color, failure);
        ui.add_space(4.0);
    }
    let Some(information) = &view.live.information else {
        if failure.is_none() {
            placeholder(ui, "Computing");
        }
        return;
    };
    let summary = BoundSummary::of(view, &information.value, information.revision);
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        headline(ui, view, &summary, requests);
        bound_bar(ui, &summary);
        details(ui, view, &summary);
        warning(ui, &summary);
        ui.add_space(4.0);
        ui.separator();
        tamura_gauge::show(ui, view);
    });
}

/// Menu that copies or exports the numbers.
fn more(ui: &mut Ui, view: &View<'_>, requests: &mut Vec<Request>) {
    let more = ui.menu_button("...", |ui| {
        for action in [Action::CopyNumbers, Action::CopyCommand, Action::ExportLive] {
            action_entry::entry(ui, view, requests, action);
        }
    });
    let hint = "Copies the numbers or the command that reproduces them, or exports the record of the live estimate";
    name_widget(&more.response.on_hover_text(hint), "More of the numbers");
}

/// Bounds in bits per measurement, from bits per pixel.
fn whole_bits((lower, upper): (f64, f64), pixels: usize) -> String {
    let (low, high) = Bracket::in_order(lower, upper);
    format!("{:.0} \u{2013} {:.0}", low * pixels as f64, high * pixels as f64)
}

/// Headline: the bracket, or else the smallest upper bound, with its source.
fn headline(ui: &mut Ui, view: &View<'_>, summary: &BoundSummary<'_>, requests: &mut Vec<Request>) {
    let (upper, from) = summary.upper();
    let (rows, cols) = summary.bounds.patch;
    let of_sensor =
        summary.run_of_sensor.as_ref().filter(|_| summary.sensor_bracket().is_none()).and_then(bound_of_run);
    let (text, name, patch) = match (summary.sensor_bracket(), summary.lower()) {
        _ if let Some((sign, bound)) = &of_sensor => (
            format!("{sign} {}", rounded(bound.bits_per_pixel)),
            format!("whole sensor: {}", bound.from),
            format!("Whole measurements; below: {rows} x {cols} px patches"),
        ),
        (Some((lower, PatchBracket { bracket: Bracket { upper, .. }, patch: [rows, cols] })), _) => (
            between(lower, *upper),
            "whole sensor".to_owned(),
            format!(
                "{rows} x {cols} px, {} bits each; below: {} x {} px patches",
                whole_bits((lower, *upper), rows * cols),
                summary.bounds.patch.0,
                summary.bounds.patch.1
            ),
        ),
        (_, Some(lower)) => (
            between(lower.bits_per_pixel, upper),
            both(&lower.from.to_string(), &from),
            format!("Lower and upper bound for {rows} x {cols} px patches."),
        ),
        _ if summary.upper_bound().is_none() => (
            format!("\u{2248} {upper:.3}"),
            from,
            format!(
                "Approximation for {rows} x {cols} px patches, which cover some parts of the images more often than others."
            ),
        ),
        _ => (
            format!("\u{2264} {upper:.3}"),
            from,
            if summary.bounds.ceiling.is_some() {
                format!("Upper bound for {rows} x {cols} px patches; the live estimate adds a lower bound.")
            } else {
                format!(
                    "Upper bound for {rows} x {cols} px patches; these objects have no known prior and so no lower bound."
                )
            },
        ),
    };
    let run = summary.run.as_ref().or(summary.run_of_sensor.as_ref());
    let patch = match run {
        Some(run) if !run.is_of_mask && of_sensor.is_some() => {
            "Whole measurements, at an earlier step of the run.".to_owned()
        }
        Some(run) if !run.is_of_mask => format!("{rows} x {cols} px patches, at an earlier step of the run."),
        _ => patch,
    };
    let text = RichText::new(text).size(28.0);
    // Numbers of a run in progress lag behind its masks.
    let is_followed = run.is_some() && view.preview.is_following;
    let is_current = summary.current || is_followed;
    let text = if is_current { text.strong() } else { text.weak() };
    // A refining number is italic.
    let is_active = !view.is_live_paused() && view.is_live;
    let is_refining = is_active && summary.current_live().is_some_and(|live| live.remaining.is_some() || live.bounding);
    let refining = summary.sensor_bracket().is_none() && is_refining;
    let text = if refining || is_followed { text.italics() } else { text };
    let name = if is_current { name } else { format!("{name}, of an earlier edit") };
    ui.horizontal(|ui| {
        // The space beside the button in the corner.
        let room = vec2((ui.available_width() - 34.0).max(80.0), 36.0);
        let extend = Some(egui::TextWrapMode::Extend);
        let number = egui::WidgetText::from(text).into_galley(ui, extend, f32::INFINITY, egui::TextStyle::Body);
        let is_beside = room.x - number.size().x - ui.spacing().item_spacing.x >= LEAST_BESIDE;
        let direction = if is_beside { egui::Direction::LeftToRight } else { egui::Direction::TopDown };
        let layout = egui::Layout::from_main_dir_and_cross_align(direction, egui::Align::Min);
        ui.allocate_ui_with_layout(room, layout, |ui| {
            ui.set_min_width(room.x);
            ui.label(number);
            ui.vertical(|ui| {
                ui.add_space(if is_beside { 4.0 } else { 0.0 });
                ui.label("bits per pixel");
                ui.weak(name);
            });
        });
        more(ui, view, requests);
    });
    let from = summary
        .sensor_bracket()
        .and_then(|(_, sensor)| Some((sensor.bracket.lower_from?.to_string(), sensor.bracket.upper_from.to_string())));
    let from = from.map_or(String::new(), |(below, above)| format!("; by {}", both(&below, &above)));
    ui.weak(patch).on_hover_text(format!("Mutual information between objects and noisy measurements{from}"));
    ui.add_space(4.0);
}

/// Bound of a run with its sign: lower or upper bound.
fn bound_of_run(run: &RunBounds) -> Option<(char, &NamedBound)> {
    let lower = run.lower.as_ref().map(|lower| ('\u{2265}', lower));
    lower.or_else(|| Some(('\u{2264}', run.upper.as_ref()?)))
}

/// Sources of lower and upper bound.
fn both(below: &str, above: &str) -> String {
    if below == above { below.to_owned() } else { format!("{below}, {above}") }
}

/// Warns about estimates above the entropy bound.
fn warning(ui: &mut Ui, summary: &BoundSummary<'_>) {
    let Some(ceiling) = summary.bounds.ceiling_bits() else { return };
    let fitted = summary.fitted.as_ref().map(|fitted| fitted.bits_per_pixel);
    let models = summary.current_live().map(|live| live.bits_per_pixel).into_iter().chain(fitted);
    let density = models.into_iter().any(|bits| bits > ceiling);
    let warning = match (density, summary.gaussian() > ceiling) {
        (true, true) => "Density model and Gaussian exceed the entropy bound. They cannot rank masks.",
        (true, false) => "The density model exceeds the entropy bound. It cannot rank masks.",
        (false, true) => "The Gaussian exceeds the entropy bound. It cannot rank masks.",
        (false, false) => return,
    };
    ui.colored_label(ui.visuals().warn_fg_color, warning);
}

/// All bounds on one axis from 0; the range between lower and upper bound is filled.
fn bound_bar(ui: &mut Ui, summary: &BoundSummary<'_>) {
    let upper = summary.upper_bound().map(|(bits, _)| bits);
    let lower = summary.lower().map(|lower| lower.bits_per_pixel);
    let mut marks = vec![(summary.bounds.gaussian_name(), summary.gaussian(), GAUSSIAN)];
    marks.extend(summary.bounds.ceiling_bits().map(|ceiling| ("entropy bound", ceiling, ENTROPY_BOUND)));
    let density = summary.current_live().map(|live| live.bits_per_pixel);
    let density = density.or_else(|| Some(summary.run.as_ref()?.upper.as_ref()?.bits_per_pixel));
    marks.extend(density.map(|bits| ("density model", bits, DENSITY)));
    let fitted_name = summary.fitted.as_ref().map(|fitted| fitted.from.to_string()).unwrap_or_default();
    marks.extend(summary.fitted.as_ref().map(|fitted| (fitted_name.as_str(), fitted.bits_per_pixel, FITTED)));
    marks.extend(lower.map(|lower| ("lower bound", lower, LOWER)));
    let sampled = summary.current_live().and_then(|live| live.upper.as_ref());
    marks.extend(sampled.map(|upper| ("AIS upper bound", upper.bits_per_pixel, SAMPLED)));
    let end = nice_end(marks.iter().map(|(_, bits, _)| *bits).fold(0.0, f64::max));
    let (response, painter) = ui.allocate_painter(vec2(ui.available_width(), 34.0), Sense::hover());
    let text = marks.iter().map(|(name, bits, _)| format!("{name} {bits:.3}")).collect::<Vec<_>>().join(", ");
    let age = if summary.current { "" } else { ", of an earlier edit" };
    let text = format!("{text} bits per pixel{age}");
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Meter, true, &text));
    let rect = response.rect;
    let at = |bits: f64| rect.left() + (bits.max(0.0) / end) as f32 * rect.width();
    let top = rect.top() + 4.0;
    let bar = |from: f64, to: f64| egui::Rect::from_min_max(pos2(at(from), top), pos2(at(to), top + 12.0));
    let weak = ui.visuals().weak_text_color();
    painter.rect_filled(bar(0.0, end), 2.0, ui.visuals().extreme_bg_color);
    if let Some(upper) = upper {
        painter.rect_filled(bar(lower.unwrap_or(0.0), upper), 2.0, ui.visuals().selection.bg_fill);
    }
    for (_, bits, colour) in &marks {
        painter.vline(at(*bits), top - 3.0..=top + 15.0, Stroke::new(2.0, *colour));
    }
    let font = egui::FontId::proportional(10.0);
    painter.text(pos2(rect.left(), top + 17.0), egui::Align2::LEFT_TOP, "0", font.clone(), weak);
    painter.text(pos2(rect.right(), top + 17.0), egui::Align2::RIGHT_TOP, format_significant(end), font, weak);
    response.on_hover_text(text);
}

/// Smallest round number that is at least `value`.
fn nice_end(value: f64) -> f64 {
    let value = value.max(1e-3);
    let decade = 10_f64.powf(value.log10().floor());
    [1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0]
        .into_iter()
        .map(|step| step * decade)
        .find(|&end| end >= value)
        .unwrap_or(value)
}

fn details(ui: &mut Ui, view: &View<'_>, summary: &BoundSummary<'_>) {
    let bound = &summary.bounds.gaussian;
    // A long value wraps at the border of the panel.
    let end = ui.max_rect().right();
    egui::Grid::new("information details").num_columns(2).spacing([14.0, 3.0]).show(ui, |ui| {
        let mut line = |name: &str, value: String, colour: Option<Color32>, hint: &str| {
            ui.horizontal(|ui| {
                if let Some(colour) = colour {
                    let (rect, _) = ui.allocate_exact_size(vec2(8.0, 8.0), Sense::hover());
                    ui.painter().rect_filled(rect, 2.0, colour);
                }
                ui.label(name).on_hover_text(hint);
            });
            let room = (end - ui.cursor().left()).max(LEAST_VALUE);
            let wrap = Some(egui::TextWrapMode::Wrap);
            let value = egui::WidgetText::from(value).into_galley(ui, wrap, room, egui::TextStyle::Body);
            ui.label(value).on_hover_text(hint);
            ui.end_row();
        };
        if let Some(edit) = summary.current_live().and_then(|live| live.edit) {
            let PairedDifference { bits_per_pixel, interval_95: [low, high] } = edit;
            let hint = "Change of the decoder's information by the last edit, from the same objects imaged with both masks, with 95 % interval";
            let interval = if low < high { format!(" [{low:+.4}, {high:+.4}]") } else { String::new() };
            line("Last edit", format!("{bits_per_pixel:+.4}{interval}"), None, hint);
        }
        if let Some(NamedBound { bits_per_pixel, interval_95, from }) = summary.lower() {
            let hint = "Information that a decoder, or annealed importance sampling (AIS), extracts from new measurements, with 95 % interval";
            let value = format!("{} {}", with_interval(bits_per_pixel, interval_95), from);
            line("Lower bound", value, Some(LOWER), hint);
        }
        if let Some(upper) = summary.current_live().and_then(|live| live.upper.as_ref()) {
            let hint = "Upper bound by annealed importance sampling (AIS) from the decoder's posterior; it tightens with computing time";
            let value = with_interval(upper.bits_per_pixel, upper.interval_95);
            line("AIS upper bound", value, Some(SAMPLED), hint);
        }
        if let Some(NamedBound { bits_per_pixel, interval_95, from }) = &summary.fitted {
            let hint = "Smallest finished estimate of this design by one density model, with 95 % interval";
            let value = format!("{} {from}", with_interval(*bits_per_pixel, *interval_95));
            line("Upper bound", value, Some(FITTED), hint);
        }
        if let Some(Bracket { lower: None, upper, upper_interval_95, upper_from, .. }) =
            summary.sensor.as_ref().map(|sensor| &sensor.bracket)
        {
            let hint = "Smallest finished estimate of whole measurements of this design, with 95 % interval";
            let value = format!("{} {}", with_interval(*upper, *upper_interval_95), upper_from);
            line("Whole sensor", value, Some(FITTED), hint);
        }
        let (value, entropies) = live_line(view, summary);
        line(
            "Density model",
            value,
            Some(DENSITY),
            "Live estimate: cross-entropy of a causal density model on held-out patches minus the noise entropy, with 95 % interval",
        );
        line(
            summary.bounds.gaussian_name(),
            with_interval(bound.bits_per_pixel, summary.bounds.interval_95),
            Some(GAUSSIAN),
            "Entropy of the Gaussian with the covariance of the measurements minus the noise entropy, with 95 % interval; it is loose for sparse objects",
        );
        match summary.bounds.ceiling_bits() {
            Some(ceiling) => line(
                "Entropy bound",
                rounded(ceiling),
                Some(ENTROPY_BOUND),
                "Object-entropy bound: the entropy of the objects, counted as far as this PSF resolves single beads",
            ),
            None => line("Entropy bound", "unknown".into(), None, "The entropy of these objects is unknown."),
        }
        line(
            "Infinite patch",
            rounded(summary.bounds.infinite_patch_bits()),
            None,
            "The same Gaussian for an infinitely large sensor (spectral integral)",
        );
        let Entropies { model, of_measurements, of_noise } = entropies;
        line(
            "H(Y)  -  H(Y|X)",
            format!("{of_measurements:.3}  -  {of_noise:.3}"),
            None,
            &format!("Entropy of the measurements under the {model} and entropy of the noise, bits per pixel"),
        );
    });
}

/// Entropies under a model, bits per pixel.
struct Entropies {
    model: &'static str,
    of_measurements: f64,
    of_noise: f64,
}

/// Live estimate with its state, and the entropies of the best available model.
fn live_line(view: &View<'_>, summary: &BoundSummary<'_>) -> (String, Entropies) {
    let bound = &summary.bounds.gaussian;
    let gaussian =
        Entropies { model: "Gaussian model", of_measurements: bound.entropy_y, of_noise: bound.entropy_y_given_x };
    let failure = view.estimates.live_failure.as_ref().filter(|(revision, _)| view.is_current(*revision));
    if let Some((_, failure)) = failure {
        return (failure.clone(), gaussian);
    }
    if let (None, Some(RunBounds { upper: Some(upper), .. })) = (&summary.live, &summary.run) {
        let text = format!("{} {}", with_interval(upper.bits_per_pixel, upper.interval_95), upper.from);
        return (text, gaussian);
    }
    let off = !view.is_live;
    let paused = view.is_live_paused();
    match &summary.live {
        None if off => ("off".into(), gaussian),
        None if paused => ("paused".into(), gaussian),
        None => ("computing".into(), gaussian),
        Some((live, current)) => {
            let stage = match (current, live.remaining) {
                (false, _) => "of an earlier edit".to_owned(),
                (true, None) if live.bounding && !off && !paused => "converged; AIS runs".into(),
                (true, None) => "converged".into(),
                (true, Some(_)) if off => "off".into(),
                (true, Some(_)) if paused => "paused".into(),
                (true, Some(left)) => format!("refining, {:.0} s", left.as_secs_f64().ceil()),
            };
            let text = format!("{} {stage}", with_interval(live.bits_per_pixel, live.interval_95));
            let of_live =
                Entropies { model: "density model", of_measurements: live.entropy_y, of_noise: live.entropy_y_given_x };
            (text, if *current { of_live } else { gaussian })
        }
    }
}
