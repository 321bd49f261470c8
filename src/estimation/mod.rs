//! Task 3: [`Sample`](crate::acquisition::Sample)s to [`PoseReport`]s.

pub mod report;
pub mod status;

pub use report::PoseReport;
pub use status::Status;
