//! The serial devices that exist now: points at a device that came back under another name.

use std::fs;
use std::path::{Path, PathBuf};

use serialport::SerialPortType;

/// Links to serial devices whose names contain manufacturer, product and serial number.
const BY_ID: &str = "/dev/serial/by-id";
/// The list from which `serialport` reads the devices; it panics without it.
const SYSFS: &str = "/sys/class/tty";

/// What is known of a device apart from its name, which may change.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Its permanent link.
    by_id: Option<PathBuf>,
    /// Vendor, product and serial number on USB.
    usb: Option<(u16, u16, String)>,
}

struct Device {
    path: PathBuf,
    identity: Identity,
}

impl Identity {
    /// The identity of the device at this port.
    pub(super) fn of(port: &Path) -> Self {
        let device = fs::canonicalize(port).ok();
        let found = present().into_iter().find(|other| Some(&other.path) == device.as_ref());
        found.map(|device| device.identity).unwrap_or_default()
    }

    fn is_same(&self, other: &Self) -> bool {
        (self.by_id.is_some() && self.by_id == other.by_id) || (self.usb.is_some() && self.usb == other.usb)
    }
}

/// Where the device may be that was at the port `gone`: the device with this identity, or all that exist.
pub(super) fn pointer(gone: &Path, identity: &Identity) -> String {
    let present = present();
    if let Some(device) = present.iter().find(|device| device.identity.is_same(identity)) {
        let (now, gone) = (device.path.display(), gone.display());
        let remedy = match &device.identity.by_id {
            Some(link) => format!("set the port to {}, which stays the same", link.display()),
            None => "set the port to this name, or give the device a permanent one by a udev rule".into(),
        };
        return format!("the device that was at {gone} is now {now}: {remedy}");
    }
    let names: Vec<_> = present.iter().map(Device::describe).collect();
    if names.is_empty() {
        "no serial device is connected".into()
    } else {
        format!("serial devices that exist: {}", names.join(", "))
    }
}

impl Device {
    fn describe(&self) -> String {
        let path = self.path.display();
        match &self.identity.by_id {
            Some(link) => format!("{path} ({})", link.display()),
            None => path.to_string(),
        }
    }
}

/// The devices with a permanent link, and those on USB and PCI. Built-in ports, which always exist, are left out.
fn present() -> Vec<Device> {
    let mut devices: Vec<Device> = links()
        .map(|(path, link)| Device { path, identity: Identity { by_id: Some(link), usb: None } })
        .collect();
    let ports = Path::new(SYSFS).is_dir().then(serialport::available_ports);
    for port in ports.and_then(Result::ok).unwrap_or_default() {
        let usb = match port.port_type {
            SerialPortType::UsbPort(usb) => usb.serial_number.map(|serial| (usb.vid, usb.pid, serial)),
            SerialPortType::PciPort => None,
            SerialPortType::BluetoothPort | SerialPortType::Unknown => continue,
        };
        let path = PathBuf::from(port.port_name);
        match devices.iter_mut().find(|device| device.path == path) {
            Some(device) => device.identity.usb = usb,
            None => devices.push(Device { path, identity: Identity { by_id: None, usb } }),
        }
    }
    devices.sort_by(|a, b| a.path.cmp(&b.path));
    devices
}

/// The permanent links: device and link.
fn links() -> impl Iterator<Item = (PathBuf, PathBuf)> {
    let links = fs::read_dir(BY_ID).into_iter().flatten().flatten().map(|entry| entry.path());
    links.filter_map(|link| Some((fs::canonicalize(&link).ok()?, link)))
}
