//! Explains why this process may not open a device, and what to do.

use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;

use rustix::process::{getegid, geteuid, getgroups};

/// Read and write permission of the group.
const GROUP_ACCESS: u32 = 0o060;

/// Why the system refuses to open the device with this owner, group and mode: who asks, who may, and the remedy.
pub(super) fn explain(device: &Metadata) -> String {
    let names = Names::read();
    let user = names.user(geteuid().as_raw());
    let groups = own_groups();
    let own: Vec<_> = groups.iter().map(|gid| names.group(*gid)).collect();
    let (owner, group) = (names.user(device.uid()), names.group(device.gid()));
    let remedy = if device.mode() & GROUP_ACCESS != GROUP_ACCESS || device.gid() == 0 {
        "a udev rule must give the device a group and the mode 0660".to_owned()
    } else if groups.contains(&device.gid()) {
        "its group may open it, but the service (DeviceAllow=) or a security module forbids it".to_owned()
    } else if names.is_member(&user, &group) {
        format!(
            "{user} was added to the group {group} after this process started: log in again, or restart the service"
        )
    } else {
        format!(
            "add the user to the group: usermod -aG {group} {user}, then log in again or restart the service"
        )
    };
    format!(
        "permission denied: this process runs as user {user} (groups {}), the device belongs to user {owner} and \
         group {group} with mode {:04o}; {remedy} (docs/operation.md, Serial ports)",
        own.join(", "),
        device.mode() & 0o7777
    )
}

/// The groups of this process.
fn own_groups() -> Vec<u32> {
    let mut groups = vec![getegid().as_raw()];
    groups.extend(getgroups().unwrap_or_default().iter().map(|gid| gid.as_raw()));
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// The names of users and groups on this machine. Those of a directory service are not known.
struct Names {
    users: String,
    groups: String,
}

impl Names {
    fn read() -> Self {
        let text = |file| fs::read_to_string(file).unwrap_or_default();
        Self { users: text("/etc/passwd"), groups: text("/etc/group") }
    }

    fn user(&self, uid: u32) -> String {
        named(&self.users, uid)
    }

    fn group(&self, gid: u32) -> String {
        named(&self.groups, gid)
    }

    /// Whether the list of groups names the user as a member.
    fn is_member(&self, user: &str, group: &str) -> bool {
        let line = self.groups.lines().find(|line| line.split(':').next() == Some(group));
        let members = line.and_then(|line| line.split(':').nth(3)).unwrap_or_default();
        members.split(',').any(|member| member == user)
    }
}

/// The name with this number in a table of users or groups; otherwise the number.
fn named(table: &str, id: u32) -> String {
    let name = |line: &str| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(id)).then(|| name.to_owned())
    };
    table.lines().find_map(name).unwrap_or_else(|| id.to_string())
}
