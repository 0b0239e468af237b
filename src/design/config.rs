//! Settings files of the optimizer: a JSON object with some of the settings; a preset gives the others.

use serde_json::{Map, Value};

use super::settings::{IdealSettings, Objective, Preset};

/// Earlier names of settings, which files may still hold.
const EARLIER_NAMES: [(&str, &str); 4] = [
    ("moves", "substeps"),
    ("tried", "relocation_candidates"),
    ("settle", "decay_fraction"),
    ("lenslets", "cardinality"),
];

/// Some settings of a run by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SettingsFile(Map<String, Value>);

impl SettingsFile {
    /// Reads a JSON object.
    ///
    /// # Errors
    /// One sentence for text that is no JSON object.
    pub fn parse(text: &str) -> Result<Self, String> {
        match serde_json::from_str(text) {
            Ok(Value::Object(fields)) => {
                Ok(Self(fields.into_iter().map(|(name, value)| (canonical(name), value)).collect()))
            }
            Ok(_) => Err("expected a JSON object of settings, such as {\"steps\": 400}".into()),
            Err(error) => Err(format!("expected a JSON object of settings; {error}")),
        }
    }

    /// The preset that the file names.
    ///
    /// # Errors
    /// One sentence for a value that is no preset.
    pub fn preset(&self) -> Result<Option<Preset>, String> {
        self.named("preset")
    }

    /// The objective that the file names.
    ///
    /// # Errors
    /// One sentence for a value that is no objective.
    pub fn objective(&self) -> Result<Option<Objective>, String> {
        self.named("objective")
    }

    /// This file with the settings of a `later` one in place.
    #[must_use]
    pub fn then(mut self, later: Self) -> Self {
        for (name, value) in later.0 {
            match (self.0.get_mut(&name), value) {
                (Some(Value::Object(fields)), Value::Object(more)) => fields.extend(more),
                (_, value) => {
                    self.0.insert(name, value);
                }
            }
        }
        self
    }

    fn named<T: serde::de::DeserializeOwned>(&self, name: &str) -> Result<Option<T>, String> {
        let value = self.0.get(name).cloned();
        value.map(serde_json::from_value).transpose().map_err(|error| format!("setting {name:?}: {error}"))
    }

    /// `settings` with the values of this file in place. Whether a run is possible is for [`IdealSettings::check`] to say.
    ///
    /// # Errors
    /// One sentence that names an unknown setting, or one with a value of a wrong kind.
    pub fn applied_to(&self, settings: &IdealSettings) -> Result<IdealSettings, String> {
        let mut value = serde_json::to_value(settings).map_err(|error| error.to_string())?;
        let fields = value.as_object_mut().ok_or("settings are no JSON object")?;
        for (name, value) in &self.0 {
            put(fields, name, value, "")?;
            // One by one, so that the sentence names the wrong one.
            serde_json::from_value::<IdealSettings>(Value::Object(fields.clone()))
                .map_err(|error| format!("setting {name:?} is {value}: {error}"))?;
        }
        serde_json::from_value(value).map_err(|error| error.to_string())
    }
}

/// Puts a value in the place of the field of this name; an object replaces the fields that it names.
fn put(fields: &mut Map<String, Value>, name: &str, value: &Value, path: &str) -> Result<(), String> {
    let known = || fields.keys().cloned().collect::<Vec<_>>().join(", ");
    let Some(place) = fields.get(name) else {
        return Err(format!("unknown setting {:?}: expected one of {}", format!("{path}{name}"), known()));
    };
    if let (true, Value::Object(parts)) = (place.is_object(), value) {
        let Some(inner) = fields.get_mut(name).and_then(Value::as_object_mut) else { return Ok(()) };
        return parts.iter().try_for_each(|(part, value)| put(inner, part, value, &format!("{name}.")));
    }
    fields.insert(name.to_owned(), value.clone());
    Ok(())
}

fn canonical(name: String) -> String {
    EARLIER_NAMES.iter().find(|(earlier, _)| *earlier == name).map_or(name, |&(_, now)| now.to_owned())
}

impl IdealSettings {
    /// The settings that differ from `other`, as a [`SettingsFile`] holds them.
    pub fn overrides(&self, other: &Self) -> Map<String, Value> {
        let fields = |settings: &Self| match serde_json::to_value(settings) {
            Ok(Value::Object(fields)) => fields,
            _ => Map::new(),
        };
        differences(&fields(self), &fields(other))
    }
}

fn differences(one: &Map<String, Value>, other: &Map<String, Value>) -> Map<String, Value> {
    let differing = one.iter().filter(|(name, value)| other.get(*name) != Some(value));
    let parts = differing.map(|(name, value)| match (value, other.get(name)) {
        (Value::Object(value), Some(Value::Object(other))) => (name.clone(), Value::Object(differences(value, other))),
        _ => (name.clone(), value.clone()),
    });
    parts.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn preset() -> IdealSettings {
        IdealSettings::new(Preset::Default, Objective::Density, 1)
    }

    #[test]
    fn partial_files_are_completed_by_the_preset() {
        let file = SettingsFile::parse(r#"{"refit": 7, "rates": {"position": 0.25}, "patch": [16, 24]}"#).unwrap();
        let settings = file.applied_to(&preset()).unwrap();
        assert_eq!((settings.refit, settings.rates.position, settings.patch), (7, 0.25, Some((16, 24))));
        let mut expected = preset();
        (expected.refit, expected.rates.position, expected.patch) = (7, 0.25, Some((16, 24)));
        assert_eq!(settings, expected);
        let overrides = settings.overrides(&preset());
        assert_eq!(SettingsFile(overrides).applied_to(&preset()).unwrap(), settings);
        assert!(preset().overrides(&preset()).is_empty());
    }

    #[test]
    fn earlier_names_are_read() {
        let text = r#"{"moves": 3, "tried": 5, "settle": 0.5, "lenslets": 4}"#;
        let settings = SettingsFile::parse(text).unwrap().applied_to(&preset()).unwrap();
        assert_eq!((settings.substeps, settings.relocation_candidates), (3, 5));
        assert_eq!((settings.decay_fraction, settings.cardinality), (0.5, Some(4)));
        // Records of earlier versions hold all settings under these names.
        let mut record = serde_json::to_value(&settings).unwrap();
        let fields = record.as_object_mut().unwrap();
        for (earlier, now) in EARLIER_NAMES {
            let value = fields.remove(now).unwrap();
            fields.insert(earlier.to_owned(), value);
        }
        assert_eq!(serde_json::from_value::<IdealSettings>(record).unwrap(), settings);
    }

    #[test]
    fn unknown_and_wrong_settings_are_named() {
        for (text, part) in [
            (r#"{"speed": 3}"#, "unknown setting \"speed\": expected one of"),
            (r#"{"rates": {"speed": 3}}"#, "unknown setting \"rates.speed\""),
            (r#"{"refit": -1}"#, "setting \"refit\" is -1"),
            (r#"{"warm": 1}"#, "setting \"warm\" is 1"),
            (r#"{"preset": "best"}"#, "setting \"preset\""),
        ] {
            let refusal = SettingsFile::parse(text).unwrap().applied_to(&preset()).unwrap_err();
            assert!(refusal.contains(part), "{refusal}");
        }
        assert!(SettingsFile::parse("[]").unwrap_err().contains("a JSON object"));
        assert!(SettingsFile::parse("{").unwrap_err().contains("a JSON object"));
    }
}
