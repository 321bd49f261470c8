//! The LinuxCNC component under the real HAL. The script installs its requirements if it has the permission.

#[test]
fn the_component_follows_the_daemon_under_the_real_hal() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/kits/linuxcnc.sh");
    let run = std::process::Command::new("bash").args([script, env!("CARGO_BIN_EXE_trifacet")]).output();
    let run = run.expect("bash");
    let said = [run.stdout, run.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(run.status.success(), "{}{}", said[0], said[1]);
    println!("{}", said[0]);
}
