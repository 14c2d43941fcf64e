#!/bin/sh
# Makes .venv at the root of the checkout if it is missing, installs hpcomp into it and measures it
# beside other compositors, on pictures that it draws.
#
#   sh tests/bench/run.sh                          from any directory
#   sh tests/bench/run.sh --runs 9 --only png4k    passes arguments on, see --help
#   VENV=/tmp/env sh tests/bench/run.sh            uses another environment
#   PYTHON=python3.12 sh tests/bench/run.sh        names the interpreter that makes it

set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")/../.." && pwd)
venv=${VENV:-$root/.venv}
python=${PYTHON:-python3}

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
PIP_USER=0 "$venv/bin/python" -m pip install --quiet --disable-pip-version-check "$root"

exec "$venv/bin/python" "$root/tests/bench/bench.py" "$@"
