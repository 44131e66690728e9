//! How much memory the process may use: the least of what the cgroup, the address-space limit and
//! the system leave.

use crate::error::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// Bytes that this process may use: the least of the memory limits of its cgroups (versions 1
/// and 2), what is left of its address space, and the system's available memory. Where none of them
/// can be read, 1 GiB.
pub fn usable_memory() -> u64 {
    let left = address_space().map(|[limit, used]| limit.saturating_sub(used));
    let limits = [cgroup_limit(), left, available_memory()];
    limits.into_iter().flatten().min().unwrap_or(1 << 30)
}

fn available_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

/// The limit of the address space (ulimit -v), if there is one, and what is used of it: the program
/// itself takes some.
#[cfg(unix)]
fn address_space() -> Option<[u64; 2]> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::As).current?;
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let used = text.lines().find_map(|l| l.strip_prefix("VmSize:"));
    let used: Option<u64> = used.and_then(|kib| kib.trim().strip_suffix("kB")?.trim().parse().ok());
    Some([limit, used.unwrap_or(0).saturating_mul(1024)])
}

#[cfg(not(unix))]
fn address_space() -> Option<[u64; 2]> {
    None
}

/// Address space that a small question takes: some threads, and what they read.
const LEAST: u64 = 12 << 20;

/// Refuses a limit of the address space that leaves no room to work. A program that is refused
/// memory later has no better way than to abort.
///
/// # Errors
/// [`Error::Budget`].
pub fn expect_address_space() -> Result<()> {
    match address_space() {
        Some([limit, used]) if limit < used.saturating_add(LEAST) => {
            Err(Error::memory("ulimit -v", used.saturating_add(LEAST), limit))
        }
        _ => Ok(()),
    }
}

/// The least limit on the way from the process's cgroup to the root.
fn cgroup_limit() -> Option<u64> {
    let text = fs::read_to_string("/proc/self/cgroup").ok()?;
    text.lines().filter_map(limit_of_line).min()
}

/// A line is `id:controllers:path`; version 2 has no controllers.
fn limit_of_line(line: &str) -> Option<u64> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (controllers, path) = (parts.next()?, parts.next()?);
    let (root, file) = if controllers.is_empty() {
        ("/sys/fs/cgroup", "memory.max")
    } else if controllers.split(',').any(|c| c == "memory") {
        ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")
    } else {
        return None;
    };
    let mut folder = PathBuf::from(root).join(path.trim_start_matches('/'));
    let mut least = None;
    while folder.starts_with(root) {
        least = [least, limit_file(&folder.join(file))].into_iter().flatten().min();
        folder.pop();
    }
    least
}

/// "max", or a number near 2^63, means that there is no limit.
fn limit_file(path: &Path) -> Option<u64> {
    let bytes: u64 = fs::read_to_string(path).ok()?.trim().parse().ok()?;
    (bytes < 1 << 60).then_some(bytes)
}

#[cfg(test)]
mod tests {
    #[test]
    fn some_memory_is_usable() {
        assert!(super::usable_memory() > 16 << 20);
        assert!(super::expect_address_space().is_ok());
    }
}
