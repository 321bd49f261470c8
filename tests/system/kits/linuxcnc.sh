#!/usr/bin/env bash
# The LinuxCNC component under the real HAL, against a running daemon.
#
#     tests/system/kits/linuxcnc.sh [path of trifacet]
#
# Needs Debian's linuxcnc-uspace, and installs it if run as root.
set -euo pipefail
cd "$(dirname "$0")/../../.."

fail() {
    echo "linuxcnc.sh: $*" >&2
    exit 1
}

if ! command -v halrun >/dev/null; then
    [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null ||
        fail "halrun is missing, and only root can install it: apt-get install linuxcnc-uspace"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends linuxcnc-uspace >/dev/null ||
        fail "linuxcnc-uspace cannot be installed from the package sources of this system"
fi
if [ $# -gt 0 ]; then
    trifacet=$1
else
    cargo build --quiet
    trifacet=target/debug/trifacet
fi

work=$(mktemp -d)
daemon=
hal=
finish() {
    if [ -n "$hal" ]; then
        exec 9>&- # the end of the commands: halrun unloads everything
        for _ in $(seq 100); do
            kill -0 "$hal" 2>/dev/null || break
            sleep 0.1
        done
        ! kill -0 "$hal" 2>/dev/null || halrun -U || true
    fi
    [ -z "$daemon" ] || kill "$daemon" 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

# A machine has only one HAL, and a running one may be moving hardware.
for program in rtapi_app linuxcncsvr milltask; do
    ! pgrep -x "$program" --runstates D,I,R,S,T >/dev/null ||
        fail "$program runs on this machine: the test would disturb it"
done

# The realtime side of HAL refuses to run as root and needs a folder for its socket.
chmod 777 "$work"
export RTAPI_FIFO_PATH=$work/rtapi
[ "$(id -u)" != 0 ] || export RTAPI_UID=65534
export PATH=$PWD/clients/linuxcnc:$PATH PYTHONPATH=$PWD/clients/python PYTHONDONTWRITEBYTECODE=1

port=$(python3 -c 'import socket; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')

# The mirror is at rest at a fixed pose. The beam is blocked for three seconds of every nine.
start_daemon() {
    {
        printf 'monitor.listen = "off"\n[publishing]\ntcp = "off"\nudp = ["127.0.0.1:%s"]\n' "$port"
        printf '[[twin.motion]]\naxis = "tx"\nkind = "step"\namount_um = 30.0\n'
        printf '[[twin.motion]]\naxis = "yaw"\nkind = "step"\namount_urad = 400.0\n'
        for at in $(seq 6 9 600); do
            printf '[[twin.fault]]\nkind = "beam-blocked"\nat_s = %s.0\nfor_s = 3.0\n' "$at"
        done
    } >"$work/trifacet.toml"
    "$trifacet" run --config "$work/trifacet.toml" 2>"$work/daemon.log" 9>&- &
    daemon=$!
}

# Loads the shipped example, then runs the commands from the pipe. Ends when the pipe is closed.
start_hal() {
    mkfifo "$work/commands"
    sed "s/--port 7362/--port $port/" clients/linuxcnc/example.hal >"$work/example.hal"
    grep -q -- "--port $port" "$work/example.hal" || fail "example.hal has no port to replace"
    halrun -s -f "$work/example.hal" -I <"$work/commands" >"$work/hal.log" 2>&1 &
    hal=$!
    exec 9>"$work/commands"
    for _ in $(seq 300); do
        ! halcmd -s show funct ramp 2>/dev/null | grep -q ramp || return 0
        kill -0 "$hal" 2>/dev/null || fail "halrun ended: $(cat "$work/hal.log")"
        sleep 0.1
    done
    fail "HAL does not come up: $(cat "$work/hal.log")"
}

# becomes EXPRESSION: waits until the expression of pins is true at one moment.
becomes() { python3 tests/system/kits/hal_pins.py "$1" || fail "the pins are wrong"; }

start_hal
becomes 'ramp_maxv == 1' # near the end of the file
diff <(grep -o '^| `trifacet\.[a-z-]*`' docs/clients.md | tr -d '|` ' | sort) \
    <({ halcmd -s show pin trifacet; halcmd -s show param trifacet; } | grep -o 'trifacet\.[a-z-]*' | sort) ||
    fail "docs/clients.md has other pins and parameters than the component"
# The machine of the test may be busy, so the test checks the order of events and not their times.
halcmd setp trifacet.max-age 0.2
halcmd setp watchdog.timeout-0 2
halcmd setp watchdog.enable-in 1
becomes 'watchdog_ok_out and not valid and not good_out and isnan(tx) and isnan(sd_yaw) and age == inf'
echo "no daemon: alive, not valid, tx nan, age inf"

start_daemon
becomes 'status & 1 and simulated and age < 0.2 and not valid and isnan(tx)'
echo "computed light: not taken for real"
halcmd setp trifacet.allow-simulated 1
# 30 um in mm, 400 urad in degrees, standard uncertainties of about 1 um and 2.5 urad.
light='valid and locked and good_out and status & 1 and lock == 4 and age < 0.2
    and 0.02 < tx < 0.04 and 0.0217 < yaw < 0.0241 and 0.0005 < sd_tx < 0.002 and 0.0001 < sd_yaw < 0.0003
    and 0.02 < choose_out < 0.04 and missed == 0 and late == 0 and damaged == 0'
becomes "$light"
echo "light: valid and locked, tx and yaw as the twin has them"

for round in 1 2; do
    # No light on all three PSDs: new frames arrive, without a pose.
    becomes 'not valid and not locked and status & 15 == 14 and age < 0.2 and isnan(tx) and isnan(sd_tz)
        and not good_out and choose_out == 0'
    echo "round $round, beam blocked: valid fell, tx nan, the gate gives 0"
    becomes "$light"
    echo "round $round, light again: valid came back"
done

kill -KILL "$daemon"
wait "$daemon" 2>/dev/null || true
becomes 'not valid and isnan(tx) and choose_out == 0 and watchdog_ok_out and age > 1'
echo "daemon killed: valid fell, the age counts on"

start_daemon
becomes "$light"
echo "daemon started again: valid came back, and a restart is no loss"

python3 -c 'import socket, sys
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for _ in range(3): s.sendto(b"TFP1" + bytes(188), ("127.0.0.1", int(sys.argv[1])))' "$port"
becomes 'damaged == 576 and valid and missed == 0'
echo "foreign datagrams: refused and counted"

# A hung component leaves its pins unchanged: the watchdog must detect it.
component=$(pgrep -f "trifacet_hal.py --port $port" | head -n 1)
becomes 'valid and good_out'
kill -STOP "$component"
becomes 'not watchdog_ok_out and not good_out and choose_out == 0'
echo "component stopped: the watchdog fell, the gate gives 0"
kill -CONT "$component"
halcmd setp watchdog.enable-in 0
sleep 0.5
halcmd setp watchdog.enable-in 1
becomes 'good_out and valid'
echo "component goes on: good again"
echo "linuxcnc.sh: all right ($(dpkg-query -W -f '${Package} ${Version}' linuxcnc-uspace 2>/dev/null || echo 'linuxcnc of unknown version'))"
