#!/usr/bin/env bash
# The LinuxCNC component under the real HAL, against a running daemon.
#
#     tests/kits/linuxcnc.sh [path of trifacet]
#
# Needs Debian's linuxcnc-uspace, which it installs if it may (root).
set -euo pipefail
cd "$(dirname "$0")/../.."

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
        exec 9>&- # the end of its commands: halrun unloads everything
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

# There is one HAL on a machine, and it may be moving something.
for program in rtapi_app linuxcncsvr milltask; do
    ! pgrep -x "$program" --runstates D,I,R,S,T >/dev/null ||
        fail "$program runs on this machine: the test would disturb it"
done

# HAL's realtime side refuses to be root altogether, and wants a place for its socket.
chmod 777 "$work"
export RTAPI_FIFO_PATH=$work/rtapi
[ "$(id -u)" != 0 ] || export RTAPI_UID=65534
export PATH=$PWD/clients/linuxcnc:$PATH PYTHONPATH=$PWD/clients/python PYTHONDONTWRITEBYTECODE=1

port=$(python3 -c 'import socket; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')

# The mirror stands still at a place of its own. The beam is blocked for two seconds of every ten.
start_daemon() {
    {
        printf '[publishing]\ntcp = "off"\nudp = ["127.0.0.1:%s"]\n' "$port"
        printf '[[twin.motion]]\naxis = "tx"\nkind = "step"\namount_um = 30.0\n'
        printf '[[twin.motion]]\naxis = "yaw"\nkind = "step"\namount_urad = 400.0\n'
        for at in $(seq 8 10 300); do
            printf '[[twin.fault]]\nkind = "beam-blocked"\nat_s = %s.0\nfor_s = 2.0\n' "$at"
        done
    } >"$work/trifacet.toml"
    "$trifacet" run --config "$work/trifacet.toml" 2>"$work/daemon.log" 9>&- &
    daemon=$!
}

# Loads the shipped example, then does what comes through the pipe. Ends when the pipe is closed.
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

pin() { halcmd getp "$1" 2>/dev/null; }

# wait_for PIN VALUE: a pin becomes that, in time.
wait_for() {
    for _ in $(seq 600); do
        [ "$(pin "$1")" != "$2" ] || return 0
        sleep 0.02
    done
    halcmd show pin >&2 || true
    fail "$1 is $(pin "$1") instead of $2"
}

# within PIN LOW HIGH
within() {
    python3 -c 'import sys; name, value, low, high = sys.argv[1:]; sys.exit(
        None if float(low) <= float(value) <= float(high) else f"{name} is {value}, not within {low} and {high}")' \
        "$1" "$(pin "$1")" "$2" "$3" || fail "a pin is wrong"
}

start_hal
wait_for ramp.maxv 1 # near the end of the file
halcmd setp trifacet.max-age 0.2 # the machine of the test may be busy; what it shows is the order of things
halcmd setp watchdog.timeout-0 0.5
halcmd setp watchdog.enable-in 1
diff <(grep -o '^| `trifacet\.[a-z-]*`' docs/clients.md | tr -d '|` ' | sort) \
    <({ halcmd -s show pin trifacet; halcmd -s show param trifacet; } | grep -o 'trifacet\.[a-z-]*' | sort) ||
    fail "docs/clients.md has other pins and parameters than the component"
[ "$(pin trifacet.valid)" = FALSE ] || fail "valid before the first frame"
[ "$(pin trifacet.tx)" = nan ] || fail "tx is $(pin trifacet.tx) before the first frame, not nan"
[ "$(pin trifacet.age)" = inf ] || fail "age is $(pin trifacet.age) before the first frame, not inf"
wait_for watchdog.ok-out TRUE
echo "no daemon: alive, not valid, tx nan, age inf"

start_daemon
wait_for trifacet.simulated TRUE
[ "$(pin trifacet.valid)" = FALSE ] || fail "computed light is taken for real"
halcmd setp trifacet.allow-simulated 1
wait_for trifacet.locked TRUE
wait_for trifacet.valid TRUE
within trifacet.tx 0.02 0.04               # 0.03 mm
within trifacet.yaw 0.0217 0.0241          # 400 urad in degrees
within trifacet.sd-tx 0.0005 0.002         # about 1 um in mm
within trifacet.age 0 0.2
within choose.out 0.02 0.04
[ $(($(pin trifacet.status) & 1)) = 1 ] || fail "status is $(pin trifacet.status) without POSE_VALID"
within trifacet.lock 4 4
wait_for good.out TRUE
echo "light: valid and locked, tx $(pin trifacet.tx) mm, yaw $(pin trifacet.yaw) deg, age $(pin trifacet.age) s"

for round in 1 2; do
    wait_for trifacet.valid FALSE
    wait_for trifacet.tx nan
    wait_for good.out FALSE
    within choose.out 0 0                  # no NaN gets past the gate
    within ramp.out 0 0.04
    [ $(($(pin trifacet.status) & 15)) = 14 ] || fail "status is $(pin trifacet.status), not dark on all PSDs"
    within trifacet.age 0 0.2              # frames go on, fresh ones, without a pose
    [ "$(pin trifacet.locked)" = FALSE ] || fail "locked without light"
    echo "round $round, beam blocked: valid fell, tx nan, the gate gives $(pin choose.out)"
    wait_for trifacet.valid TRUE
    within trifacet.tx 0.02 0.04
    echo "round $round, light again: valid came back, tx $(pin trifacet.tx) mm"
done

kill -KILL "$daemon"
wait "$daemon" 2>/dev/null || true
wait_for trifacet.valid FALSE
wait_for trifacet.tx nan
before=$(pin trifacet.age)
sleep 0.5
within trifacet.age "$before" 60
within trifacet.age 0.5 60                 # goes on counting while nothing comes
[ "$(pin watchdog.ok-out)" = TRUE ] || fail "the component must be alive without frames"
echo "daemon killed: valid fell, age counts on: $(pin trifacet.age) s"

start_daemon
wait_for trifacet.valid TRUE
echo "daemon started again: valid came back"

# What comes from elsewhere is counted, and changes nothing.
python3 -c 'import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for _ in range(3): s.sendto(b"TFP1" + bytes(188), ("127.0.0.1", int(sys.argv[1])))' "$port"
for _ in $(seq 100); do
    [ "$(($(pin trifacet.damaged)))" != 576 ] || break
    sleep 0.02
done
within trifacet.missed 0 0
[ "$(($(pin trifacet.damaged)))" = 576 ] || fail "damaged is $(pin trifacet.damaged), not 3 times 192 bytes"
echo "foreign datagrams: refused and counted"

# A component that hangs leaves its pins as they are: the watchdog must tell.
component=$(pgrep -f "trifacet_hal.py --port $port" | head -n 1)
wait_for trifacet.valid TRUE
kill -STOP "$component"
wait_for watchdog.ok-out FALSE
wait_for good.out FALSE
within choose.out 0 0
echo "component stopped: the watchdog fell, the gate gives $(pin choose.out)"
sleep 0.5
kill -CONT "$component"
halcmd setp watchdog.enable-in 0
sleep 0.05
halcmd setp watchdog.enable-in 1
wait_for good.out TRUE
echo "component goes on: good again"
echo "linuxcnc.sh: all right ($(dpkg-query -W -f '${Package} ${Version}' linuxcnc-uspace 2>/dev/null || echo 'linuxcnc of unknown version'))"
