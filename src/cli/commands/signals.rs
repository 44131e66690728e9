//! Signals that ask a run to stop, and those that should not end it.

use isospan::exec::CancelToken;

/// A token that SIGTERM, SIGINT, SIGHUP (of a terminal that closes), SIGUSR1 and SIGXCPU (what
/// batch systems send before they kill) cancel: the run drops the chunks in flight and ends with
/// code 75. A second SIGINT ends the process at once. A SIGHUP that is ignored, as under nohup,
/// stays so.
#[cfg(unix)]
pub(crate) fn cancel_token() -> CancelToken {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1, SIGXCPU};
    use signal_hook::{iterator::Signals, low_level};
    let token = CancelToken::new();
    let cancel = token.clone();
    // Where the system refuses handlers or a thread, signals do what they do without them.
    let hangup = (!ignores_hangup()).then_some(SIGHUP);
    if let Ok(mut signals) = Signals::new([SIGTERM, SIGINT, SIGUSR1, SIGXCPU].into_iter().chain(hangup)) {
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

/// Whether SIGHUP is ignored. Where the system does not say, it is taken to be: a handler would end
/// what nohup keeps.
#[cfg(unix)]
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_none_or(|mask| mask & 1 << (signal_hook::consts::SIGHUP - 1) != 0)
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
