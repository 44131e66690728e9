//! Signals that ask a run to stop, and those that should not end it.

use isospan::exec::CancelToken;

/// A token that SIGTERM, SIGINT, SIGUSR1 and SIGXCPU (what batch systems send before they kill)
/// cancel: the run drops the chunks in flight and ends with code 75. A second SIGINT ends the
/// process at once.
#[cfg(unix)]
pub(crate) fn cancel_token() -> CancelToken {
    use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1, SIGXCPU};
    use signal_hook::{iterator::Signals, low_level};
    let token = CancelToken::new();
    let cancel = token.clone();
    // Where the system refuses handlers or a thread, signals do what they do without them.
    if let Ok(mut signals) = Signals::new([SIGTERM, SIGINT, SIGUSR1, SIGXCPU]) {
        let watch = move || {
            for signal in signals.forever() {
                if signal == SIGINT && cancel.is_cancelled() {
                    let _ = low_level::emulate_default_handler(SIGINT);
                }
                cancel.cancel();
            }
        };
        let _ = std::thread::Builder::new().name("signals".into()).spawn(watch);
    }
    token
}

#[cfg(not(unix))]
pub(crate) fn cancel_token() -> CancelToken {
    CancelToken::new()
}

/// A write beyond the limit on the size of files (`ulimit -f`) becomes an error of that write, not
/// the end of the process.
pub(crate) fn survive_file_size_limit() {
    #[cfg(unix)]
    {
        let crossed = std::sync::Arc::<std::sync::atomic::AtomicBool>::default();
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, crossed);
    }
}
