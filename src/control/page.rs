//! The permission of the live page to control the daemon.

use std::sync::Arc;

use tokio::sync::Mutex;

use super::RunningConfig;
use crate::config::{MonitorConfig, Token};

/// Control of the daemon from the page. Exists only if `monitor.control` is on.
#[derive(Clone, Debug)]
pub struct PageControls {
    /// Whoever presents this token may give commands.
    pub token: Token,
    /// The daemon.
    pub live: Arc<Mutex<RunningConfig>>,
}

impl PageControls {
    /// The controls, if the configuration enables them.
    pub fn of(config: &MonitorConfig, live: &Arc<Mutex<RunningConfig>>) -> Option<Self> {
        let token = config.token.clone().filter(|_| config.control)?;
        Some(Self { token, live: Arc::clone(live) })
    }
}
