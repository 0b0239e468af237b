//! Settings of a run that are set and told by the names that records have for them.

use super::settings::IdealSettings;

impl IdealSettings {
    /// Settings that [`IdealSettings::set`] changes, by their names in records.
    pub const SCHEDULE: [&'static str; 14] = [
        "objects",
        "patches",
        "moves",
        "refit_every",
        "first_fit",
        "refit",
        "last_fit",
        "warm",
        "settle",
        "rates.position",
        "rates.variance",
        "rates.weight",
        "rates.relative_weight",
        "tried",
    ];

    /// The same settings with one of [`IdealSettings::SCHEDULE`] as it stands in `text`: a number, or true or false. Whether a
    /// run can follow it is for [`IdealSettings::check`] to say.
    ///
    /// # Errors
    /// One sentence where there is no such setting, or it cannot be that.
    pub fn set(&self, name: &str, text: &str) -> Result<Self, String> {
        if !Self::SCHEDULE.contains(&name) {
            return Err(format!("setting {name:?}: expected one of {}", Self::SCHEDULE.join(", ")));
        }
        let wrong = || {
            let expected = match name {
                "warm" => "true or false",
                "settle" => "a number",
                _ if name.starts_with("rates.") => "a number",
                _ => "a whole number",
            };
            format!("{name} is {text}; expected {expected}")
        };
        let mut value = serde_json::to_value(self).map_err(|error| error.to_string())?;
        let place = value.pointer_mut(&pointer_to(name)).ok_or_else(wrong)?;
        *place = serde_json::from_str(text).map_err(|_| wrong())?;
        serde_json::from_value(value).map_err(|_| wrong())
    }

    /// Those of [`IdealSettings::SCHEDULE`] that differ from `other`, with their values, as [`IdealSettings::set`] reads them.
    pub fn set_apart_from(&self, other: &Self) -> Vec<(&'static str, String)> {
        let values = |settings: &Self| serde_json::to_value(settings).unwrap_or_default();
        let (values, others) = (values(self), values(other));
        let differs = |name: &&str| values.pointer(&pointer_to(name)) != others.pointer(&pointer_to(name));
        let told = |name: &'static str| Some((name, values.pointer(&pointer_to(name))?.to_string()));
        Self::SCHEDULE.into_iter().filter(differs).filter_map(told).collect()
    }
}

/// Where a setting stands in a record.
fn pointer_to(name: &str) -> String {
    format!("/{}", name.replace('.', "/"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::{Objective, Preset};

    #[test]
    fn every_setting_of_the_schedule_can_be_set_and_told() {
        let preset = IdealSettings::new(Preset::Default, Objective::Density, 1);
        let mut settings = preset.clone();
        for (index, name) in IdealSettings::SCHEDULE.into_iter().enumerate() {
            let text = match name {
                "warm" => "false".to_owned(),
                "settle" => "0.125".to_owned(),
                _ if name.starts_with("rates.") => format!("0.01{index}"),
                _ => (10 + index).to_string(),
            };
            settings = settings.set(name, &text).unwrap();
        }
        assert_eq!((settings.objects, settings.refit_every, settings.warm, settings.settle), (10, 13, false, 0.125));
        assert_eq!(settings.rates.relative_weight, 0.0112);
        let told = settings.set_apart_from(&preset);
        assert_eq!(told.len(), IdealSettings::SCHEDULE.len());
        let again = told.iter().fold(preset.clone(), |settings, (name, text)| settings.set(name, text).unwrap());
        assert_eq!(again, settings);
        assert!(preset.set_apart_from(&preset).is_empty());
        for (name, text, part) in [
            ("steps", "3", "expected one of objects, patches"),
            ("refit", "2.5", "refit is 2.5; expected a whole number"),
            ("refit", "-1", "whole number"),
            ("warm", "1", "true or false"),
            ("rates.weight", "NaN", "rates.weight is NaN; expected a number"),
        ] {
            let told = preset.set(name, text).unwrap_err();
            assert!(told.contains(part), "{told}");
        }
    }
}
