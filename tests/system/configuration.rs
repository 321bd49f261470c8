//! Valid and invalid configurations: which are refused, at which place, and with which message.

use std::path::Path;

use trifacet::config::{Config, ConfigError, SourceKind, parse};

/// The error message for a configuration that must be refused.
fn refusal(text: &str) -> String {
    match parse(text, Some(Path::new("lab.toml"))) {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(error) => error.to_string(),
    }
}

/// The text, and what the message must contain: the place, the key with its value, and the allowed values.
#[rustfmt::skip]
const BAD: &[(&str, &[&str])] = &[
    // Not TOML
    ("[head\n", &["lab.toml:1:", "not TOML"]),
    ("\n\nx = = 1", &["lab.toml:3:", "not TOML"]),
    ("[head]\npsd_size_mm = 13\npsd_size_mm = 12\n", &["lab.toml:3:1: ", "duplicate key"]),
    ("[head]\rpsd_size_mm = 13\r", &["lab.toml:1:", "not TOML", "carriage return must be followed by newline"]),
    // Unknown keys
    ("[heda]\n", &["lab.toml:1:2: heda is not a key", "did you mean head?", "acquisition, channels"]),
    ("[head]\npsd_distance = 250\n", &["lab.toml:2:1: head.psd_distance is not a key", "did you mean psd_distance_mm?"]),
    ("# first\nacquisition.rate = 5\n", &["lab.toml:2:13: acquisition.rate is not a key", "did you mean rate_hz?"]),
    ("[acquisition.serial]\nbadu = 9600\n", &["lab.toml:2:1: acquisition.serial.badu", "did you mean baud?"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'step'\namount_mm = 1\n", &["lab.toml:4:1: twin.motion[0].amount_mm", "did you mean amount_um?"]),
    ("[[twin.fault]]\nkind = 'stalled'\nat = 1\n", &["lab.toml:3:1: twin.fault[0].at ", "did you mean at_s?"]),
    // Wrong types, with what is allowed
    ("[head]\npsd_size_mm = \"13\"\n", &["lab.toml:2:15: head.psd_size_mm = \"13\": ", "expected f64", "allowed is 0.5 to 200"]),
    ("acquisition = 3", &["lab.toml:1:15: acquisition = 3: "]),
    ("[steering]\nlease_ms = 70000\n", &["lab.toml:2:12: steering.lease_ms = 70000", "allowed is 10 to 10000"]),
    ("[steering]\nlease_ms = -1\n", &["lab.toml:2:12: steering.lease_ms = -1", "allowed is 10 to 10000"]),
    ("[estimation]\naverage = 2.5\n", &["lab.toml:2:11: estimation.average = 2.5", "allowed is 1 to 60000"]),
    ("[realtime]\npriority = 300", &["lab.toml:2:12: realtime.priority = 300", "allowed is 0 to 99"]),
    ("[twin]\nseed = -1", &["lab.toml:2:8: twin.seed = -1", "allowed is 0 to 9007199254740992"]),
    ("[twin]\ndark_v = [0, 0]\n", &["lab.toml:2:10: twin.dark_v", "array of length 9"]),
    ("[channels.a]\ndark_v = [0, 0, 0, 5]\n", &["lab.toml:2:10: channels.a.dark_v has 4 values: allowed are 3"]),
    ("[centering]\nsetpoint_um = [0, 0, 0]\n", &["lab.toml:2:15: centering.setpoint_um has 3 values: allowed are 2"]),
    ("[head]\nbeam_direction = [0, 0, -1, 7]\n", &["lab.toml:2:18: head.beam_direction has 4 values: allowed are 3"]),
    ("[channels.b]\ngain = [1, 'x', 1]\n", &["lab.toml:2:12: channels.b.gain[1] = 'x'", "-100 to 100"]),
    ("[acquisition]\nsource = 'usb'\n", &["lab.toml:2:10: acquisition.source = 'usb'", "one of `twin`, `board`, `serial`, `labjack`, `replay`"]),
    ("[estimation]\nmodel = 'Gaussian'\n", &["lab.toml:2:9: estimation.model", "`ray` or `gaussian`"]),
    ("[publishing]\ntcp = 'localhost'\n", &["lab.toml:2:7: publishing.tcp = 'localhost'", "127.0.0.1:7361", "\"off\""]),
    ("[publishing]\nudp = ['127.0.0.1:1', 'b']\n", &["lab.toml:2:23: publishing.udp[1] = 'b'", "127.0.0.1:7361"]),
    ("[twin.steering]\nreadback_noise_um = 'no'\n", &["lab.toml:2:21: twin.steering.readback_noise_um = 'no'", "\"off\"", "0 to 1000"]),
    ("[[twin.motion]]\nkind = 'step'\namount_um = 1\n", &["lab.toml:1:", "twin.motion[0]", "missing field `axis`"]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'psd-dark'\n", &["lab.toml:1:", "twin.fault[0]", "needs the key `psd`"]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'stalled'\npsd = 1\n", &["twin.fault[0]", "`psd` does not belong"]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'psd-dark'\npsd = -1\n", &["lab.toml:4:7: twin.fault[0].psd = -1", "allowed is 0 to 2"]),
    // Values that are not finite numbers
    ("[head]\npsd_distance_mm = nan\n", &["lab.toml:2:19: head.psd_distance_mm = nan: allowed is 5 to 10000"]),
    ("[head]\nfacet_angle_deg = inf\n", &["lab.toml:2:19: head.facet_angle_deg = inf: allowed is 5 to 85"]),
    ("[centering]\nkp = -inf\n", &["lab.toml:2:6: centering.kp = -inf: allowed is 0 to 10"]),
    ("[head]\nbeam_direction = [0, 0, nan]\n", &["lab.toml:2:18: head.beam_direction", "three finite numbers"]),
    ("[head.a]\npsd_origin_mm = [250, inf, 0]\n", &["lab.toml:2:23: head.a.psd_origin_mm[1] = inf: allowed is -10000 to 10000"]),
    // Combinations that are not allowed
    ("[steering]\nlimit_um = 600\n", &["lab.toml:2:12: steering.limit_um = 600: allowed is at most steering.full_scale_um, 500"]),
    ("[steering]\nfull_scale_um = 300\n", &["lab.toml:2:17: steering.limit_um = 400.0 (default): allowed is at most steering.full_scale_um, 300"]),
    ("[steering]\npark_um = [0, -401]\n", &["lab.toml:2:15: steering.park_um[1] = -401: allowed is within plus/minus steering.limit_um, 400"]),
    ("[steering]\nkind = 'tilt'\n", &["lab.toml:1:", "steering.tilt.pivot_mm = absent: allowed is the point about which the beam turns", "needs it"]),
    ("[steering]\nkind = 'tilt'\ntilt.pivot_mm = [0, 0, 40]\n", &["lab.toml:3:17: steering.tilt.pivot_mm = [0, 0, 40]: allowed is a point at least 50 mm above the apex"]),
    ("[steering]\nkind = 'tilt'\ntilt.pivot_mm = [50, 0, 500]\n", &["lab.toml:3:17: steering.tilt.pivot_mm = [50, 0, 500]: allowed is a geometry in which the light reaches all three PSDs"]),
    ("[steering]\nkind = 'tilt'\ntilt.pivot_mm = [0, nan, 500]\n", &["lab.toml:3:21: steering.tilt.pivot_mm[1] = nan: allowed is -100000 to 100000"]),
    ("[steering]\nkind = 'tilt'\ntilt.pivot_mm = [0, 0, 500, 1]\n", &["steering.tilt.pivot_mm has 4 values: allowed are 3"]),
    ("[steering]\nkind = 'mirror'\n", &["lab.toml:2:8: steering.kind = 'mirror': allowed is `outputs`, `gcs` or `tilt`"]),
    ("[steering]\nkind = 'gcs'\n", &["lab.toml:1:", "steering.gcs.address = absent: allowed is a host and its port", "steering.gcs.port", "needs one of them"]),
    ("[steering]\nkind = 'gcs'\non_lease = 'park'\ngcs.address = 'stage:50000'\n", &["lab.toml:3:12: steering.on_lease = 'park': allowed is \"hold\" with steering.kind = \"gcs\"", "has no lease"]),
    ("[steering]\nkind = 'gcs'\ngcs.address = 'stage:50000'\n", &["lab.toml:2:8: twin.steering.readback_noise_um = 0.1 (default): allowed is \"off\" with another stage"]),
    ("[steering.gcs]\naddress = 'stage'\n", &["lab.toml:2:11: steering.gcs.address = 'stage': allowed is a host and its port, such as \"192.168.1.20:50000\""]),
    ("[steering.gcs]\naddress = 'stage:0'\n", &["lab.toml:2:11: steering.gcs.address = 'stage:0'"]),
    ("[steering.gcs]\naddress = 'stage:50000'\nport = '/dev/ttyUSB0'\n", &["lab.toml:3:8: steering.gcs.port = '/dev/ttyUSB0': allowed is absent"]),
    ("[steering.gcs]\naxes = ['1', '1']\n", &["lab.toml:2:8: steering.gcs.axes = ['1', '1']: allowed is two different names"]),
    ("[steering.gcs]\naxes = ['1', 'X Y']\n", &["steering.gcs.axes", "letters, digits and _"]),
    ("[steering.gcs]\naxes = ['1', '2', '3']\n", &["steering.gcs.axes has 3 values: allowed are 2"]),
    ("[steering.gcs]\num_per_unit = 0\n", &["lab.toml:2:15: steering.gcs.um_per_unit = 0: allowed is more than 0, at most 1000000"]),
    ("[head]\nfacet_angle_deg = 40\n", &["lab.toml:1:1: head: ", "falls off its PSD", "light reaches all three PSDs"]),
    ("[head]\nbeam_direction = [0, 0, 1]\n", &["lab.toml:1:1: head: ", "does not face the light"]),
    ("[head.a]\nnormal = [-1, 1.7, 2]\n[head.b]\nnormal = [1, 0, 1]\n", &["head: ", "counter-clockwise"]),
    ("[head.c]\npsd_normal = [1, 2, 0]\npsd_up = [2, 4, 0]\n", &["lab.toml:3:10: head.c.psd_up = [2, 4, 0]: allowed is a direction across psd_normal"]),
    ("[acquisition]\nsource = 'serial'\nserial.baud = 115200\n", &["lab.toml:3:15: acquisition.serial.baud = 115200: allowed is ", "or more", "at 1000 Hz"]),
    ("[acquisition]\nsource = 'serial'\nrate_hz = 20000\n", &["lab.toml:3:11: acquisition.serial.baud = 921600 (default): allowed is ", "at 20000 Hz"]),
    ("[twin]\nlaser_mw = 5\n", &["lab.toml:2:12: twin.laser_mw = 5: allowed is ", "below 9.99 V", "24.988 V"]),
    ("[twin]\nchannel_skew_us = 100\n", &["lab.toml:2:19: twin.channel_skew_us = 100: allowed is a skew that fits 11 channels into a period of 1000 us"]),
    ("[head]\npsd_size_mm = 1\n", &["lab.toml:2:15: estimation.edge_margin_mm = 0.5 (default): allowed is less than half of head.psd_size_mm, 0.5"]),
    ("[channels.a]\ngain = [0, 1, -1]\n", &["lab.toml:2:9: channels.a.gain[0] = 0: allowed is 0.01 to 100 or", "lab.toml:2:15: channels.a.gain[2] = -1: allowed is 0.01 to 100 (a power)"]),
    ("[channels.c]\ncorrection = 'no/such.csv'\n", &["lab.toml:2:14: channels.c.correction = 'no/such.csv'", "relative to this one: no/such.csv: No such file"]),
    ("[estimation]\nmodel = 'ray'\nfuse_steering = true\n", &["lab.toml:3:17: estimation.fuse_steering = true: allowed is false with estimation.model = \"ray\""]),
    ("[estimation]\nfuse_steering = true\n[twin.steering]\nreadback_noise_um = 'off'\n", &["lab.toml:2:17: estimation.fuse_steering = true: allowed is false with twin.steering.readback_noise_um = \"off\""]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'noise-burst'\nfactor = -1\n", &["lab.toml:4:10: twin.fault[0].factor = -1: allowed is 0 to 1000"]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'laser-bump'\nshift_um = [1, nan]\n", &["lab.toml:4:16: twin.fault[0].shift_um[1] = nan: allowed is -10000 to 10000"]),
    ("[[twin.fault]]\nat_s = 1\nkind = 'laser-bump'\nfactor = 2\n", &["twin.fault[0]", "needs the key `shift_um`"]),
    ("[log]\nlevel = 'inof'\n", &["lab.toml:2:9: log.level = 'inof': allowed is off, error, warn, info"]),
    ("[control]\nsocket = 'ctl.sock'\n", &["lab.toml:2:10: control.socket = 'ctl.sock': allowed is \"auto\", \"off\", or an absolute path"]),
    ("[control]\nmode = 660\n", &["lab.toml:2:8: control.mode = 660: allowed is octal permissions from \"0600\""]),
    ("[control]\nmode = '0o660'\n", &["lab.toml:2:8: control.mode", "octal permissions"]),
    ("[control]\nmode = '0440'\n", &["lab.toml:2:8: control.mode = '0440': allowed is octal"]),
    ("[frames.base]\nrotation_deg = [0, 400, 0]\n", &["lab.toml:2:20: frames.base.rotation_deg[1] = 400: allowed is -360 to 360"]),
    ("[frames.tip]\n", &["lab.toml:1:9: frames.tip is not a key", "base, tool, tare"]),
    ("[centering]\nmode = 'dark'\n", &["lab.toml:2:8: centering.mode = 'dark'", "`on`, `off`, `shadow`"]),
    ("[acquisition]\nsource = 'board'\n", &["lab.toml:2:10: acquisition.port = absent: allowed is the path of a serial port, or acquisition.address or acquisition.socket instead", "needs one of them"]),
    ("[acquisition]\nsource = 'board'\nport = '/dev/ttyACM0'\naddress = 'daq.lan:7365'\n", &["lab.toml:4:11: acquisition.address = 'daq.lan:7365': allowed is absent, because acquisition.port is set"]),
    ("[acquisition]\naddress = 'daq.lan:7365'\nsocket = '/run/board.sock'\n", &["lab.toml:3:10: acquisition.socket = '/run/board.sock': allowed is absent, because acquisition.address is set"]),
    ("[acquisition]\nsource = 'board'\naddress = 'daq.lan'\n", &["lab.toml:3:11: acquisition.address = 'daq.lan': allowed is an address and a port"]),
    ("[acquisition]\nsource = 'board'\naddress = '239.1.2.3:7365'\n", &["lab.toml:3:11: acquisition.address = '239.1.2.3:7365': allowed is a host and its TCP port"]),
    ("[acquisition]\nsource = 'board'\nsocket = 'board.sock'\n", &["lab.toml:3:10: acquisition.socket = 'board.sock': allowed is an absolute path"]),
    ("[acquisition]\nsource = 'board'\nport = ' '\n", &["lab.toml:3:8: acquisition.port = ' ': allowed is the path of a serial port"]),
    ("[acquisition]\nsource = 'board'\nport = '/dev/ttyACM0'\nbaud = 115200\n", &["lab.toml:4:8: acquisition.baud = 115200: allowed is ", "or more", "at 1000 Hz"]),
    ("[acquisition]\nsource = 'board'\naddress = '127.0.0.1:7361'\n", &["lab.toml:3:11: acquisition.address = '127.0.0.1:7361': allowed is the place of a board: at this one the daemon listens itself (publishing.tcp)"]),
    ("[acquisition]\nsource = 'board'\nsocket = '/run/x'\n[control]\nsocket = '/run/x'\n", &["lab.toml:3:10: acquisition.socket = '/run/x'", "(control.socket)"]),
    ("[acquisition]\nsource = 'board'\naddress = 'lab:5000'\n[steering]\nkind = 'gcs'\ngcs.address = 'lab:5000'\n", &["lab.toml:6:15: steering.gcs.address = 'lab:5000': allowed is another address than acquisition.address"]),
    ("[acquisition.serial]\nport = ''\n", &["lab.toml:2:8: acquisition.serial.port = '': allowed is the path of a serial port"]),
    ("[publishing]\nudp = ['1.2.3.4:0']\n", &["lab.toml:2:8: publishing.udp[0] = '1.2.3.4:0': allowed is a port from 1 to 65535"]),
    ("[publishing]\nallow = ['127.0.0.1', 'lab']\n", &["lab.toml:2:23: publishing.allow[1] = 'lab'", "192.168.1.0/24"]),
    ("[[publishing.udp]]\naddress = '1.2.3.4:0'\n", &["lab.toml:1:1: publishing.udp[0]", "a port from 1 to 65535"]),
    ("[publishing]\nudp = ['lab:0']\n", &["publishing.udp[0] = 'lab:0'", "a port from 1 to 65535"]),
    ("[publishing]\nudp = ['1.2.3:5']\n", &["lab.toml:2:8: publishing.udp[0] = '1.2.3:5'", "plc.lan:7361"]),
    ("[publishing]\nudp = ['fe80::1%eth0:5']\n", &["publishing.udp[0]", "[fe80::1%eth0]:7361"]),
    ("[[publishing.udp]]\naddress = 'lab:5'\nttl = 1\n", &["lab.toml:3:7: publishing.udp[0].ttl = 1", "multicast"]),
    ("[[publishing.udp]]\naddress = '[ff02::1%eth0]:5'\ninterface = 'eth0'\n", &["publishing.udp[0].interface = 'eth0'", "the zone of the address"]),
    ("[[publishing.udp]]\naddress = 'lab'\n", &["lab.toml:2:11: publishing.udp[0].address = 'lab'", "127.0.0.1:7361"]),
    ("[[publishing.udp]]\naddress = '1.2.3.4:5'\nttl = 1\n", &["lab.toml:3:7: publishing.udp[0].ttl = 1", "multicast"]),
    ("[[publishing.udp]]\naddress = '[ff02::1]:5'\ninterface = '::1'\n", &["publishing.udp[0].interface = '::1'", "the name"]),
    ("[publishing]\nudp = [{ address = '1.2.3.4:5', dividor = 2 }]\n", &["lab.toml:2:", "dividor", "divider"]),
    ("[publishing]\nudp = ['1.2.3.4:5', '1.2.3.4:5']\n", &["lab.toml:2:21: publishing.udp[1]", "each address once"]),
    ("[publishing]\nsubscribe = '1.2.3.4:5'\nudp = ['1.2.3.4:5']\n", &["lab.toml:2:13: publishing.subscribe = '1.2.3.4:5'", "not a target in publishing.udp"]),
    ("[publishing]\nallow = ['10.1.2.3/16']\n", &["lab.toml:2:10: publishing.allow[0] = '10.1.2.3/16'", "10.1.0.0/16"]),
    // Motions
    ("[[twin.motion]]\naxis = 'roll'\nkind = 'step'\namount_um = 1\n",
        &["lab.toml:1:1: twin.motion[0].amount_urad = absent: allowed is a number", "lab.toml:4:13: twin.motion[0].amount_um = 1: allowed is absent: a rotation has amount_urad"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'step'\namount_urad = 1\n", &["twin.motion[0].amount_um = absent", "lab.toml:4:15: twin.motion[0].amount_urad = 1: allowed is absent: a translation has amount_um"]),
    ("[twin]\nmotion = [{axis = 'tx', kind = 'step', amount_um = 1},\n {axis = 'tx', kind = 'ramp', amount_um = 99999, until_s = 1}]\n", &["lab.toml:3:43: twin.motion[1].amount_um = 99999: allowed is -10000 to 10000"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'ramp'\namount_um = 1\n", &["lab.toml:1:1: twin.motion[0].until_s = absent: allowed is a number: a ramp needs it"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'sine'\namount_um = 1\n", &["twin.motion[0].frequency_hz = absent: allowed is a number: a sine needs it"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'step'\namount_um = 1\nfrequency_hz = 2\n", &["lab.toml:5:16: twin.motion[0].frequency_hz = 2: allowed is absent: a step has no such key"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'step'\namount_um = 1\nfrom_s = 3\nuntil_s = 2\n", &["lab.toml:6:11: twin.motion[0].until_s = 2: allowed is later than from_s, 3"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'vibration'\namount_um = 1\nfrequency_hz = 10\nhigh_hz = 500\n", &["lab.toml:6:11: twin.motion[0].high_hz = 500: allowed is below half of acquisition.rate_hz, 500"]),
    ("[[twin.motion]]\naxis = 'tx'\nkind = 'vibration'\namount_um = -1\nfrequency_hz = 10\nhigh_hz = 5\n", &["lab.toml:4:13: twin.motion[0].amount_um = -1: allowed is 0 or more", "lab.toml:6:11: twin.motion[0].high_hz = 5: allowed is more than frequency_hz, 10"]),
];

#[test]
fn bad_files_are_refused_with_place_key_and_what_is_allowed() {
    for (text, parts) in BAD {
        let message = refusal(text);
        for part in *parts {
            assert!(message.contains(part), "{text}\nmessage: {message}\nexpected: {part}");
        }
    }
}

#[test]
fn all_values_out_of_range_are_reported_in_the_order_of_the_file() {
    let message = refusal("[twin]\nbow_um = 2e4\n[head]\npsd_size_mm = 0\n[acquisition]\nrate_hz = 1e6\n");
    let lines: Vec<_> = message.lines().map(|line| line.split(" = ").next().unwrap()).collect();
    assert_eq!(
        lines,
        [
            "lab.toml:2:10: twin.bow_um",
            "lab.toml:4:15: head.psd_size_mm",
            "lab.toml:6:11: acquisition.rate_hz"
        ]
    );
}

/// Without a conflict that exists only because a wrong entry has no effect.
#[test]
fn unknown_keys_and_wrong_types_are_reported_with_the_values_out_of_range() {
    let message = refusal(
        "[head]\npsd_sise_mm = 13\npsd_distance_mm = -5\n[steering]\nfull_scale_um = 300\nlimt_um = 200\n\
         lease_ms = '5'\n[[twin.motion]]\naxis = 'tx'\nkind = 'step'\namount_um = 99999\nform_s = 1\n\
         [acquisition]\nrate_hz = 0\n[frams]\nx = 1\n",
    );
    let lines: Vec<Vec<&str>> =
        message.lines().map(|line| line.split([' ', ';']).take(2).collect()).collect();
    let expected: [[&str; 2]; 8] = [
        ["lab.toml:2:1:", "head.psd_sise_mm"],
        ["lab.toml:3:19:", "head.psd_distance_mm"],
        ["lab.toml:6:1:", "steering.limt_um"],
        ["lab.toml:7:12:", "steering.lease_ms"],
        ["lab.toml:11:13:", "twin.motion[0].amount_um"],
        ["lab.toml:12:1:", "twin.motion[0].form_s"],
        ["lab.toml:14:11:", "acquisition.rate_hz"],
        ["lab.toml:15:2:", "frams"],
    ];
    assert_eq!(lines, expected, "{message}");
}

#[test]
fn an_empty_file_is_the_defaults() {
    assert_eq!(parse("", None).unwrap(), Config::default());
}

#[test]
fn valid_files_set_the_configured_values() {
    let config = parse(
        "acquisition = {source = 'serial', rate_hz = 100}\n\
         [publishing]\ntcp = 'off'\nudp = []\n\
         [twin]\nmotion = []\nsteering.readback_noise_um = 'off'\n\
         [[twin.fault]]\nat_s = 1\nfor_s = 2.5\nkind = 'dropped'\nfraction = 0.5\n",
        None,
    )
    .unwrap();
    assert_eq!(config.acquisition.source, SourceKind::Serial);
    assert_eq!(config.acquisition.board().unwrap().to_string(), "/dev/ttyACM0");
    let board = |text: &str| parse(text, None).unwrap().acquisition.board().unwrap().to_string();
    assert_eq!(board("acquisition = {source = 'board', address = 'daq:1'}"), "daq:1");
    assert_eq!(board("acquisition = {source = 'board', socket = '/run/b'}"), "unix:/run/b");
    assert_eq!(board("acquisition = {source = 'board', port = '/dev/b', serial.port = '/dev/c'}"), "/dev/b");
    assert_eq!(config.publishing.tcp, None);
    assert!(config.publishing.udp.is_empty() && config.twin.motion.is_empty());
    assert_eq!(config.twin.steering.readback_noise_um, None);
    assert_eq!(config.twin.channel_count(), 9);
    assert_eq!(config.twin.fault[0].for_s, Some(2.5));
    let off = |text: &str| parse(text, None).unwrap();
    assert_eq!(off("twin.steering.readback_noise_um = 1").twin.steering.readback_noise_um, Some(1.0));
}

#[test]
fn a_file_with_a_byte_order_mark_is_read_and_another_encoding_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.toml");
    let load = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        trifacet::config::load(Some(&file))
    };
    let config = load("\u{feff}acquisition.rate_hz = 50\r\n# \u{b5}m".as_bytes()).unwrap();
    assert_eq!(config.acquisition.rate_hz, 50.0);
    // The place does not count the byte order mark.
    let error = load("\u{feff}acquisition.rate = 50\r\n".as_bytes()).unwrap_err().to_string();
    assert!(error.contains("lab.toml:1:13: acquisition.rate is not a key"), "{error}");
    let utf16: Vec<u8> = "\u{feff}[log]".encode_utf16().flat_map(u16::to_le_bytes).collect();
    for (bytes, told) in [
        (&utf16[..], "lab.toml:1:1: the text is in UTF-16; allowed is UTF-8"),
        (&utf16[2..], "lab.toml:1:2: a zero byte: the text is in UTF-16"),
        (
            b"# ok\n# 5 \xb5m",
            "lab.toml:2:5: the byte 0xb5 is not UTF-8; in Latin-1 and Windows-1252 it is \"\u{b5}\"",
        ),
    ] {
        let error = load(bytes).unwrap_err().to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn a_correction_table_of_a_spreadsheet_is_read_and_errors_have_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.toml");
    std::fs::write(&file, "channels.a.correction = 'a.csv'\n").unwrap();
    let points = "u_m,v_m,du_m,dv_m\n-0.007,-0.007,1.5e-6,0\n0.007,-0.007,1.5e-6,0\n-0.007,0.007,1.5e-6,0\n0.007,0.007,1.5e-6,0\n";
    let read = |text: &str| {
        std::fs::write(folder.path().join("a.csv"), text).unwrap();
        trifacet::config::load(Some(&file)).unwrap().read_channels()
    };
    let plain = read(points).unwrap();
    let german = points.replace(',', ";").replace('.', ",").replace('\n', "\r\n");
    let read_german = read(&format!("\u{feff}{german}")).unwrap();
    assert_eq!(format!("{read_german:?}"), format!("{plain:?}"));
    let error = read(&format!("# by hand\n{points}0,1,2,3,4\n")).unwrap_err().to_string();
    assert!(error.contains("a.csv:7: 5 fields where the header has 4"), "{error}");
}

#[test]
fn a_missing_file_is_an_error_with_its_name() {
    let error = trifacet::config::load(Some(Path::new("/no/such/lab.toml"))).unwrap_err();
    assert!(matches!(error, ConfigError::Unreadable { .. }));
    assert!(error.to_string().contains("/no/such/lab.toml"), "{error}");
}

#[test]
fn a_correction_table_is_found_beside_the_file_and_changes_the_fingerprint() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("lab.toml");
    let table = folder.path().join("a.csv");
    std::fs::write(&table, "u_m,v_m,du_m,dv_m\n").unwrap();
    std::fs::write(&file, "channels.a.correction = 'a.csv'\n").unwrap();
    let config = trifacet::config::load(Some(&file)).unwrap();
    assert_eq!(config.channels.a.correction.as_deref(), Some(table.as_path()));

    let before = config.config_id().unwrap();
    assert_ne!(before, Config::default().config_id().unwrap());
    std::fs::write(&table, "u_m,v_m,du_m,dv_m\n1,1,1,1\n").unwrap();
    assert_ne!(config.config_id().unwrap(), before);
}

#[test]
fn the_fingerprint_depends_on_geometry_calibration_and_frames_only() {
    let id = |text: &str| parse(text, None).unwrap().config_id().unwrap();
    // This number is part of the format: it must be the same in every version and on every machine.
    assert_eq!(id(""), 3_635_944_138, "the defaults");
    assert_eq!(id("acquisition.rate_hz = 50\nlog.level = 'warn'\ntwin.seed = 3"), id(""));
    assert_eq!(id("frames.base.rotation_deg = [-0.0, 0, 0]"), id(""), "frames that change nothing");
    assert_eq!(id("frames.tool.translation_mm = [0, 0, -40]"), 3_360_922_473, "a tool frame");
    for text in [
        "head.psd_distance_mm = 250.0000001",
        "channels.b.gain = [1, -1, 1]",
        "channels.a.dark_v = [0.0, 0.0, 1e-6]",
        "frames.tool.translation_mm = [0, 0, 1e-7]",
        "frames.base.translation_mm = [0, 0, 1e-7]",
        "frames.tare.rotation_deg = [0, 0, 1e-9]",
    ] {
        assert_ne!(id(text), id(""), "{text}");
    }
}
