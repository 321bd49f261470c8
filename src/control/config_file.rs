//! The configuration file of a running daemon.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::{Mutex, OwnedMutexGuard};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use crate::exit::{self, Failure};

/// Time limit for reading or writing the file.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Time limit for waiting for an earlier command. A tare that is saved can take this long.
const TURN_TIMEOUT: Duration = Duration::from_secs(30);

/// The configuration file. Its file system may stop responding, and then even opening the file does not return.
/// Every access therefore runs on a thread of its own, and there is at most one such thread.
#[derive(Clone, Debug)]
pub struct ConfigFile {
    path: PathBuf,
    turn: Arc<Mutex<()>>,
    /// An access has exceeded its time limit and has not returned since.
    hung: Arc<AtomicBool>,
}

/// The right to access the file. Nobody else has it until this is dropped.
#[derive(Debug)]
pub struct Access {
    path: PathBuf,
    hung: Arc<AtomicBool>,
    _turn: OwnedMutexGuard<()>,
}

impl ConfigFile {
    /// The file at this path.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), turn: Arc::default(), hung: Arc::default() }
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Waits until no other command accesses the file.
    ///
    /// # Errors
    /// [`exit::IO`] if an earlier access does not return.
    pub async fn access(&self) -> Result<Access, Failure> {
        let busy = || {
            let why = format!("an earlier access to {} has not returned", self.path.display());
            Failure::new(exit::IO, format!("{why}: does its file system respond?"))
        };
        if self.hung.load(Ordering::Relaxed) {
            return Err(busy());
        }
        let turn = timeout(TURN_TIMEOUT, Arc::clone(&self.turn).lock_owned()).await.map_err(|_| busy())?;
        Ok(Access { path: self.path.clone(), hung: Arc::clone(&self.hung), _turn: turn })
    }
}

impl Access {
    /// Runs `job` with the path, on a thread of its own. Returns its result and the access.
    ///
    /// # Errors
    /// The error of `job`; [`exit::IO`] if it takes longer than 5 s. It then goes on, and keeps the access.
    pub async fn run<T: Send + 'static>(
        self,
        job: impl FnOnce(&Path) -> Result<T, Failure> + Send + 'static,
    ) -> Result<(T, Self), Failure> {
        let (path, hung) = (self.path.clone(), Arc::clone(&self.hung));
        let mut thread = spawn_blocking(move || (job(&self.path), self));
        match timeout(TIMEOUT, &mut thread).await {
            Ok(Ok((result, access))) => Ok((result?, access)),
            Ok(Err(e)) => {
                Err(Failure::new(exit::SOFTWARE, format!("the access to {} failed: {e}", path.display())))
            }
            Err(_) => {
                hung.store(true, Ordering::Relaxed);
                tokio::spawn(async move {
                    let result = match thread.await {
                        Ok((Ok(_), _)) => "success".into(),
                        Ok((Err(e), _)) => e.to_string(),
                        Err(e) => e.to_string(),
                    };
                    hung.store(false, Ordering::Relaxed);
                    tracing::warn!(
                        result,
                        "an access to the configuration file has ended after its time limit"
                    );
                });
                let s = TIMEOUT.as_secs();
                let why = format!("{} has not responded for {s} s; the access goes on", path.display());
                Err(Failure::new(exit::IO, format!("{why}: does its file system respond?")))
            }
        }
    }
}
