#!/bin/sh
# Makes .venv at the root of the checkout if it is missing, installs hpcomp with what its tests need
# into it, and runs the tests: those that take a few minutes together, those of the gate, or all.
#
#   sh tests/run.sh                             from any directory; two files of tests at a time
#   sh tests/run.sh --gate                      slow and thorough tests, twice the random examples too
#   sh tests/run.sh --all                       exhaustive ones, five times the random examples too
#   sh tests/run.sh tests/command/test_cli.py   passes arguments on to pytest
#   VENV=/tmp/env sh tests/run.sh               uses another environment
#   PYTHON=python3.12 sh tests/run.sh           names the interpreter that makes it

set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd)
venv=${VENV:-$root/.venv}
python=${PYTHON:-python3}

[ -x "$venv/bin/python" ] || {
    echo "Making $venv"
    "$python" -m venv "$venv"
}
echo "Installing hpcomp and what its tests need into $venv (the first time, a few minutes without a word)"
# Compiled files stay in the environment, so that the next time only what changed is compiled.
PIP_USER=0 "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --config-settings build-dir="$venv/build" "$root[test]"

# Not `python -m pytest`, which would import the checkout instead of what was installed.
cd -- "$root"
PATH=$venv/bin:$PATH
# Tests of one file share what takes long to make.
case ${1-} in
"")
    export HPCOMP_HYPOTHESIS="${HPCOMP_HYPOTHESIS:-quick}"
    echo "Running the tests, two files at a time: a few minutes on an idle machine"
    code=0
    pytest --numprocesses 2 --dist loadfile -m "not slow and not thorough and not exhaustive" || code=$?
    echo "Slow tests, whole products and more random examples: sh tests/run.sh --all"
    exit $code
    ;;
--gate)
    shift
    echo "Running the tests of the gate, two files at a time: about a quarter of an hour"
    exec pytest --numprocesses 2 --dist loadfile -m "not exhaustive" "$@"
    ;;
--all)
    shift
    export HPCOMP_HYPOTHESIS="${HPCOMP_HYPOTHESIS:-many}"
    echo "Running all tests, two files at a time: far longer than the plain run"
    exec pytest --numprocesses 2 --dist loadfile "$@"
    ;;
*)
    exec pytest "$@"
    ;;
esac
