#!/usr/bin/python3
"""A LinuxCNC HAL component that receives the datagrams of a trifacet daemon and sets pins.

    loadusr -Wn trifacet trifacet_hal.py [--name trifacet] [--port PORT] [--divider N]

trifacet.py must be in the same folder or on PYTHONPATH. docs/clients.md describes the pins.
"""

import argparse
import math
import select
import socket
import time

import hal

import trifacet

AXES = ("tx", "ty", "tz", "roll", "pitch", "yaw")
LOCKED = trifacet.LOCK_STATES.index("locked")
NOT_REAL = trifacet.SIMULATED | trifacet.REPLAYED
POLL = 0.002  # seconds; the age of a frame may be overestimated by this time
# Seconds from the fall of `valid` until the numbers become NaN. Every realtime thread must see the fall first: otherwise a
# NaN could pass a gate that is about to close, and a ramp or filter behind the gate would keep it.
NAN_DELAY = 0.02


class Source:
    """The newest frame and its age, measured with the clock of this machine."""

    def __init__(self, port, divider):
        self.stream = trifacet.udp(port, divider=divider)
        self.stream.socket.setblocking(False)
        self.frame = None
        self.losses = self.stream.losses
        self._newest_came_after = self._empty_at = time.monotonic()

    def poll(self):
        """Waits a short time for datagrams, then reads all that have arrived."""
        select.select([self.stream.socket], [], [], POLL)
        while True:
            try:
                data = self.stream.socket.recv(trifacet.FRAME_SIZE + 1)
            except BlockingIOError:
                self._empty_at = time.monotonic()
                return
            try:
                frame = trifacet.Frame.decode(data)
            except trifacet.FrameError:
                self.losses.damaged += len(data)
                continue
            if self.losses.in_order(frame):
                self.frame = frame
                # The waiting time in the buffer is unknown, but began after the buffer was last empty.
                self._newest_came_after = self._empty_at

    def age(self):
        if self.frame is None:
            return math.inf
        return time.monotonic() - self._newest_came_after + self.frame.send_delay_ns * 1e-9


class Pins:
    """The pins of the component. Before the first frame, numbers are NaN and `valid` is false."""

    def __init__(self, name):
        self.hal = h = hal.component(name)
        self.valid_until = -math.inf
        for pin in ("valid", "locked", "simulated", "heartbeat"):
            h.newpin(pin, hal.HAL_BIT, hal.HAL_OUT)
        for pin in ("status", "lock", "missed", "late", "damaged"):
            h.newpin(pin, hal.HAL_U32, hal.HAL_OUT)
        for pin in AXES + tuple("sd-" + axis for axis in AXES) + ("age",):
            h.newpin(pin, hal.HAL_FLOAT, hal.HAL_OUT)
        for name, kind, default in (
            ("max-age", hal.HAL_FLOAT, 0.02),
            ("linear-units-per-m", hal.HAL_FLOAT, 1000.0),
            ("angular-units-per-rad", hal.HAL_FLOAT, 180.0 / math.pi),
            ("allow-simulated", hal.HAL_BIT, False),
        ):
            h.newparam(name, kind, hal.HAL_RW)
            h[name] = default
        h["age"] = math.inf
        self.set_pose((math.nan,) * 6, (math.nan,) * 6)

    def usable(self, frame, age):
        h = self.hal
        forbidden = trifacet.UNUSABLE & ~NOT_REAL if h["allow-simulated"] else trifacet.UNUSABLE
        return frame is not None and frame.valid and not frame.status & forbidden and age <= h["max-age"]

    def update(self, frame, age, losses):
        """Sets all pins."""
        h, now = self.hal, time.monotonic()
        usable = self.usable(frame, age)
        if usable:
            self.valid_until = now
            self.set_pose(frame.position + frame.rotation, frame.sd_position + frame.sd_rotation)
        elif now - self.valid_until > NAN_DELAY:
            self.set_pose((math.nan,) * 6, (math.nan,) * 6)
        if frame is not None:
            h["status"] = frame.status
            h["lock"] = frame.lock
            h["locked"] = usable and frame.lock == LOCKED
            h["simulated"] = bool(frame.status & NOT_REAL)
        for name in ("missed", "late", "damaged"):
            h[name] = getattr(losses, name) & 0xFFFFFFFF
        h["age"] = age
        h["heartbeat"] = not h["heartbeat"]
        h["valid"] = usable  # last: when it rises, the numbers are already set

    def set_pose(self, pose, deviations):
        h = self.hal
        scales = (h["linear-units-per-m"],) * 3 + (h["angular-units-per-rad"],) * 3
        for axis, scale, value, deviation in zip(AXES, scales, pose, deviations):
            h[axis] = value * scale
            h["sd-" + axis] = deviation * scale


def main():
    parser = argparse.ArgumentParser(description="The poses of a trifacet daemon as HAL pins")
    parser.add_argument("--name", default="trifacet", help="name of the component")
    parser.add_argument("--port", type=int, default=7362, help="UDP port to which the daemon sends")
    parser.add_argument("--divider", type=int, default=1, help="divider of this target in the daemon's configuration")
    arguments = parser.parse_args()
    source = Source(arguments.port, arguments.divider)
    pins = Pins(arguments.name)
    pins.hal.ready()
    try:
        while True:
            source.poll()
            pins.update(source.frame, source.age(), source.losses)
    except KeyboardInterrupt:
        pass
    finally:
        pins.hal.exit()


if __name__ == "__main__":
    main()
