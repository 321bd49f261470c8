#!/usr/bin/python3
"""A LinuxCNC HAL component that turns the datagrams of a trifacet daemon into pins.

    loadusr -W trifacet_hal.py [--name NAME] [--port PORT] [--divider N]

trifacet.py must lie beside this file or on PYTHONPATH. docs/clients.md describes the pins.
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
POLL = 0.002  # seconds; a frame's age may be overestimated by so much


class Source:
    """The newest frame, and how long ago its light was measured, on this machine's own clock."""

    def __init__(self, port, divider):
        self.stream = trifacet.udp(port, divider=divider)
        self.stream.socket.setblocking(False)
        self.frame = None
        self.losses = self.stream.losses
        self._newest_came_after = self._empty_at = time.monotonic()

    def poll(self):
        """Waits for datagrams, for a moment; then reads all that are there."""
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
                self.losses.damaged += 1
                continue
            if self.losses.in_order(frame):
                self.frame = frame
                # How long a datagram waited in the buffer nobody knows, but not since before it was empty.
                self._newest_came_after = self._empty_at

    def age(self):
        if self.frame is None:
            return math.inf
        return time.monotonic() - self._newest_came_after + self.frame.send_delay_ns * 1e-9


def new_component(name):
    """Makes all pins. Until the first frame, numbers are NaN and nothing is valid."""
    h = hal.component(name)
    for axis in AXES:
        h.newpin(axis, hal.HAL_FLOAT, hal.HAL_OUT)
        h.newpin("sd-" + axis, hal.HAL_FLOAT, hal.HAL_OUT)
        h[axis] = h["sd-" + axis] = math.nan
    for pin in ("valid", "locked", "simulated", "heartbeat"):
        h.newpin(pin, hal.HAL_BIT, hal.HAL_OUT)
    for pin in ("status", "lock", "missed", "late", "damaged"):
        h.newpin(pin, hal.HAL_U32, hal.HAL_OUT)
    h.newpin("age", hal.HAL_FLOAT, hal.HAL_OUT)
    h["age"] = math.inf
    h.newparam("max-age", hal.HAL_FLOAT, hal.HAL_RW)
    h["max-age"] = 0.02
    h.newparam("linear-units-per-m", hal.HAL_FLOAT, hal.HAL_RW)
    h["linear-units-per-m"] = 1000.0
    h.newparam("angular-units-per-rad", hal.HAL_FLOAT, hal.HAL_RW)
    h["angular-units-per-rad"] = 180.0 / math.pi
    h.newparam("allow-simulated", hal.HAL_BIT, hal.HAL_RW)
    return h


def set_pins(h, source):
    """`valid` falls before a number becomes unusable, and rises after all numbers are there."""
    frame, age = source.frame, source.age()
    usable = (frame is not None and frame.valid and age <= h["max-age"]
              and (h["allow-simulated"] or not frame.status & NOT_REAL))
    h["age"] = age
    if not usable:
        h["valid"] = False
    linear, angular = h["linear-units-per-m"], h["angular-units-per-rad"]
    pose = frame.position + frame.rotation if usable else (math.nan,) * 6
    deviations = frame.sd_position + frame.sd_rotation if usable else (math.nan,) * 6
    for axis, scale, value, deviation in zip(AXES, (linear,) * 3 + (angular,) * 3, pose, deviations):
        h[axis] = value * scale
        h["sd-" + axis] = deviation * scale
    if frame is not None:
        h["status"] = frame.status
        h["lock"] = frame.lock
        h["locked"] = usable and frame.lock == LOCKED
        h["simulated"] = bool(frame.status & NOT_REAL)
    h["missed"] = source.losses.missed & 0xffffffff
    h["late"] = source.losses.late & 0xffffffff
    h["damaged"] = source.losses.damaged & 0xffffffff
    h["heartbeat"] = not h["heartbeat"]
    h["valid"] = usable


def main():
    parser = argparse.ArgumentParser(description="The poses of a trifacet daemon as HAL pins")
    parser.add_argument("--name", default="trifacet", help="of the component")
    parser.add_argument("--port", type=int, default=7362, help="UDP port to which the daemon sends")
    parser.add_argument("--divider", type=int, default=1, help="of this target in the daemon's configuration")
    arguments = parser.parse_args()
    source = Source(arguments.port, arguments.divider)
    component = new_component(arguments.name)
    component.ready()
    try:
        while True:
            source.poll()
            set_pins(component, source)
    except KeyboardInterrupt:
        pass
    finally:
        component.exit()


if __name__ == "__main__":
    main()
