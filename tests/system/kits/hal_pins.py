"""Waits until an expression of HAL pins is true at one moment: hal_pins.py 'valid and not locked'

Pins of the component stand without its name, the others with theirs; `-` and `.` are `_`. At no moment may a NaN get
past the gate of example.hal.
"""

import math
import subprocess
import sys
import time

PATIENCE = 60.0


def value(kind, text):
    if kind == "bit":
        return text == "TRUE"
    return float(text) if kind == "float" else int(text, 0)


def pins():
    lines = subprocess.run(["halcmd", "-s", "show", "pin"], check=True, capture_output=True, text=True).stdout
    rows = [line.split() for line in lines.splitlines() if line.strip()]
    names = [row[4].removeprefix("trifacet.").replace(".", "_").replace("-", "_") for row in rows]
    return {name: value(row[1], row[3]) for name, row in zip(names, rows)}


expression = " ".join(sys.argv[1].split())
end = time.monotonic() + PATIENCE
while True:
    now = pins()
    if math.isnan(now["choose_out"]) or math.isnan(now["ramp_out"]):
        sys.exit(f"a NaN got past the gate: {now}")
    if eval(expression, {"isnan": math.isnan, "inf": math.inf}, now):
        break
    if time.monotonic() > end:
        sys.exit(f"within {PATIENCE} s never {expression}; now {now}")
    time.sleep(0.01)
