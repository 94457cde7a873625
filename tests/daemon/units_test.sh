#!/usr/bin/env bash
# The units load without a complaint, and expose no more than stated: systemd's own judgement, where systemd-analyze is there.
#   units_test.sh FOLDER_OF_UNITS FOLDER_OF_PROGRAMS
set -euo pipefail
command -v systemd-analyze > /dev/null || { echo "left out: no systemd-analyze here"; exit 77; }
units=$(mktemp -d)
trap 'rm -rf "$units"' EXIT
cp "$1"/*.service "$1"/*.socket "$units"
sed -i "s#/usr/bin/#$2/#" "$units"/*.service  # the programs are not installed where the tests run

complaints=$(systemd-analyze verify --recursive-errors=no "$units"/*.service "$units"/*.socket 2>&1 || true)
if [ -n "$complaints" ]; then echo "$complaints"; exit 1; fi

exposure() {  # unit, most tenths allowed
  systemd-analyze security --offline=yes --no-pager --threshold="$2" "$units/$1" > "$units/judgement" 2>&1 || {
    cat "$units/judgement"
    echo "$1 exposes more than $2 tenths"
    exit 1
  }
}
exposure csiposed.service 2
exposure csipose-agent@.service 15
exposure csiposed-sim.service 15
