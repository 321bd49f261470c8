//! The shipped configurations, their documentation, the service unit and the man pages agree with the code.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use trifacet::config::{Config, SourceKind, load, parse};

use crate::testkit;

fn root(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root(path)).unwrap()
}

fn trifacet(arguments: &[&str]) -> Output {
    testkit::trifacet(arguments).output().unwrap()
}

#[test]
fn every_shipped_configuration_is_valid() {
    let mut count = 0;
    for entry in std::fs::read_dir(root("config")).unwrap() {
        let path = entry.unwrap().path();
        let output = trifacet(&["check", "--config", path.to_str().unwrap()]);
        assert!(output.status.success(), "{path:?}: {}", String::from_utf8_lossy(&output.stderr));
        count += 1;
    }
    assert!(count >= 2);
}

#[test]
fn the_default_file_has_the_defaults_and_the_board_example_uses_a_board() {
    assert_eq!(load(Some(&root("config/default.toml"))).unwrap(), Config::default());
    let board = load(Some(&root("config/serial-board.toml"))).unwrap();
    assert_eq!(board.acquisition.source, SourceKind::Board);
    let places = ["serial-board", "network-board"].map(|name| {
        let config = load(Some(&root(&format!("config/{name}.toml")))).unwrap();
        config.acquisition.board().unwrap().to_string()
    });
    assert_eq!(places, ["/dev/ttyACM0", "192.168.1.20:7365"]);
}

/// The documentation of a key.
struct Row {
    default: String,
    allowed: String,
}

/// The tables of docs/configuration.md by dotted key; `[]` stands for an element of a list.
fn documented() -> BTreeMap<String, Row> {
    let mut rows = BTreeMap::new();
    let mut section = String::new();
    for line in read("docs/configuration.md").lines() {
        if let Some(heading) = line.strip_prefix("## `[") {
            let name = heading.split('`').next().unwrap();
            section = match name.strip_prefix('[') {
                Some(list) => format!("{}[]", list.trim_end_matches(']')),
                None => name.trim_end_matches(']').into(),
            };
        }
        let cells: Vec<_> = line.split('|').map(str::trim).collect();
        if let [_, key, default, allowed, _, ..] = cells[..]
            && let Some(key) = key.strip_prefix('`')
        {
            let row = Row { default: default.trim_matches('`').into(), allowed: allowed.into() };
            rows.insert(format!("{section}.{}", key.trim_end_matches('`')), row);
        }
    }
    rows
}

/// The keys of config/default.toml with their values as written; keys in comments have no value.
fn defaults() -> BTreeMap<String, Option<String>> {
    let mut keys = BTreeMap::new();
    let mut section = String::new();
    for line in read("config/default.toml").lines() {
        let (line, comment) = match line.strip_prefix("# ") {
            Some(rest) => (rest, true),
            None => (line, false),
        };
        if let Some(list) = line.strip_prefix("[[") {
            section = format!("{}[]", list.split(']').next().unwrap());
        } else if let Some(name) = line.strip_prefix('[') {
            section = name.split(']').next().unwrap().into();
        } else if let Some((key, value)) = line.split_once(" = ")
            && key.chars().all(|c| c.is_ascii_lowercase() || c == '_')
        {
            let value = value.split('#').next().unwrap().trim().to_owned();
            // The parts of a head have the same keys, as do the motions: the first one represents all.
            keys.entry(format!("{section}.{key}")).or_insert((!comment).then_some(value));
        }
    }
    keys
}

#[test]
fn every_key_is_documented_with_its_default() {
    let documented = documented();
    assert!(documented.len() > 80, "{}", documented.len());
    let one_of_three = [".b.", ".c.", "frames.tool.", "frames.tare."];
    for (key, value) in defaults().iter().filter(|(key, _)| !one_of_three.iter().any(|b| key.contains(b))) {
        let row = documented.get(key).unwrap_or_else(|| panic!("docs/configuration.md lacks {key}"));
        assert_eq!(row.default, value.clone().unwrap_or_default(), "default of {key}");
    }
}

#[test]
fn every_documented_key_exists_with_the_documented_range() {
    let mut ranges = 0;
    for (key, row) in documented() {
        let Some((lo, hi)) = range(&row.allowed) else { continue };
        for bad in [lo - 1.0, hi * 1.5 + 1.0] {
            let text = with_value(&key, bad, &row.default);
            let error = parse(&text, None).expect_err(&text).to_string();
            let told = key.replace("[]", "[0]");
            assert!(
                error
                    .lines()
                    .any(|l| l.contains(&told) && l.contains(&format!("allowed is {}", row.allowed))),
                "{text}\nmessage: {error}\nexpected: {told} ... {}",
                row.allowed
            );
            ranges += 1;
        }
    }
    assert!(ranges > 100, "{ranges}");
}

/// Parses ranges such as "5 to 85" or "more than 0, at most 1".
fn range(allowed: &str) -> Option<(f64, f64)> {
    let (lo, hi) = match allowed.strip_prefix("more than ") {
        Some(rest) => rest.split_once(", at most ")?,
        None => allowed.split_once(" to ")?,
    };
    Some((lo.parse().ok()?, hi.parse().ok()?))
}

/// A configuration with this value for a key.
fn with_value(key: &str, value: f64, default: &str) -> String {
    let (section, name) = key.rsplit_once('.').unwrap();
    // An integer if the default has no decimal point.
    let number = if default.contains('.') { format!("{value:?}") } else { format!("{value}") };
    let elements = match name {
        "psd_origin_mm" | "pivot_mm" => 3,
        _ if default.starts_with('[') => default.split(',').count(),
        _ => 0,
    };
    let value = if elements > 0 { format!("[{}]", vec![number; elements].join(", ")) } else { number };
    let rest = match (section, name) {
        ("twin.motion[]", "amount_urad") => "axis = 'roll'\nkind = 'sine'\nfrequency_hz = 1",
        ("twin.motion[]", _) => "axis = 'tx'\nkind = 'vibration'",
        ("publishing.udp[]", _) => "address = '239.255.0.1:7362'",
        ("twin.fault[]", "psd") => "at_s = 1\nkind = 'psd-dark'",
        ("twin.fault[]", "channel") => "at_s = 1\nkind = 'clipped'",
        ("twin.fault[]", "fraction") => "at_s = 1\nkind = 'dropped'",
        ("twin.fault[]", "frequency_hz") => "at_s = 1\nkind = 'flicker'\nfraction = 0.05",
        ("twin.fault[]", "factor") => "at_s = 1\nkind = 'laser-power'",
        ("twin.fault[]", "interval_ms") => "at_s = 1\nkind = 'bursts'",
        ("twin.fault[]", "at_s") => "kind = 'stalled'",
        ("twin.fault[]", _) => "at_s = 1\nkind = 'stalled'",
        _ => "",
    };
    let header = match section.strip_suffix("[]") {
        Some(list) => format!("[[{list}]]"),
        None => format!("[{section}]"),
    };
    format!("{header}\n{name} = {value}\n{rest}\n")
}

#[test]
fn the_table_of_reloadable_keys_is_complete() {
    let page = read("docs/operation.md");
    let section = page.split("\n## Reload\n").nth(1).unwrap().split("\n## ").next().unwrap();
    let documented: Vec<_> =
        section.lines().filter_map(|l| l.strip_prefix("| `")?.split_once('`').map(|(key, _)| key)).collect();
    let live: Vec<_> = trifacet::config::reload::LIVE.iter().map(|key| key.join(".")).collect();
    assert_eq!(documented, live);
}

#[test]
fn the_service_unit_passes_systemd_analyze_verify() {
    let analyze = Command::new("systemd-analyze").arg("--version").output();
    if analyze.is_err() {
        assert!(std::env::var_os("CI").is_none(), "systemd-analyze is needed to check the unit");
        eprintln!("systemd-analyze is not installed: the unit is not checked");
        return;
    }
    let output = Command::new("systemd-analyze")
        .args(["verify", "--man=no", "--recursive-errors=no"])
        .arg(root("systemd/trifacet.service"))
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    // Messages about other units of the machine are ignored.
    let ours: Vec<_> = told.lines().filter(|line| line.contains("trifacet")).collect();
    assert!(output.status.success() && ours.is_empty(), "{told}");
}

#[test]
fn the_service_unit_has_a_low_exposure_level() {
    if Command::new("systemd-analyze").arg("--version").output().is_err() {
        assert!(std::env::var_os("CI").is_none(), "systemd-analyze is needed to check the unit");
        eprintln!("systemd-analyze is not installed: the unit is not checked");
        return;
    }
    // The limit of 2.0, in tenths.
    let output = Command::new("systemd-analyze")
        .args(["security", "--offline=true", "--no-pager", "--threshold=20"])
        .arg(root("systemd/trifacet.service"))
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && told.contains("Overall exposure level"), "{told}");
}

#[test]
fn unit_and_package_agree() {
    let unit = read("systemd/trifacet.service");
    let value = |key: &str| unit.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix('=')).unwrap();
    assert_eq!(value("Type"), "notify");
    let watchdog_ms = 1000 * value("WatchdogSec").parse::<u32>().unwrap();
    assert!(watchdog_ms > 2 * Config::default().realtime.stall_ms, "the daemon names the task first");
    assert!(value("ExecStopPost").contains("trifacet park --as-configured"));
    let user = value("User");
    assert!(read("packaging/sysusers.d/trifacet.conf").lines().any(|l| l.starts_with(&format!("u {user} "))));
    assert!(read("packaging/60-trifacet.rules").contains(value("SupplementaryGroups")));
    let manifest = read("Cargo.toml");
    for part in ["etc/trifacet/trifacet.toml", "sysusers.d/", "udev/rules.d/", "man/man1/", "completions/"] {
        assert!(manifest.contains(part), "{part}");
    }
}

#[test]
fn every_command_has_a_valid_man_page_and_there_are_completions() {
    let folder = tempfile::tempdir().unwrap();
    let output = trifacet(&["generate", folder.path().to_str().unwrap()]);
    assert!(output.status.success(), "{output:?}");
    let mut wanted = vec!["trifacet".to_owned()];
    for command in commands(&["--help"]) {
        if ["calibrate", "ctl"].contains(&command.as_str()) {
            let own = commands(&[&command, "--help"]);
            wanted.extend(own.iter().map(|sub| format!("trifacet-{command}-{sub}")));
        }
        wanted.push(format!("trifacet-{command}"));
    }
    wanted.sort();
    let mut pages: Vec<_> = std::fs::read_dir(folder.path().join("man"))
        .unwrap()
        .map(|page| page.unwrap().path())
        .inspect(|page| set_in_type(page))
        .map(|page| page.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    pages.sort();
    assert_eq!(pages, wanted);
    assert!(pages.len() > 20, "{pages:?}");
    let bash = std::fs::read_to_string(folder.path().join("completions/trifacet.bash")).unwrap();
    assert!(bash.contains("--as-configured"));
}

/// The commands that a help text lists, without `help`.
fn commands(help: &[&str]) -> Vec<String> {
    let text = String::from_utf8(trifacet(help).stdout).unwrap();
    let list = text.split("Commands:\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let names = list.lines().filter_map(|line| line.strip_prefix("  ")?.split(' ').next());
    names.filter(|name| !name.is_empty() && *name != "help").map(str::to_owned).collect()
}

/// Checks that the formatter, if installed, reports no warnings.
fn set_in_type(page: &Path) {
    let set = Command::new("man").args(["--warnings", "-l"]).arg(page).env("MANROFFOPT", "-ww").output();
    let Ok(set) = set else {
        assert!(std::env::var_os("CI").is_none(), "man is needed to check the man pages");
        return;
    };
    let told = String::from_utf8_lossy(&set.stderr);
    assert!(set.status.success() && told.is_empty() && !set.stdout.is_empty(), "{}: {told}", page.display());
}

#[test]
fn links_in_the_documents_are_valid() {
    let mut links = 0;
    let files = std::fs::read_dir(root("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = files.filter(|file| file.extension().is_some_and(|name| name == "md"));
    for page in pages.chain(["README.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(root)) {
        let text = std::fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()) {
            let path = link.split('#').next().unwrap();
            if !link.starts_with("http") && !path.is_empty() {
                assert!(page.parent().unwrap().join(path).exists(), "{}: {link}", page.display());
                links += 1;
            }
        }
    }
    assert!(links > 10, "{links}");
}
