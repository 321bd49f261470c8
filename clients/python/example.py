"""Prints ten poses per second, or the reason for a missing pose: example.py [udp PORT | tcp HOST PORT]"""

import sys
import time

import trifacet


def open_stream(arguments):
    if not arguments:
        return trifacet.udp(7362)
    if arguments[0] == "udp" and len(arguments) == 2:
        return trifacet.udp(int(arguments[1]))
    if arguments[0] == "tcp" and len(arguments) == 3:
        return trifacet.tcp(arguments[1], int(arguments[2]))
    sys.exit(__doc__)


def main(arguments):
    shown = 0.0
    with open_stream(arguments) as stream:
        for frame in stream:
            if time.monotonic() - shown < 0.1:
                continue
            shown = time.monotonic()
            if frame.valid:
                numbers = [f"{1e6 * x:9.3f}" for x in frame.position + frame.rotation]
                print(*numbers, "um, urad", frame.lock_name, stream.losses, flush=True)
            else:
                print("no pose:", *frame.status_names, flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except (trifacet.Silence, trifacet.Closed) as end:
        sys.exit(f"example.py: {end}")
    except KeyboardInterrupt:
        pass
