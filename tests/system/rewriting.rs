//! What the program writes into a configuration file: everything else about the file stays.

use std::fs::{self, Metadata};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use rustix::fs::{XattrFlags, getxattr, setxattr};

use crate::testkit::{Daemon, Done, Folder, lacks, run, trifacet};

/// Users and groups that the tests may use as root.
const OTHERS: [u32; 2] = [65_533, 65_532];
const TEXT: &str = "# ours\n[log]\nlevel = \"info\"\n# the end";

/// A folder with a configuration.
struct Lab {
    home: Folder,
    file: PathBuf,
}

impl Lab {
    fn new() -> Self {
        let home = Folder::new();
        let file = home.write("lab.toml", TEXT);
        Self { home, file }
    }

    fn found(&self) -> Metadata {
        fs::metadata(&self.file).unwrap()
    }

    /// The names in the folder.
    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.file.parent().unwrap()).unwrap();
        let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Measures dark offsets through another program, and writes them.
    fn dark(&self, through: &[&str]) -> Done {
        let program =
            [through, &[env!("CARGO_BIN_EXE_trifacet"), "dark", "--samples", "10", "--config"]].concat();
        run(Command::new(program[0]).args(&program[1..]).arg(&self.file))
    }

    /// The same; it must succeed.
    fn written(&self, through: &[&str]) {
        let done = self.dark(through);
        assert_eq!(done.code, 0, "{}", done.err);
        let text = fs::read_to_string(&self.file).unwrap();
        assert!(text.starts_with(TEXT) && text.contains("# the end\n\n[channels.a]\ndark_v = ["), "{text}");
    }

    /// The same; it must be refused before the measurement, and leave nothing behind.
    fn refused(&self, through: &[&str], told: &str) {
        let names = self.names();
        let done = self.dark(through);
        assert_eq!(done.code, 74, "{}", done.err);
        assert!(done.err.contains(told) && !done.err.contains("averaging"), "{}", done.err);
        assert_eq!(fs::read_to_string(&self.file).unwrap(), TEXT);
        assert_eq!(self.names(), names);
    }
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

#[test]
fn permissions_and_attributes_stay() {
    let lab = Lab::new();
    fs::set_permissions(&lab.file, fs::Permissions::from_mode(0o640)).unwrap();
    // Not every file system has attributes of users.
    let attribute = setxattr(&lab.file, "user.lab", b"three", XattrFlags::empty()).is_ok();
    lab.written(&[]);
    assert_eq!((lab.found().mode() & 0o7777, lab.names()), (0o640, vec!["lab.toml".to_owned()]));
    if attribute {
        let mut value = [0; 5];
        assert_eq!(getxattr(&lab.file, "user.lab", &mut value[..]), Ok(5));
        assert_eq!(&value, b"three");
    }
}

#[test]
fn root_keeps_owner_and_group_for_every_command() {
    if lacks(is_root(), "root, to change the owner of a file") {
        return;
    }
    let [user, group] = OTHERS;
    let own = |file: &Path| {
        chown(file, Some(user), Some(group)).unwrap();
        fs::set_permissions(file, fs::Permissions::from_mode(0o640)).unwrap();
    };
    let kept = |found: Metadata| {
        assert_eq!((found.uid(), found.gid(), found.mode() & 0o7777), (user, group, 0o640));
    };
    let lab = Lab::new();
    own(&lab.file);
    lab.written(&[]);
    kept(lab.found());
    let done = run(trifacet(&["tune", "--steps", "10", "--config"]).arg(&lab.file));
    assert_eq!(done.code, 0, "{}", done.err);
    assert!(fs::read_to_string(&lab.file).unwrap().contains("[steering]\nmatrix = "));
    kept(lab.found());
    let mut daemon = Daemon::start("");
    daemon.message("control socket is open");
    own(&daemon.file());
    daemon.status_until(|status| status["loop"]["lock"] == "locked");
    daemon.told(&["tare", "--save"]);
    assert!(daemon.text().contains("[frames.tare]"));
    kept(fs::metadata(daemon.file()).unwrap());
}

#[test]
fn a_user_who_is_not_the_owner_overwrites_the_file() {
    if lacks(is_root(), "root, to become another user") {
        return;
    }
    let [user, group] = OTHERS;
    let lab = Lab::new();
    let folder = lab.file.parent().unwrap();
    chown(folder, None, Some(group)).unwrap();
    fs::set_permissions(folder, fs::Permissions::from_mode(0o770)).unwrap();
    chown(&lab.file, None, Some(group)).unwrap();
    fs::set_permissions(&lab.file, fs::Permissions::from_mode(0o640)).unwrap();
    let ids = [format!("--reuid={user}"), format!("--regid={group}")];
    let through = ["setpriv", &ids[0], &ids[1], "--clear-groups"];
    // This user may read it and create files beside it: not enough to keep the owner.
    lab.refused(&through, "its owner, group and permissions can be kept only by overwriting it");
    fs::set_permissions(&lab.file, fs::Permissions::from_mode(0o660)).unwrap();
    let before = lab.found();
    lab.written(&through);
    let after = lab.found();
    assert_eq!((after.ino(), after.uid(), after.gid()), (before.ino(), 0, group));
    assert_eq!((after.mode(), lab.names()), (before.mode(), vec!["lab.toml".to_owned()]));
    // Without a place for a copy the file is not touched.
    let lab = Lab::new();
    let folder = lab.file.parent().unwrap();
    fs::set_permissions(folder, fs::Permissions::from_mode(0o755)).unwrap();
    fs::set_permissions(&lab.file, fs::Permissions::from_mode(0o666)).unwrap();
    lab.refused(&through, "cannot create ");
}

#[test]
fn links_stay() {
    let mut lab = Lab::new();
    let (real, second) = (lab.file.clone(), lab.home.path("second.toml"));
    fs::hard_link(&real, &second).unwrap();
    lab.file = lab.home.path("link.toml");
    symlink("lab.toml", &lab.file).unwrap();
    lab.written(&[]);
    assert_eq!(fs::read_link(&lab.file).unwrap(), Path::new("lab.toml"));
    assert_eq!(fs::read(&real).unwrap(), fs::read(&second).unwrap());
    assert_eq!(lab.names(), ["lab.toml", "link.toml", "second.toml"]);
}

#[test]
fn a_file_that_is_mounted_by_itself_is_overwritten() {
    let lab = Lab::new();
    let file = lab.file.to_str().unwrap();
    let through = |options: &'static str| {
        let script = match options {
            "" => "mount --bind \"$0\" \"$0\" && exec \"$@\"",
            _ => "mount --bind \"$0\" \"$0\" && mount -o remount,bind,ro \"$0\" && exec \"$@\"",
        };
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, file]
    };
    lab.refused(&through("ro"), "can be kept only by overwriting it");
    let before = lab.found();
    lab.written(&through(""));
    assert_eq!((lab.found().ino(), lab.names()), (before.ino(), vec!["lab.toml".to_owned()]));
}

#[test]
fn a_full_disk_is_found_before_the_measurement() {
    let lab = Lab::new();
    // No file may grow in this shell: writing fails as on a full disk.
    let through = ["sh", "-c", "ulimit -f 0; exec \"$@\"", "sh"];
    lab.refused(&through, "File too large");
    // Overwriting needs as much space.
    fs::hard_link(&lab.file, lab.home.path("second.toml")).unwrap();
    lab.refused(&through, "File too large");
}

#[test]
fn the_byte_order_mark_and_line_ends_stay() {
    let lab = Lab::new();
    let windows = format!("\u{feff}{}", TEXT.replace('\n', "\r\n"));
    fs::write(&lab.file, &windows).unwrap();
    assert_eq!(lab.dark(&[]).code, 0);
    let text = fs::read_to_string(&lab.file).unwrap();
    assert!(text.starts_with(&format!("{windows}\r\n\r\n[channels.a]\r\ndark_v = [")), "{text:?}");
    assert_eq!(text.matches('\n').count(), text.matches("\r\n").count(), "{text:?}");
    let check = run(trifacet(&["check", "--config"]).arg(&lab.file));
    assert_eq!(check.code, 0, "{}", check.err);
}
