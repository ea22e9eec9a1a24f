//! Ctrl-C and SIGTERM.
//!
//! While there is something to save ([`graceful`]), the first signal cancels the job: the work stops soon and writes what it
//! has. Before that, and at the second signal, the program ends at once. Either way the exit code is 130.

use occlude_render::job::Job;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a first signal asks the work to stop rather than ending the program.
static GRACEFUL: AtomicBool = AtomicBool::new(false);

/// Installs the handler.
pub fn install(job: &Job) {
    let job = job.clone();
    let installed = ctrlc::set_handler(move || {
        let first = !job.is_cancelled();
        job.cancel();
        if !(first && GRACEFUL.load(Ordering::SeqCst)) {
            std::process::exit(130);
        }
    });
    if let Err(error) = installed {
        crate::error::warn(format_args!(
            "Ctrl-C cannot be caught, it will end the program at once: {error}"
        ));
    }
}

/// From now on the work watches the cancel flag and saves what it has.
pub fn graceful() {
    GRACEFUL.store(true, Ordering::SeqCst);
}
