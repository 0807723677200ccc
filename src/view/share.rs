//! Drawing alongside training: on one thread, and for so little of the time that the training keeps its pace.

use std::time::Duration;

/// Fraction of the time of all cores that drawing may take.
const PART: f64 = 0.06;

/// The share of one viewer.
#[derive(Debug)]
pub struct ThreadShare {
    /// Its one thread; pictures are the same on any number of threads.
    pool: rayon::ThreadPool,
    /// Fraction of that thread's time.
    part: f64,
}

impl ThreadShare {
    /// Makes the share of a machine with as many cores as the program computes on.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn new() -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "drawing".into()).build()?;
        Ok(Self { pool, part: part(rayon::current_num_threads()) })
    }

    /// Runs `work` on the one thread.
    pub fn work<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    /// Returns how long nothing is to be drawn, counted from the beginning of work that took `busy`.
    pub fn rest(&self, busy: Duration) -> Duration {
        busy.div_f64(self.part)
    }
}

/// Fraction of one thread's time on a machine with this many cores.
fn part(cores: usize) -> f64 {
    (PART * cores as f64).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_cores_leave_a_whole_thread_and_few_a_part_of_one() {
        assert_eq!((part(2), part(64)), (0.12, 1.0));
    }

    #[test]
    fn work_is_done_on_one_thread_which_then_rests() {
        let share = ThreadShare::new().unwrap();
        assert_eq!(share.work(rayon::current_num_threads), 1);
        let busy = Duration::from_millis(60);
        assert!((share.rest(busy).as_secs_f64() - 0.06 / part(rayon::current_num_threads())).abs() < 1e-6);
    }
}
