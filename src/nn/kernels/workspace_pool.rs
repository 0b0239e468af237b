//! Workspaces that threads share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Workspaces of threads, reused between tasks. Results must not depend on which thread gets which. A borrower writes
/// all of a workspace before reading it, so a panic elsewhere leaves no invalid state in it.
#[derive(Debug)]
pub struct Pool<T>(Mutex<Vec<T>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Pool<T> {
    /// Lends `work` a workspace for which `serves` holds, or a new one from `make`.
    pub fn with<R>(&self, serves: impl Fn(&T) -> bool, make: impl FnOnce() -> T, work: impl FnOnce(&mut T) -> R) -> R {
        let kept = {
            let mut free = self.free();
            free.iter().position(serves).map(|index| free.swap_remove(index))
        };
        let mut lent = kept.unwrap_or_else(make);
        let result = work(&mut lent);
        self.free().push(lent);
        result
    }

    fn free(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matching_workspaces_are_reused() {
        let pool = Pool::default();
        let lend = |length: usize| {
            let mut made = false;
            pool.with(
                |kept: &Vec<u8>| kept.len() == length,
                || {
                    made = true;
                    vec![0; length]
                },
                |lent| assert_eq!(lent.len(), length),
            );
            made
        };
        assert_eq!([3, 3, 5, 3, 5].map(lend), [true, false, true, false, false]);
    }
}
