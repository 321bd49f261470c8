#!/usr/bin/env bash
# Installs Debian's chromium for the browser tests if it is missing and the user is root.
set -euo pipefail

fail() {
    echo "chromium.sh: $*" >&2
    exit 1
}

command -v chromium >/dev/null && exit 0
[ "$(id -u)" = 0 ] && command -v apt-get >/dev/null ||
    fail "chromium is missing, and only root can install it: apt-get install chromium"
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium fonts-liberation >/dev/null ||
    fail "chromium cannot be installed from the package sources of this system"
