//! The members of the workspace and their allowed dependencies.

use std::collections::BTreeSet;
use std::process::Command;

use crate::testkit::run;

/// The packages that a member is built from, including itself, without the dependencies of its tests.
fn packages(member: &str, features: &[&str]) -> BTreeSet<String> {
    let done = run(Command::new(env!("CARGO")).current_dir(env!("CARGO_MANIFEST_DIR")).args(
        [
            &["tree", "--offline", "--edges", "normal,build", "--prefix", "none", "--package", member],
            features,
        ]
        .concat(),
    ));
    assert_eq!(done.code, 0, "{}", done.err);
    done.out
        .lines()
        .filter_map(|line| Some(line.split(' ').next()?.to_owned()))
        .filter(|name| !name.is_empty())
        .collect()
}

#[test]
fn pure_members_depend_on_no_runtime_no_sockets_and_no_files() {
    const IMPURE: [&str; 12] = [
        "tokio",
        "mio",
        "socket2",
        "rustix",
        "libc",
        "nix",
        "serialport",
        "tempfile",
        "walkdir",
        "hyper",
        "tracing",
        "memmap2",
    ];
    for member in ["trifacet-wire", "trifacet-optics", "trifacet-core"] {
        let packages = packages(member, &["--all-features"]);
        assert!(packages.contains(member), "{packages:?}");
        let impure: Vec<_> = IMPURE.iter().filter(|name| packages.contains(**name)).collect();
        assert!(impure.is_empty(), "{member} depends on {impure:?}");
    }
}

#[test]
fn dependencies_between_members_have_one_direction() {
    let below = |member: &str| -> Vec<String> {
        let all = packages(member, &["--all-features"]);
        all.into_iter().filter(|name| name.starts_with("trifacet") && name != member).collect()
    };
    assert!(below("trifacet-wire").is_empty() && below("trifacet-optics").is_empty());
    assert_eq!(below("trifacet-core"), ["trifacet-optics", "trifacet-wire"]);
    assert_eq!(below("trifacet-client"), ["trifacet-wire"]);
}

#[test]
fn a_program_that_only_decodes_frames_is_built_from_ten_packages() {
    let packages = packages("trifacet-wire", &[]);
    assert!(packages.len() <= 9, "with the program itself these are more than ten: {packages:?}");
}
