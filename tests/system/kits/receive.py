"""Reads a stream with the kit and prints a summary as a line of JSON: receive.py udp|tcp PORT COUNT DIVIDER"""

import json
import sys

import trifacet

kind, port, count, divider = sys.argv[1], *map(int, sys.argv[2:])
stream = trifacet.udp(port, divider=divider, silence=60) if kind == "udp" else trifacet.tcp(
    port=port, divider=divider, silence=60)
print("port", stream.port if kind == "udp" else port, flush=True)
told = {"sequences": [], "valid": 0, "usable": 0, "simulated": 0, "future": 0}
with stream:
    try:
        for frame in stream:
            told["sequences"].append(frame.sequence)
            told["valid"] += frame.valid
            told["usable"] += frame.usable(max_age=3600.0)
            told["simulated"] += frame.usable(max_age=3600.0, simulated=True)
            told["future"] += frame.age() < -0.01
            if len(told["sequences"]) == count:
                break
    except (trifacet.Closed, trifacet.VersionError) as end:
        told["end"] = type(end).__name__ + ": " + str(end)
losses = stream.losses
told.update(missed=losses.missed, late=losses.late, damaged=losses.damaged)
if kind == "tcp":
    told.update(descriptor=stream.descriptor, heartbeat=stream.heartbeat)
print(json.dumps(told))
