"""Decodes the pose stream of a trifacet daemon. Python 3.9 or later, standard library only.

    import trifacet

    for frame in trifacet.udp(7362):
        if frame.usable(max_age=0.02):
            print(frame.position, frame.rotation)

Unknown numbers are NaN. docs/stream.md describes every field, docs/clients.md their use.
"""

import collections
import json
import math
import socket
import struct
import time
import zlib
from typing import NamedTuple, Tuple

MAJOR = 1
FRAME_SIZE = 192
CLOCK_UNKNOWN = 65535

STATUS_BITS = (
    "POSE_VALID", "PSD_A_LOW", "PSD_B_LOW", "PSD_C_LOW", "PSD_A_CLIPPED", "PSD_B_CLIPPED", "PSD_C_CLIPPED",
    "PSD_A_EDGE", "PSD_B_EDGE", "PSD_C_EDGE", "UNBALANCED", "NOT_LOCKED", "STEERING_RAILED", "NOT_CONVERGED",
    "OUT_OF_RANGE", "SAMPLE_GAP", "SOURCE_DOWN", "CLOCK_UNSYNCED", "UNCALIBRATED", "INCONSISTENT", "SIMULATED",
    "REPLAYED", "POSE_HELD", "STEERING_MEASURED", "RECORDING_FAULT", "POWER_STEP", "CHANNEL_FROZEN", "POWER_NOISY",
    "OUT_OF_CALIBRATION",
)  # from bit 0
LOCK_STATES = ("off", "manual", "searching", "acquiring", "locked", "railed", "lost", "held")  # from 0

POSE_VALID = 1 << STATUS_BITS.index("POSE_VALID")
SIMULATED = 1 << STATUS_BITS.index("SIMULATED")
REPLAYED = 1 << STATUS_BITS.index("REPLAYED")
# Bits with which a pose is not usable for control.
UNUSABLE = sum(1 << STATUS_BITS.index(name) for name in (
    "INCONSISTENT", "OUT_OF_CALIBRATION", "CLOCK_UNSYNCED", "POSE_HELD", "REPLAYED", "SIMULATED"))

_HEADER = struct.Struct("<4sBBH")  # magic, major, minor, size: the beginning of every message
_BODY = struct.Struct("<IIQQqIIIHBB 3d3d 3f3f 2ff HH 2f2f2f 3f2f")
_CRC = struct.Struct("<I")
_LONGEST_PERIOD = 65.0  # seconds; a block of 60 000 samples at 1 kHz takes 60 s
_RECEIVE_BUFFER = 1 << 20  # the Linux default holds 256 frames, which arrive in 26 ms at 10 kHz


class FrameError(ValueError):
    """The bytes are not a pose frame, or a damaged one."""


class VersionError(FrameError):
    """The daemon uses another major version: its frames cannot be decoded."""


class Silence(TimeoutError):
    """No frame arrived in time. Reading the stream may continue."""


class Closed(ConnectionError):
    """The daemon closed the stream or refused it. The message contains the reason."""


class Frame(NamedTuple):
    """A pose frame. Metres, radians, watts, nanoseconds."""

    session: int
    config: int
    sequence: int
    sample_index: int
    time_ns: int
    solve_delay_ns: int
    send_delay_ns: int
    status: int
    clock_quality: int
    lock: int
    iterations: int
    position: Tuple[float, float, float]
    rotation: Tuple[float, float, float]
    sd_position: Tuple[float, float, float]
    sd_rotation: Tuple[float, float, float]
    beam_offset: Tuple[float, float]
    steering_residual: float
    averaged: int
    lost: int
    spot_a: Tuple[float, float]
    spot_b: Tuple[float, float]
    spot_c: Tuple[float, float]
    power_a: float
    power_b: float
    power_c: float
    steering_x: float
    steering_y: float

    @classmethod
    def decode(cls, data):
        """Decodes 192 bytes. Raises FrameError if they are not a frame, or a damaged one."""
        if len(data) < _HEADER.size:
            raise FrameError(f"a pose frame has {FRAME_SIZE} bytes, not {len(data)}")
        magic, major, minor, size = _HEADER.unpack_from(data)
        if magic != b"TFP1":
            raise FrameError(f"a pose frame starts with b'TFP1', not {magic!r}")
        if major != MAJOR:
            raise VersionError(f"the frame has layout version {major}.{minor}; this program reads {MAJOR}.x")
        if len(data) != FRAME_SIZE or size != FRAME_SIZE:
            raise FrameError(f"a pose frame has {FRAME_SIZE} bytes, not {len(data)} with the size field {size}")
        (crc,) = _CRC.unpack_from(data, FRAME_SIZE - _CRC.size)
        if zlib.crc32(data[:-_CRC.size]) != crc:
            raise FrameError("wrong CRC: the frame was damaged in transmission")
        v = _BODY.unpack_from(data, _HEADER.size)
        if v[9] >= len(LOCK_STATES):
            raise FrameError(f"{v[9]} is not a lock state; they are 0 to {len(LOCK_STATES) - 1}")
        return cls(*v[:11], v[11:14], v[14:17], v[17:20], v[20:23], v[23:25], v[25], v[26], v[27],
                   v[28:30], v[30:32], v[32:34], *v[34:])

    @property
    def valid(self):
        """Whether the frame contains a valid pose. See also `usable`."""
        return bool(self.status & POSE_VALID)

    @property
    def status_names(self):
        return [name for bit, name in enumerate(STATUS_BITS) if self.status >> bit & 1]

    @property
    def lock_name(self):
        return LOCK_STATES[self.lock]

    @property
    def clock_sigma(self):
        """Standard uncertainty of `time_ns` on the daemon's clock, seconds; NaN if unknown. Compare it with your
        tolerance for the time, such as the tolerable position error divided by the velocity of the axis."""
        return math.nan if self.clock_quality == CLOCK_UNKNOWN else self.clock_quality * 1e-7

    def age(self):
        """Seconds since the light was measured. Correct only if the clocks of both machines agree."""
        return (time.time_ns() - self.time_ns) * 1e-9

    def usable(self, max_age, simulated=False):
        """Whether a machine may act on this pose: it is valid, no bit of `UNUSABLE` is set, and its age is within plus
        and minus `max_age` seconds. `simulated` permits SIMULATED and REPLAYED, for tests. A negative age means that
        the clocks do not agree. Whether the beam is on the apex is a separate question: see `lock`.
        """
        forbidden = UNUSABLE & ~(SIMULATED | REPLAYED) if simulated else UNUSABLE
        return self.valid and not self.status & forbidden and abs(self.age()) <= max_age


class Losses:
    """Losses in transmission, counted by the reader."""

    def __init__(self, divider=1):
        self.divider = divider  # only frames whose sequence number is a multiple of it are sent
        self.missed = 0   # frames missing in the sequence
        self.late = 0     # frames that arrived after a newer one, or twice; never returned
        self.damaged = 0  # bytes outside of undamaged messages
        self._last = None

    def in_order(self, frame):
        """Counts losses. Returns False if a newer frame has arrived before."""
        if self._last is not None and self._last[0] == frame.session:
            gap = frame.sequence // self.divider - self._last[1]
            if gap <= 0:
                self.late += 1
                return False
            self.missed += gap - 1
        self._last = (frame.session, frame.sequence // self.divider)  # a different session: the daemon was restarted
        return True

    def __repr__(self):
        return f"missed={self.missed} late={self.late} damaged={self.damaged}"


class _Stream:
    """Iterates over frames and counts `losses`. Reading may continue after Silence was raised."""

    def __init__(self, sock, divider):
        self.socket = sock
        self.losses = Losses(divider)

    def __iter__(self):
        return self

    def __next__(self):
        while True:
            frame = self._next_frame()
            if self.losses.in_order(frame):
                return frame

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self.socket.close()


class udp(_Stream):
    """Frames that a daemon sends to this port. Raises Silence if no frame arrives for `silence` seconds.

    By default, this is three times the longest of the last intervals between frames, but at least 1 s. Before the
    second frame it is 65 s, because frames can be rare (`estimation.average`).

    `divider` must be that of this target in the daemon's configuration, so that losses are counted correctly.
    """

    def __init__(self, port, host="0.0.0.0", divider=1, silence=None):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_DGRAM)
        # The system limits this to net.core.rmem_max without an error.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        sock.bind((host, port))
        super().__init__(sock, divider)
        self.silence = silence
        self.port = sock.getsockname()[1]
        self._arrival = None
        self._intervals = collections.deque(maxlen=8)  # frames that waited for the program arrive without an interval

    def _limit(self):
        if self.silence is not None:
            return self.silence
        return max(1.0, 3 * max(self._intervals)) if self._intervals else _LONGEST_PERIOD

    def _arrived(self):
        now = time.monotonic()
        if self._arrival is not None:
            self._intervals.append(now - self._arrival)
        self._arrival = now

    def _next_frame(self):
        limit = self._limit()
        deadline = time.monotonic() + limit
        while True:
            left = deadline - time.monotonic()
            if left <= 0:
                raise Silence(f"no frame on UDP port {self.port} for {limit:g} s: is the daemon running, and is "
                              "this address among its [publishing] udp targets?")
            self.socket.settimeout(left)
            try:
                data = self.socket.recv(FRAME_SIZE + 1)  # a longer datagram must not look like a frame
            except socket.timeout:
                continue
            try:
                frame = Frame.decode(data)
            except VersionError:
                raise
            except FrameError:
                self.losses.damaged += len(data)
            else:
                self._arrived()
                return frame


class tcp(_Stream):
    """Frames from a daemon's TCP server, every `divider`-th one.

    `descriptor` and `heartbeat` are the last such messages of the daemon; heartbeat["dropped"] is the number of
    frames that the daemon dropped because this client was too slow.
    Raises Silence if nothing arrives for `silence` seconds, not even a heartbeat, and Closed at the end.
    """

    def __init__(self, host="127.0.0.1", port=7361, divider=1, silence=3.0):
        super().__init__(socket.create_connection((host, port), timeout=silence), divider)
        self.descriptor = None
        self.heartbeat = None
        self.silence = silence
        self._buffer = bytearray()
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.sendall(f"stream format=binary divider={divider}\n".encode("ascii"))

    def _next_frame(self):
        while True:
            message = self._next_message()
            kind = message[:4]
            if kind == b"TFP1":
                return Frame.decode(message)
            if kind == b"TFD1":
                self.descriptor = _json(message)
            elif kind == b"TFH1":
                self.heartbeat = _json(message)
            elif kind == b"TFE1":
                raise Closed(_json(message)["error"])

    def _next_message(self):
        """The next undamaged message. Skips bytes that do not belong to one."""
        while True:
            if len(self._buffer) < _HEADER.size:
                self._receive()
                continue
            magic, major, minor, size = _HEADER.unpack_from(self._buffer)
            if magic == b"erro":
                self._refused()
            pose = magic == b"TFP1" and major == MAJOR
            if not magic.startswith(b"TF") or size < _HEADER.size + _CRC.size or (pose and size != FRAME_SIZE):
                self._skip()
                continue
            if len(self._buffer) < size:
                self._receive()
                continue
            message = bytes(self._buffer[:size])
            (crc,) = _CRC.unpack_from(message, size - _CRC.size)
            if zlib.crc32(message[:-_CRC.size]) != crc:
                self._skip()
                continue
            del self._buffer[:size]
            if major != MAJOR:
                raise VersionError(f"the daemon speaks version {major}.{minor}; this program reads {MAJOR}.x")
            return message

    def _receive(self):
        try:
            data = self.socket.recv(1 << 16)
        except socket.timeout:
            raise Silence(f"no message, not even a heartbeat, for {self.silence} s: is the network up, and is a "
                          "trifacet daemon listening at this address?") from None
        if not data:
            raise Closed("the daemon closed the stream")
        self._buffer += data

    def _refused(self):
        """The daemon refuses this client with a line of text that contains the reason."""
        while b"\n" not in self._buffer:
            self._receive()
        raise Closed(self._buffer.split(b"\n")[0].decode("ascii", "replace").strip())

    def _skip(self):
        place = self._buffer.find(b"T", 1)
        place = len(self._buffer) if place < 0 else place
        self.losses.damaged += place
        del self._buffer[:place]


def _json(message):
    return json.loads(message[_HEADER.size:-_CRC.size])


def dtype():
    """The layout of a frame for NumPy: `numpy.frombuffer(data, trifacet.dtype())["position"]`.

    For arrays of many frames. It checks neither the CRC nor any status bit.
    """
    import numpy

    layout = numpy.dtype([
        ("magic", "S4"), ("major", "u1"), ("minor", "u1"), ("size", "<u2"),
        ("session", "<u4"), ("config", "<u4"), ("sequence", "<u8"), ("sample_index", "<u8"), ("time_ns", "<i8"),
        ("solve_delay_ns", "<u4"), ("send_delay_ns", "<u4"), ("status", "<u4"), ("clock_quality", "<u2"),
        ("lock", "u1"), ("iterations", "u1"),
        ("position", "<f8", 3), ("rotation", "<f8", 3), ("sd_position", "<f4", 3), ("sd_rotation", "<f4", 3),
        ("beam_offset", "<f4", 2), ("steering_residual", "<f4"), ("averaged", "<u2"), ("lost", "<u2"),
        ("spot_a", "<f4", 2), ("spot_b", "<f4", 2), ("spot_c", "<f4", 2),
        ("power_a", "<f4"), ("power_b", "<f4"), ("power_c", "<f4"), ("steering_x", "<f4"), ("steering_y", "<f4"),
        ("crc", "<u4"),
    ])
    assert layout.itemsize == FRAME_SIZE
    return layout
