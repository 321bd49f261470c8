//! Finds the process that uses a UDP port, as far as this user may see it.

use std::fs;

/// The processes that have a socket bound to this port.
pub(super) fn holder(port: u16) -> Option<String> {
    let tables = ["/proc/net/udp", "/proc/net/udp6"].map(fs::read_to_string);
    let sockets: Vec<String> = tables
        .iter()
        .flatten()
        .flat_map(|table| sockets(table, port))
        .map(|n| format!("socket:[{n}]"))
        .collect();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let holds = |pid: &u32| {
        let files = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        let mut links = files.filter_map(|file| fs::read_link(file.path()).ok());
        links.any(|link| sockets.iter().any(|socket| link.as_os_str() == socket.as_str()))
    };
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let found: Vec<_> = pids.filter(holds).map(describe).collect();
    (!found.is_empty()).then(|| found.join(", "))
}

/// The inodes of the sockets bound to this port, from a table of the kernel.
fn sockets(table: &str, port: u16) -> Vec<u64> {
    let inode = |line: &str| {
        let mut columns = line.split_ascii_whitespace();
        let (_, local) = columns.nth(1)?.rsplit_once(':')?;
        (u16::from_str_radix(local, 16) == Ok(port)).then(|| columns.nth(7)?.parse().ok())?
    };
    table.lines().filter_map(inode).collect()
}

fn describe(pid: u32) -> String {
    let name = fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    format!("process {pid} ({})", name.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_socket_of_this_process_is_found() {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let holder = holder(socket.local_addr().unwrap().port()).unwrap();
        assert!(holder.contains(&format!("process {} (", std::process::id())), "{holder}");
    }
}
