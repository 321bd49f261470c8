//! The members of the workspace and their allowed dependencies.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
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
    for member in ["trifacet-wire", "trifacet-optics", "trifacet-budget", "trifacet-core"] {
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
    for member in ["trifacet-wire", "trifacet-optics", "trifacet-budget"] {
        assert!(below(member).is_empty(), "{member}");
    }
    assert_eq!(below("trifacet-core"), ["trifacet-optics", "trifacet-wire"]);
    assert_eq!(below("trifacet-client"), ["trifacet-wire"]);
}

#[test]
fn a_program_that_only_decodes_frames_is_built_from_ten_packages() {
    let packages = packages("trifacet-wire", &[]);
    assert!(packages.len() <= 9, "with the program itself these are more than ten: {packages:?}");
}

/// The modules that a file names as `crate::name`, or in `crate::{...}`; without its unit tests.
fn named(text: &str) -> BTreeSet<String> {
    let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    let code: Vec<_> = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let word =
        |rest: &str| rest.trim().split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap().to_owned();
    let after = code.join(" ");
    let mut found = BTreeSet::new();
    for rest in after.split("crate::").skip(1) {
        match rest.strip_prefix('{') {
            Some(list) => found.extend(list.split('}').next().unwrap().split(',').map(word)),
            None => drop(found.insert(word(rest))),
        }
    }
    found
}

/// The modules at the top of `src/`, and those that each of them names.
fn dependencies(folder: &Path, module: Option<&str>, found: &mut BTreeMap<String, BTreeSet<String>>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name().into_string().unwrap());
        let own = module.unwrap_or_else(|| name.trim_end_matches(".rs")).to_owned();
        if path.is_dir() {
            dependencies(&path, Some(&own), found);
        } else if path.extension().is_some_and(|end| end == "rs")
            && name != "tests.rs"
            && own != "lib"
            && own != "main"
        {
            let mut others = named(&fs::read_to_string(&path).unwrap());
            others.remove(&own);
            found.entry(own).or_default().extend(others);
        }
    }
}

#[test]
fn no_module_depends_on_one_that_depends_on_it() {
    let mut left = BTreeMap::new();
    dependencies(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), None, &mut left);
    left.remove("commands"); // of the binary: it uses the library
    assert!(left.len() > 15 && left["daemon"].contains("config"), "{left:?}");
    let free = |left: &BTreeMap<String, BTreeSet<String>>| {
        left.iter()
            .find(|(_, uses)| !uses.iter().any(|other| left.contains_key(other)))
            .map(|(name, _)| name.clone())
    };
    while let Some(name) = free(&left) {
        left.remove(&name);
    }
    assert!(left.is_empty(), "these depend on each other: {left:#?}");
}

/// Whether an SPDX expression without exceptions allows distribution under one of these licences.
fn permits(expression: &str, allowed: &[&str]) -> bool {
    let plain = expression.replace(['(', ')'], "").replace('/', " OR ");
    plain.split(" AND ").all(|part| part.split(" OR ").any(|licence| allowed.contains(&licence.trim())))
}

#[test]
fn every_dependency_has_a_permissive_licence_and_comes_from_the_registry() {
    const ALLOWED: [&str; 8] =
        ["MIT", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "Unicode-3.0", "Unlicense", "Zlib"];
    // Of its files, which are unchanged, the source is public.
    const FILE_COPYLEFT: [&str; 1] = ["serialport"];
    let done = run(Command::new(env!("CARGO")).current_dir(env!("CARGO_MANIFEST_DIR")).args([
        "tree",
        "--offline",
        "--workspace",
        "--all-features",
        "--edges",
        "normal,build",
        "--prefix",
        "none",
        "--format",
        "{p}|{l}",
    ]));
    assert_eq!(done.code, 0, "{}", done.err);
    let lines: BTreeSet<_> = done.out.lines().filter(|line| !line.is_empty()).collect();
    assert!(lines.len() > 100, "{lines:?}");
    for line in lines {
        let (package, licence) = line.split_once('|').unwrap();
        let licence = licence.trim_end_matches(" (*)");
        let name = package.split(' ').next().unwrap();
        assert!(permits(licence, &ALLOWED) || FILE_COPYLEFT.contains(&name), "{package}: {licence}");
    }
    let lock = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.lock")).unwrap();
    let sources: Vec<_> = lock.lines().filter_map(|line| line.strip_prefix("source = ")).collect();
    assert!(
        sources.len() > 100 && sources.iter().all(|source| source.starts_with("\"registry+")),
        "{sources:?}"
    );
}
