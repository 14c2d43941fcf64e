#!/bin/sh
# Makes .venv at the root of the checkout if it is missing, installs hpcomp into it and composites
# the terrain sample. Needs Python 3.11 or newer with pip, nothing else.
#
#   sh samples/quickstart.sh                     from any directory, as often as you like
#   PYTHON=python3.12 sh samples/quickstart.sh   names the interpreter that makes .venv

set -eu

root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd)
venv=$root/.venv
python=${PYTHON:-python3}

fail() {
    printf 'quickstart: %s\n' "$1" >&2
    exit 1
}

# Is $1 a Python that hpcomp can use?
recent() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))'
}

if [ ! -x "$venv/bin/python" ]; then
    command -v "$python" >/dev/null 2>&1 ||
        fail "$python not found: install Python 3.11 or newer, or name it with PYTHON=..."
    recent "$python" ||
        fail "$("$python" --version 2>&1) is too old: hpcomp needs 3.11, name one with PYTHON=..."
    # ensurepip is what Debian and Ubuntu leave out; without it venv would stop half-way.
    "$python" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "$python has no venv: install it (Debian, Ubuntu: apt install python3-venv)"
    echo "Making $venv"
    "$python" -m venv "$venv" || {
        rm -rf -- "$venv"
        fail "$python could not make $venv"
    }
fi
recent "$venv/bin/python" ||
    fail "$venv holds a Python that is too old or broken: remove it and try again"
"$venv/bin/python" -m pip --version >/dev/null 2>&1 ||
    fail "$venv has no pip, as after an interrupted start: remove it and try again"

# A user-wide `pip install --user` setting cannot be obeyed inside a virtual environment.
echo "Installing hpcomp (the first time, this fetches its libraries and compiles its kernel: a minute" \
    "or two without a word)"
# Compiled files stay in the environment, so that the next time only what changed is compiled.
PIP_USER=0 "$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --config-settings build-dir="$venv/build" "$root" ||
    fail "pip could not install $root: its messages are above"

PATH=$venv/bin:$PATH
cd -- "$root/samples/terrain"
mkdir -p out

# samples/terrain/README.md shows these commands and a test keeps them equal.
hpcomp stack layers/hillshade.png layers/elevation.png layers/steep.exr layers/summits.exr \
    layers/fault.exr 'layers/streams.png::opacity=0.65' \
    --blending traditional -o out/traditional.png

hpcomp stack layers/hillshade.png layers/elevation.png layers/steep.exr layers/summits.exr \
    layers/fault.exr 'layers/streams.png::opacity=0.65' \
    -o out/hue-preserving.png

hpcomp stack 'out/traditional.png::at=+0+36' 'out/hue-preserving.png::at=+496+36' \
    layers/captions.png --canvas 976x586+0+0 --background '#ffffff' \
    --compression small -o out/side-by-side.png

printf '\nThe pictures are in %s:\n' "$PWD/out"
echo "  traditional.png      the colours are added: new hues appear where labels overlap"
echo "  hue-preserving.png   the same layers: every hue is a label's"
echo "  side-by-side.png     both, with a legend"
printf '\nhpcomp is in %s. Make a picture of your own, in %s:\n' "$venv/bin" "$root"
echo "  .venv/bin/hpcomp stack samples/terrain/layers/hillshade.png samples/terrain/layers/steep.exr -o first.png"
