#!/usr/bin/env bash
# Prints the path of promtool. If it is missing, takes it from Debian's package prometheus; the package itself is not
# installed, since it would start a server.
#
#     tests/system/monitor/promtool.sh FOLDER
set -euo pipefail

fail() {
    echo "promtool.sh: $*" >&2
    exit 1
}

command -v promtool && exit 0
mkdir -p "$1"
cd "$1"
exec 9>lock
flock 9 # one test fetches it for all
if [ ! -x usr/bin/promtool ]; then
    command -v apt-get >/dev/null || fail "promtool is missing: install prometheus"
    apt-get download -qq prometheus 2>/dev/null || {
        [ "$(id -u)" = 0 ] || fail "promtool is missing, and only root can fetch it: apt-get install prometheus"
        apt-get update -qq
        apt-get download -qq prometheus >/dev/null 2>&1
    } || fail "prometheus cannot be downloaded from the package sources of this system"
    dpkg-deb --fsys-tarfile prometheus_*.deb | tar -x ./usr/bin/promtool
    rm prometheus_*.deb
fi
echo "$PWD/usr/bin/promtool"
