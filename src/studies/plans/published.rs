//! Names of the published image sets in plans.

use crate::studies::PublishedSet;

/// The published image set of this name in a plan.
pub(super) fn set_named(name: &str) -> Option<PublishedSet> {
    [PublishedSet::Mnist, PublishedSet::Fashion, PublishedSet::Cifar10].into_iter().find(|set| set.to_string() == name)
}
