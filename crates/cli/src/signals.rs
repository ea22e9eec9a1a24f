//! Ctrl-C and SIGTERM.
//!
//! While there is something to save ([`graceful`]), the first signal sets the cancel flag and the work ends by itself: it
//! writes what it has. Before that, and at the second signal, the program ends at once. Either way the exit code is 130.

use crate::output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a first signal asks the work to stop rather than ending the program.
static GRACEFUL: AtomicBool = AtomicBool::new(false);

/// Installs the handler; the flag becomes true when the work should stop.
pub fn install() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    let installed = ctrlc::set_handler(move || {
        let first = !flag.swap(true, Ordering::SeqCst);
        if !(first && GRACEFUL.load(Ordering::SeqCst)) {
            output::remove_temporaries();
            std::process::exit(130);
        }
    });
    if let Err(error) = installed {
        crate::error::warn(format_args!(
            "Ctrl-C cannot be caught, it will end the program at once: {error}"
        ));
    }
    cancel
}

/// From now on the work watches the cancel flag and saves what it has.
pub fn graceful() {
    GRACEFUL.store(true, Ordering::SeqCst);
}
