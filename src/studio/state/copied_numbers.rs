//! The numbers of the open design as JSON.

use serde_json::json;

use crate::information::NUMBERS_VERSION;
use crate::studio::state::bound_summary::{BoundSummary, PatchBracket};
use crate::studio::state::view::View;

/// All numbers of the shown design as JSON; none before they are computed.
pub fn numbers_json(view: &View<'_>) -> Option<String> {
    let information = view.live.information.as_ref()?;
    let mut summary = BoundSummary::of(view, &information.value, information.revision);
    summary.run.take_if(|run| !run.is_of_mask);
    summary.run_of_sensor.take_if(|run| !run.is_of_mask);
    let live = summary.live.as_ref().filter(|(_, current)| *current).map(|(live, _)| {
        json!({
            "bits_per_pixel": live.bits_per_pixel, "interval_95": live.interval_95, "steps": live.recipe.steps,
            "converged": live.remaining.is_none(), "test_patches": live.recipe.test_patches, "warm": live.start.is_some(),
        })
    });
    let (upper, upper_from) = summary.upper_bound().unzip();
    let design = view.design;
    let scene = view.live.scene.as_ref().filter(|scene| scene.value.serves(design));
    let numbers = json!({
        "format": "lenslet-studio/numbers",
        "format_version": 2,
        "program_version": NUMBERS_VERSION,
        "encoder": design.encoder.describe(),
        "design": &**design,
        "current": summary.current,
        "patch": summary.bounds.patch,
        "upper": upper,
        "upper_from": upper_from,
        "lower": summary.lower(),
        "ais_upper_bound": summary.current_live().and_then(|live| live.upper.clone()),
        "gaussian_bound": summary.gaussian(),
        "gaussian_is_bound": summary.bounds.gaussian_is_bound,
        "gaussian_interval_95": summary.bounds.interval_95,
        "entropy_y_given_x": summary.bounds.gaussian.entropy_y_given_x,
        "entropy_bound": summary.bounds.ceiling_bits(),
        "live_estimate": live,
        "last_edit": summary.current_live().and_then(|live| live.edit),
        "bracket": summary.bracket,
        "fitted": summary.fitted,
        "sensor_bracket": summary.sensor.as_ref().map(|PatchBracket { bracket, patch }| json!({ "patch": patch, "bracket": bracket })),
        "sensor_of_run": summary.run_of_sensor.as_ref().map(|run| json!({ "lower": run.lower, "upper": run.upper })),
        "sensor_tamura": view.current_measurements().map(|measurements| measurements.value.tamura.mean),
        "object_tamura": scene.map(|scene| scene.value.tamura.mean),
    });
    Some(format!("{numbers:#}\n"))
}
