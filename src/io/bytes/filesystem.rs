//! Finds which file systems are shared over a network, and how much memory the machine has. The I/O
//! mode and the dropping of pages depend on both. And how many files may be open at one time.

use std::fs::File;

/// Whether the file lies on a network file system, by the magic number that the system gives for
/// it. Others than Linux are not asked: there the answer is no.
pub(super) fn is_remote(file: &File) -> bool {
    #[cfg(target_os = "linux")]
    return rustix::fs::fstatfs(file).is_ok_and(|about| is_remote_magic(about.f_type as u64 & 0xffff_ffff));
    #[cfg(not(target_os = "linux"))]
    {
        let _ = file;
        false
    }
}

/// Numbers of `statfs(2)`, of the kernel's `magic.h` and of the file systems' own headers.
#[cfg(any(target_os = "linux", test))]
fn is_remote_magic(magic: u64) -> bool {
    const REMOTE: [u64; 18] = [
        0x6969,      // NFS
        0x517b,      // SMB
        0xff53_4d42, // CIFS
        0xfe53_4d42, // SMB 2
        0x0bd0_0bd0, // Lustre
        0x4750_4653, // GPFS
        0x6573_5546, // FUSE: sshfs, s3fs, GlusterFS, virtiofs …
        0x5346_414f, // AFS
        0x6b41_4653, // AFS of the kernel
        0x00c3_6400, // Ceph
        0x1983_0326, // BeeGFS
        0x2003_0528, // OrangeFS
        0xaad7_aaea, // PanFS
        0x0102_1997, // 9P
        0x7375_7245, // Coda
        0x564c,      // NCP
        0x786f_4256, // VirtualBox shared folders
        0x0116_1970, // GFS2
    ];
    REMOTE.contains(&magic)
}

/// Bytes of memory that the machine has.
pub(super) fn machine_memory() -> u64 {
    #[cfg(target_os = "linux")]
    {
        let about = rustix::system::sysinfo();
        // Both are of the machine's word size, which differs.
        #[allow(clippy::useless_conversion)]
        return u64::from(about.totalram).saturating_mul(u64::from(about.mem_unit));
    }
    #[cfg(not(target_os = "linux"))]
    u64::MAX
}

/// Files that are open besides those that a reader opens together.
#[cfg(unix)]
const OTHER_FILES: u64 = 64;

/// Raises the process's own limit of open files, where so many are opened together. The error is
/// the most that can be.
#[cfg(unix)]
pub(crate) fn allow_open_files(count: u64) -> Result<(), u64> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let (limit, needed) = (getrlimit(Resource::Nofile), count.saturating_add(OTHER_FILES));
    let fits = |limit: Option<u64>| limit.is_none_or(|most| most >= needed);
    let raised = Rlimit { current: Some(needed), maximum: limit.maximum };
    if fits(limit.current) || fits(limit.maximum) && setrlimit(Resource::Nofile, raised).is_ok() {
        return Ok(());
    }
    let most = limit.maximum.or(limit.current).unwrap_or(needed).min(needed);
    Err(most.saturating_sub(OTHER_FILES))
}

/// Other systems have no limit that a program meets so soon.
#[cfg(not(unix))]
pub(crate) fn allow_open_files(_: u64) -> Result<(), u64> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_limit_of_open_files_is_raised_as_far_as_it_may_be() {
        use rustix::process::{Resource, getrlimit};
        let before = getrlimit(Resource::Nofile);
        assert_eq!(allow_open_files(1), Ok(()));
        assert_eq!(getrlimit(Resource::Nofile).current, before.current, "not without need");
        let Some(most) = before.maximum else { return };
        assert_eq!(allow_open_files(most - OTHER_FILES), Ok(()));
        assert_eq!(getrlimit(Resource::Nofile).current, Some(most));
        assert_eq!(allow_open_files(most), Err(most - OTHER_FILES));
    }

    #[test]
    fn network_file_systems_are_known_by_number() {
        assert!(is_remote_magic(0x6969) && is_remote_magic(0xff53_4d42) && is_remote_magic(0x6573_5546));
        // ext4, XFS, Btrfs, tmpfs, overlay, ZFS.
        for local in [0xef53, 0x5846_5342, 0x9123_683e, 0x0102_1994, 0x794c_7630, 0x2fc1_2fc1] {
            assert!(!is_remote_magic(local), "{local:x}");
        }
        assert!(machine_memory() > 16 << 20);
    }
}
