//! A twin with a head of its own that was calibrated by commands, once for all tests.

use std::path::Path;
use std::sync::OnceLock;

use super::{Folder, run, trifacet};

/// The folder of the twin of `config/real-head.toml` after its calibration with 100 points: `real.toml`, `run/`, and the
/// results in `calibrated/`.
pub(crate) fn calibrated_twin() -> &'static Folder {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Folder::new();
        let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/real-head.toml");
        folder.write("real.toml", std::fs::read_to_string(example).unwrap());
        for command in [
            "dark --config real.toml",
            "calibrate plan --config real.toml --points 100 --range-mm 1.1 --range-mrad 5.5 --out plan.csv",
            "calibrate run --config real.toml --plan plan.csv --out run",
            "calibrate fit --config real.toml --points run/points.csv --scan run/scan.csv --out calibrated",
        ] {
            let arguments: Vec<&str> = command.split(' ').collect();
            let done = run(trifacet(&arguments).current_dir(folder.path("")));
            assert_eq!(done.code, 0, "{command}: {}", done.err);
        }
        folder
    })
}
