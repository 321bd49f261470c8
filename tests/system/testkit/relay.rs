//! A relay between a host on TCP and a board: it can hold what the board sends and release it in a burst, as a network
//! does that stops for a moment, or pass it on in blocks, as converters with their own buffer do.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

/// Where the board is.
pub(crate) enum Far {
    /// At an address.
    Tcp(String),
    /// On a pseudo-terminal.
    Terminal(PathBuf),
}

/// The relay. It serves hosts one after the other until the test ends.
pub(crate) struct Relay {
    address: SocketAddr,
    /// What the board sends is passed on after each multiple of this time, milliseconds; 0: at once.
    block_ms: Arc<AtomicU64>,
}

/// Both directions of a connection.
type Ends = (Box<dyn Read + Send>, Box<dyn Write + Send>);

impl Far {
    fn connect(&self) -> io::Result<Ends> {
        match self {
            Self::Tcp(address) => {
                let stream = TcpStream::connect(address)?;
                stream.set_nodelay(true)?;
                Ok((Box::new(stream.try_clone()?), Box::new(stream)))
            }
            Self::Terminal(path) => {
                let file = File::options().read(true).write(true).open(path)?;
                Ok((Box::new(file.try_clone()?), Box::new(file)))
            }
        }
    }
}

impl Relay {
    pub(crate) fn to(far: Far) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let block_ms = Arc::<AtomicU64>::default();
        let block = Arc::clone(&block_ms);
        thread::spawn(move || {
            for host in listener.incoming().map_while(Result::ok) {
                if let Ok(board) = far.connect() {
                    serve(host, board, &block);
                }
            }
        });
        Self { address, block_ms }
    }

    /// Its address, for hosts.
    pub(crate) fn address(&self) -> String {
        self.address.to_string()
    }

    /// From now on, passes on what the board sends in blocks of this duration; 0: at once.
    pub(crate) fn blocks(&self, ms: u64) {
        self.block_ms.store(ms, Ordering::Relaxed);
    }

    /// Holds what the board sends for this time, and then passes it on in one burst.
    pub(crate) fn hold(&self, ms: u64) {
        self.blocks(ms);
        thread::sleep(Duration::from_millis(ms / 2));
        self.blocks(0); // the block that has begun is completed
    }
}

/// Serves one host until it leaves.
fn serve(host: TcpStream, (mut from_board, mut to_board): Ends, block_ms: &Arc<AtomicU64>) {
    host.set_nodelay(true).unwrap();
    let (mut from_host, mut to_host) = (host.try_clone().unwrap(), host);
    let (sender, heard) = mpsc::channel::<Vec<u8>>();
    thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(read @ 1..) = from_board.read(&mut buffer) {
            if sender.send(buffer[..read].to_vec()).is_err() {
                return;
            }
        }
    });
    let block_ms = Arc::clone(block_ms);
    thread::spawn(move || {
        while let Ok(mut bytes) = heard.recv() {
            thread::sleep(Duration::from_millis(block_ms.load(Ordering::Relaxed)));
            bytes.extend(heard.try_iter().flatten());
            if to_host.write_all(&bytes).is_err() {
                break;
            }
        }
        let _ = to_host.shutdown(Shutdown::Both); // it may be closed already
    });
    let mut buffer = [0; 4096];
    while let Ok(read @ 1..) = from_host.read(&mut buffer) {
        if to_board.write_all(&buffer[..read]).is_err() {
            return;
        }
    }
}
