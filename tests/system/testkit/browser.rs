//! Headless Chromium, controlled by the DevTools protocol.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Once;
use std::time::Duration;

use serde_json::{Value, json};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

use super::turn::Turn;
use super::{Killed, PATIENCE, now_ns};

/// A browser with one tab. It is closed at the end of its test.
pub(crate) struct Browser {
    _child: Killed,
    _profile: tempfile::TempDir,
    _turn: Turn,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    target: String,
    calls: u64,
    /// Received events, in order.
    pub(crate) events: Vec<Value>,
}

impl Browser {
    /// Opens a browser at this address with a window of this size.
    pub(crate) fn open(url: &str, [width, height]: [u32; 2]) -> Self {
        install();
        let turn = Turn::wait();
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new("chromium")
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
            .args(["--no-first-run", "--disable-background-networking", "--disable-component-update"])
            .args(["--disable-sync", "--disable-default-apps", "--disable-extensions", "--hide-scrollbars"])
            .args(["--remote-debugging-port=0", "--enable-precise-memory-info", "--js-flags=--expose-gc"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg(format!("--window-size={width},{height}"))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("chromium");
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let at = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.strip_prefix("DevTools listening on ").map(str::to_owned))
            .expect("chromium prints its address");
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(at).unwrap();
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
        }
        let (session, target) = (String::new(), String::new());
        let mut browser = Self {
            _child: Killed(child),
            _profile: profile,
            _turn: turn,
            socket,
            session,
            target,
            calls: 0,
            events: vec![],
        };
        let tabs = browser.call("Target.getTargets", &json!({}));
        let tab = tabs["targetInfos"].as_array().unwrap().iter().find(|t| t["type"] == "page").unwrap();
        browser.target = tab["targetId"].as_str().unwrap().into();
        let attach = json!({ "targetId": browser.target, "flatten": true });
        browser.session =
            browser.call("Target.attachToTarget", &attach)["sessionId"].as_str().unwrap().into();
        for domain in ["Page", "Network", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), &json!({}));
        }
        browser.size([width, height]);
        browser.call("Page.navigate", &json!({ "url": url }));
        browser
    }

    /// Calls a method of the protocol and returns its result.
    pub(crate) fn call(&mut self, method: &str, params: &Value) -> Value {
        self.calls += 1;
        let id = self.calls;
        let mut call = json!({ "id": id, "method": method, "params": params });
        if !self.session.is_empty() {
            call["sessionId"] = self.session.clone().into();
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == id {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
            self.events.push(answer);
        }
    }

    /// The value of an expression in the page.
    pub(crate) fn eval(&mut self, expression: &str) -> Value {
        let params = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", &params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub(crate) fn until(&mut self, expression: &str) {
        let begin_ns = now_ns();
        while self.eval(expression) != true {
            if now_ns() - begin_ns > PATIENCE.as_nanos() as i64 {
                let text = self.eval("document.body.innerText");
                panic!("never {expression}: {text}");
            }
            std::thread::sleep(Duration::from_millis(50)); // leaves processor time to the page
        }
    }

    /// Waits until all changes so far are drawn.
    pub(crate) fn drawn(&mut self) {
        self.eval("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))");
    }

    /// Emulates a screen of this size.
    pub(crate) fn size(&mut self, [width, height]: [u32; 2]) {
        let mobile = width < 600;
        let scale = if mobile { 2 } else { 1 };
        let screen =
            json!({ "width": width, "height": height, "deviceScaleFactor": scale, "mobile": mobile });
        self.call("Emulation.setDeviceMetricsOverride", &screen);
    }

    /// Sets the preferred colour scheme of the system, light or dark.
    pub(crate) fn scheme(&mut self, name: &str) {
        let feature = json!({ "features": [{ "name": "prefers-color-scheme", "value": name }] });
        self.call("Emulation.setEmulatedMedia", &feature);
    }

    /// Presses and releases a key.
    pub(crate) fn press(&mut self, key: &str, code: u32) {
        for kind in ["rawKeyDown", "keyUp"] {
            let event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
            self.call("Input.dispatchKeyEvent", &event);
        }
    }

    /// Opens another tab in the foreground, which hides this one.
    pub(crate) fn hide(&mut self) -> String {
        let blank = json!({ "url": "about:blank" });
        self.call("Target.createTarget", &blank)["targetId"].as_str().unwrap().to_owned()
    }

    /// Brings this tab to the foreground again.
    pub(crate) fn show(&mut self) {
        let target = json!({ "targetId": self.target });
        self.call("Target.activateTarget", &target);
    }

    /// Saves a picture of the whole page.
    pub(crate) fn picture(&mut self, to: &Path) {
        self.shot(to, &json!({ "format": "png", "captureBeyondViewport": true }));
    }

    /// Saves a picture of the page down to this height, scaled to three quarters.
    pub(crate) fn thumbnail(&mut self, to: &Path, height: u32) {
        let width = self.eval("innerWidth");
        let clip = json!({ "x": 0, "y": 0, "width": width, "height": height, "scale": 0.75 });
        self.shot(to, &json!({ "format": "png", "captureBeyondViewport": true, "clip": clip }));
    }

    fn shot(&mut self, to: &Path, shot: &Value) {
        let data = self.call("Page.captureScreenshot", shot)["data"].as_str().unwrap().to_owned();
        std::fs::write(to, decoded(&data)).unwrap();
    }

    /// Errors and warnings of the console and the browser.
    pub(crate) fn complaints(&mut self) -> Vec<String> {
        self.eval("1"); // after this call, all earlier events have arrived
        let wrong = |event: &&Value| match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => {
                ["error", "warning", "assert"].iter().any(|kind| event["params"]["type"] == *kind)
            }
            Some("Log.entryAdded") => {
                ["error", "warning"].iter().any(|level| event["params"]["entry"]["level"] == *level)
            }
            _ => false,
        };
        self.events.iter().filter(wrong).map(|event| event["params"].to_string()).collect()
    }

    /// All requested addresses.
    pub(crate) fn requests(&mut self) -> Vec<String> {
        self.eval("1");
        let url = |event: &Value| match event["method"].as_str()? {
            "Network.requestWillBeSent" => Some(event["params"]["request"]["url"].as_str()?.to_owned()),
            "Network.webSocketCreated" => Some(event["params"]["url"].as_str()?.to_owned()),
            _ => None,
        };
        self.events.iter().filter_map(url).collect()
    }
}

/// Chromium of Debian; installed if it is missing and the permissions allow it.
fn install() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/system/testkit/chromium.sh");
        let output = Command::new("bash").arg(script).output().expect("bash");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    });
}

/// Decodes Base64, the encoding of pictures in the protocol.
fn decoded(text: &str) -> Vec<u8> {
    let six = |byte: u8| match byte {
        b'A'..=b'Z' => u32::from(byte - b'A'),
        b'a'..=b'z' => u32::from(byte - b'a') + 26,
        b'0'..=b'9' => u32::from(byte - b'0') + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<_> = text.bytes().filter(|b| *b != b'=').map(six).collect();
    let bytes = |group: &[u32]| {
        let bits = group.iter().enumerate().fold(0, |bits, (i, six)| bits | six << (18 - 6 * i));
        bits.to_be_bytes()[1..group.len()].to_vec()
    };
    digits.chunks(4).flat_map(bytes).collect()
}
