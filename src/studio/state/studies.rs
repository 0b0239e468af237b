//! State of the Studies panel: the form of a new study, and the shown panel of its plot.

use std::collections::BTreeMap;

use crate::objects::ObjectSource;
use crate::studies::plans::{NamedPlan, Plan, named_plans};

/// State of the Studies panel.
pub struct StudiesState {
    /// The named plans.
    pub named: Vec<NamedPlan>,
    /// The chosen one.
    pub chosen: usize,
    /// A plan from a file, in place of a named one.
    pub from_file: Option<Plan>,
    /// Whether the study is a first look.
    pub quick: bool,
    /// Files of the image sets that the plan names, as typed.
    pub sets: BTreeMap<String, String>,
    /// The shown panel of the figure.
    pub panel: usize,
    /// Whether the cells are shown in place of the plot.
    pub cells: bool,
}

impl Default for StudiesState {
    fn default() -> Self {
        Self {
            named: named_plans(),
            chosen: 0,
            from_file: None,
            quick: true,
            sets: BTreeMap::new(),
            panel: 0,
            cells: false,
        }
    }
}

impl StudiesState {
    /// The chosen plan, without its image sets.
    pub fn base(&self) -> &Plan {
        self.from_file.as_ref().unwrap_or(&self.named[self.chosen.min(self.named.len() - 1)].plan)
    }

    /// Names of image sets that the chosen plan needs and does not hold.
    pub fn missing_sets(&self) -> Vec<String> {
        let plan = self.base();
        let is_missing = |name: &&String| !name.contains(':') && !plan.sets.contains_key(*name);
        plan.axes.objects.iter().filter(is_missing).cloned().collect()
    }

    /// The plan of a new study.
    ///
    /// # Errors
    /// One sentence where the plan cannot be computed.
    pub fn plan(&self) -> Result<Plan, String> {
        let mut plan = self.base().clone();
        for name in self.missing_sets() {
            let typed = self.sets.get(&name).map_or("", |text| text.trim());
            if !typed.is_empty() {
                plan.sets.insert(name, ObjectSource::guess(typed.as_ref()));
            }
        }
        let plan = if self.quick { plan.quick() } else { plan }.absolute();
        plan.cells().map_err(|error| error.to_string())?;
        Ok(plan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_asks_for_the_image_sets_that_it_names() {
        let mut state = StudiesState::default();
        assert!(state.missing_sets().is_empty() && state.plan().unwrap().cells().unwrap().len() == 60);
        state.chosen = state.named.iter().position(|named| named.plan.name == "s1").unwrap();
        assert_eq!(state.missing_sets(), ["cifar10", "mnist"]);
        assert!(state.plan().unwrap_err().contains("cifar10"));
        state.sets.insert("cifar10".into(), "data_batch_1.bin".into());
        state.sets.insert("mnist".into(), " train-images-idx3-ubyte.gz ".into());
        let plan = state.plan().unwrap();
        assert!(
            matches!(plan.sets["cifar10"], ObjectSource::Cifar(_))
                && matches!(plan.sets["mnist"], ObjectSource::Idx(_))
        );
    }
}
