"""Command lines of every command for same_bytes.py: on the terrain sample, on small files that are
made for them, and the gallery of the paper."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
from casefiles import (
    LABELS,
    PRIMARIES,
    Case,
    deep_planes,
    exr_part,
    planes,
    straight,
    write_exr,
    write_png,
)

SAMPLES = Path(__file__).parents[2] / "samples"

#: The size of the gallery, as the tests build it.
GALLERY = ["SIZE=128", "SLICES=64", "OUT=out"]

PNG_COMPRESSIONS = ("fast", "small", *"0123456789")
EXR_COMPRESSIONS = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab", "htj2k256", "htj2k32")  # fmt: skip
REPORTS = ("txt", "json", "csv", "svg", "png", "pdf", "html")
COMMANDS = ("stack", "batch", "flatten", "explain", "check", "info", "hues", "palette", "completion")
SPACES = ("linear-rgb", "xyz", "hsl", "oklab", "cielab")
ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous", "2,0,1,4,3,5")
BLENDINGS = ("hue-preserving", "traditional", "foremost")

#: The terrain, and a small map that has the sizes of `put_small_files`.
TERRAIN = (
    "layers/hillshade.png layers/elevation.png layers/steep.exr layers/summits.exr "
    "layers/fault.exr layers/streams.png::opacity=0.65"
)
MAP = "base.png roads.png::opacity=0.6 rivers.exr"
MASKS = "base.png mask.png::tint=#ee0038,opacity=0.6 grey16.png::tint=#0050ff"

JOBS = {
    "toml": 'version = 1\n[defaults]\ndepth = "16"\n[[jobs]]\nlayers = ["base.png", "roads.png::opacity=0.6"]\n'
    'output = "a.png"\nreport = ["a.json", "a.html"]\n[[jobs]]\noutput = "b.exr"\nspace = "oklab"\ndepth = "half"\n'
    'layers = ["a.png", {path = "rivers.exr", op = "plus", opacity = 0.5, at = "+3+2"}]\n',
    "json": '{"version": 1, "defaults": {"gray_bias": 0.5}, "jobs": [{"layers": ["base.png", "rivers.exr"], '
    '"output": "a.png"}, {"layers": ["a.png", "roads.png"], "output": "b.png", "order": "simultaneous"}]}',
    "jsonl": '{"version": 1, "defaults": {"blending": "traditional"}}\n{"layers": ["base.png", "roads.png"], "output": '
    '"a.png"}\n{"layers": ["base.png", {"path": "mask.png", "tint": "#0050ff"}], "output": "b.png", "hue_tolerance": 0}\n',
    "csv": "output,layer,layer,depth,hue_tolerance,strict\na.png,base.png,roads.png::opacity=0.6,16,5,\n"
    'b.png,base.png,"mask.png::tint=#0050ff,opacity=0.5",8,,false\n',
}
#: Of six frames one is broken and one is missing.
FRAMES = "bg.%04d.exr fg.####.exr::opacity=0.5 -o out.%04d.exr"


# ---- files ---------------------------------------------------------------------------------------


def put_small_files(folder: Path) -> None:
    """The layers of the terrain, and a small file of each kind."""
    shutil.copytree(SAMPLES / "terrain" / "layers", folder / "layers")
    rng = np.random.default_rng(0)
    size = (64, 48)
    kinds = {"base": ("rgb", 8), "roads": ("rgba", 8), "mask": ("grey", 8), "grey16": ("grey", 16), "deep16": ("rgba", 16)}  # fmt: skip
    for name, (kind, bits) in kinds.items():
        write_png(folder / f"{name}.png", straight(rng, *size), kind, bits)
    write_png(folder / "large.png", straight(rng, 100, 80))
    write_png(folder / "p3.png", straight(rng, *size), light="p3")
    plain = np.full((48, 64, 4), 0.5) * [*LABELS[0], 1]
    write_png(folder / "plain.png", plain)

    def exr(name: str, pixels: np.ndarray, **options: object) -> None:
        write_exr(folder / name, exr_part(planes(pixels), **options))

    exr("rivers.exr", plain * [0.2, 1, 2, 0.8])
    exr("wide.exr", straight(rng, 90, 70), origin=(-9, -7), display=(0, 0, *size), compression="piz")
    exr("tiled.exr", straight(rng, *size), tile=32, chromaticities=PRIMARIES["rec2020"])
    nan = straight(rng, *size)
    nan[5, 7:9] = np.nan
    exr("nan.exr", nan)
    for number in (1, 2, 3, 4, 6):
        exr(f"bg.{number:04}.exr", straight(rng, *size))
        exr(f"fg.{number:04}.exr", straight(rng, *size))
    (folder / "fg.0002.exr").write_bytes(b"")
    render = {c: p for c, p in planes(straight(rng, *size)).items() if c != "A"}
    write_exr(folder / "render.exr", exr_part(render | planes(straight(rng, *size), "labels.")))
    parts = [exr_part(planes(straight(rng, *size)), name) for name in ("left", "right")]
    write_exr(folder / "parts.exr", *parts)
    for name, volumes in (("points.exr", False), ("smoke.exr", True)):
        samples = deep_planes(rng, 20, 15, 6, volumes)
        write_exr(folder / name, exr_part(samples, compression="zips", deep=True))
    for name in ("roads.png", "rivers.exr"):
        data = (folder / name).read_bytes()
        (folder / f"cut-{name}").write_bytes(data[: len(data) * 2 // 3])
    (folder / "text.png").write_text("no picture\n")
    (folder / "empty.png").write_bytes(b"")
    for ending, text in JOBS.items():
        (folder / f"jobs.{ending}").write_text(text)


@cache
def small_files() -> dict[str, bytes]:
    """Their bytes by name: made once."""
    with tempfile.TemporaryDirectory() as temporary:
        put_small_files(Path(temporary))
        paths = [path for path in Path(temporary).rglob("*") if path.is_file()]
        return {str(path.relative_to(temporary)): path.read_bytes() for path in paths}


def put_small(folder: Path) -> None:
    for name, content in small_files().items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)


def put_gallery(folder: Path) -> None:
    """The makefile of the paper, and the layers and sheets that its scripts draw."""
    for path in (SAMPLES / "paper" / "Makefile", *(SAMPLES / "paper").glob("*.py")):
        shutil.copy2(path, folder)
    # With a stand-in that makes nothing, make draws what hpcomp would take.
    subprocess.run(
        ["make", "-s", "HPCOMP=true", f"PYTHON={sys.executable}", *GALLERY],
        cwd=folder, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "MAKEFLAGS": ""},
        check=True, capture_output=True,
    )  # fmt: skip


def put_terrain(folder: Path) -> None:
    shutil.copy2(SAMPLES / "Makefile", folder)
    shutil.copytree(SAMPLES / "terrain" / "layers", folder / "terrain" / "layers")


# ---- command lines -------------------------------------------------------------------------------


def stacks() -> Iterator[str]:
    """Every option of stack, and its layers."""
    for blending in BLENDINGS:
        yield f"hpcomp stack {TERRAIN} --blending {blending} -o out.png"
    for space in SPACES:
        for order in ORDERS:
            yield f"hpcomp stack {TERRAIN} --space {space} --order {order} -o out.exr"
    for primaries in ("display-p3", "rec2020", "acescg", "bottom"):
        yield f"hpcomp stack tiled.exr p3.png --primaries {primaries} -o out.exr"
        yield f"hpcomp stack p3.png tiled.exr --primaries {primaries} --out-primaries display-p3 -o out.png"
    for depth in ("8", "16"):
        for compression in PNG_COMPRESSIONS:
            yield f"hpcomp stack {MAP} --depth {depth} --compression {compression} -o out.png"
    for compression in EXR_COMPRESSIONS:
        for depth in ("half", "float"):
            yield f"hpcomp stack {MAP} --depth {depth} --compression {compression} -o out.exr"
    for canvas in ("union", "intersection", "120x90-10-8"):
        yield f"hpcomp stack {MAP} large.png wide.exr --canvas {canvas} --overscan -o out.exr"
        yield f"hpcomp stack {MAP} large.png::at=south-east-3-2 --canvas {canvas} --background '#f80' -o out.png"
    for options in (
        "--hue-tolerance 0", "--hue-tolerance 20", "--gray-bias 0.5", "--exposure -1", "--region 20x10+5+6",
        "--background '#203040'", "--strict", "--threads 1", "--max-memory 8M", "--op plus", "--op xor -q",
    ):  # fmt: skip
        yield f"hpcomp stack {TERRAIN} {options} -o out.png"
        yield f"hpcomp stack {MASKS} {options} -o out.exr"
    for layers in (
        "base.png render.exr::layer=labels,opacity=0.7", "parts.exr::part=right parts.exr::part=0,name=x",
        "base.png mask.png::op=dst-in,alpha=luminance", "nan.exr --nonfinite zero", "nan.exr --nonfinite keep",
        "roads.png deep16.png::alpha=premultiplied,colorspace=linear", "roads.png::alpha=premultiplied-encoded",
        "base.png large.png::at=center", "wide.exr --overscan",
    ):  # fmt: skip
        yield f"hpcomp stack {layers} -o out.exr"
        yield f"SOURCE_DATE_EPOCH=1700000000 hpcomp stack {layers} -o out.exr"
    yield "hpcomp stack roads.png mask.png::op=dst-in,alpha=luminance -o - --format exr | hpcomp stack base.png - -o out.png"
    yield f"hpcomp stack {MAP} -o - --format png"
    yield f"hpcomp stack {MAP} -o out.png --write-if-changed && hpcomp stack {MAP} -o out.png --write-if-changed --no-clobber"
    yield f"hpcomp stack {MAP} -o out.png --depfile out.d --depfile-target a --depfile-target b"
    yield f"hpcomp stack {MAP} -o out.png --depfile -"
    for frames in ("1,3-4 -j 1", "1-6 -j 1", "1-4x2 -j 1", "1,3-4 -j 2 -q"):  # one at a time, in order
        yield f"hpcomp stack {FRAMES} --frames {frames}"
    yield "hpcomp stack bg.%04d.exr -o out.%04d.png --frames 1-3 -j 1 --report r.%04d.json --depfile d"
    yield f"hpcomp stack {MAP} --space oklab --order 2,0,1 --report a.json --save-job job.json -o out.png"
    yield f"hpcomp stack {MAP} --save-job jobs2.jsonl -o a.png && hpcomp stack {MASKS} --save-job jobs2.jsonl -o b.png"
    yield f"hpcomp stack {FRAMES} --frames 1-6 --save-job shot.json; hpcomp batch shot.json -j 1 --log shot.log"


def reports() -> Iterator[str]:
    every = " ".join(f"--report r.{ending}" for ending in REPORTS)
    for options in ("", "--blending traditional", "--space oklab --order simultaneous", "--blending foremost"):
        yield f"hpcomp stack {TERRAIN} {options} -o out.png {every} --provenance origin.exr"
    for layers in (MAP, MASKS, "wide.exr --overscan", "nan.exr --nonfinite keep", "roads.png"):
        yield f"hpcomp stack {layers} -o out.exr {every} --provenance origin.exr"
        yield f"HPCOMP_ENGINE=reference hpcomp stack {layers} -o out.exr --report r.json --report r.html --provenance origin.exr"
    for options in ("--foreign-tolerance 20", "--achromatic 0.2", "--bins 36", "--energy-weights 1,1,2", "--region 9x9+9+9"):  # fmt: skip
        yield f"hpcomp stack {MAP} {options} -o out.png --report r.json --report r.txt --report r.html"
    yield f"hpcomp stack {MAP} -o - --format png --report r.csv --depfile d > out.png"


def batches() -> Iterator[str]:
    for ending in JOBS:
        yield f"hpcomp batch jobs.{ending} -j 1 --log jobs.log"
        yield f"hpcomp batch jobs.{ending} -j 2 -q"
        yield f"hpcomp batch - --format {ending} -j 1 --log - < jobs.{ending}"
    yield "hpcomp batch jobs.toml -j 1; hpcomp batch jobs.toml -j 1 --update; touch roads.png; hpcomp batch jobs.toml -j 1 --update"
    yield "hpcomp batch jobs.csv -j 1 --state s.hpcomp-state; hpcomp batch jobs.csv -j 1 --state s.hpcomp-state --resume"
    yield "hpcomp batch jobs.json -j 1 --skip-existing --depfile d --write-if-changed; rm b.png; hpcomp batch jobs.json -j 1 --skip-existing"
    yield "hpcomp batch jobs.jsonl --dask local:1 -j 1 -q"
    yield "sed -i s/rivers/missing/ jobs.*; for f in toml json; do hpcomp batch jobs.$f -j 1 --log $f.log; echo $?; done"
    yield "sed -i s/base/missing/ jobs.*; hpcomp batch jobs.csv -j 1 --fail-fast; hpcomp batch jobs.jsonl -j 1 --debug 2>&1 | tail -1"


def flattenings() -> Iterator[str]:
    for files in ("points.exr", "smoke.exr", "points.exr smoke.exr::at=+3+2"):
        for order in ORDERS[:4]:
            yield f"hpcomp flatten {files} --order {order} -o out.exr"
        for options in ("--blending traditional", "--blending foremost", "--space oklab --gray-bias 0.5", "--background '#000'", "--region 9x9+1+1 --exposure 1", "--canvas union --depth 16"):  # fmt: skip
            yield f"hpcomp flatten {files} {options} -o out.png --depfile d"
    yield "hpcomp flatten - -o - --format png < smoke.exr"


def explanations() -> Iterator[str]:
    for form in ("text", "json"):
        for space in SPACES:
            for order in ORDERS:
                yield f"hpcomp explain {TERRAIN} --at 250,200 --space {space} --order {order} --format {form}"
        for at in ("0,0", "300,100", "470,505"):
            for blending in BLENDINGS:
                yield f"hpcomp explain {TERRAIN} --at {at} --blending {blending} --format {form}"
        for layers in (MASKS, "base.png roads.png::op=xor", "tiled.exr p3.png --primaries rec2020", "wide.exr --overscan", "nan.exr --nonfinite zero"):  # fmt: skip
            yield f"hpcomp explain {layers} --at 8,5 --format {form} --exposure 0.5 --background '#fff' --foreign-tolerance 9 --gray-bias 1"


def checks() -> Iterator[str]:
    make = f"hpcomp stack {TERRAIN} -o map.png; hpcomp stack {TERRAIN} --blending traditional -o plain.png"
    for form in ("text", "json"):
        for rules in (
            "--max-foreign 0.1%", "--max-foreign 1% --max-grey 5%", "--require-hue layer:fault.exr --depfile d --depfile-target t",
            "--require-hue layer:1 --require-hue 120 --visible 50%", "--max-foreign 0 --space oklab --foreign-tolerance 1 --achromatic 0.1",
        ):  # fmt: skip
            against = f"{TERRAIN} {rules} --format {form}"
            yield f"{make}; hpcomp check map.png {against}; echo $?; hpcomp check plain.png {against}"
        yield f"{make}; for f in map plain; do hpcomp check $f.png --hues 0,45,231 --max-foreign 1% --max-grey 60% --format {form}; echo $?; done"


def histograms() -> Iterator[str]:
    for form in ("text", "json", "csv", "svg", "png", "pdf", "html"):
        yield f"hpcomp hues {TERRAIN.replace('::opacity=0.65', '')} --format {form}"
        yield f"hpcomp hues roads.png::name=roads rivers.exr mask.png::tint=#f00 -o out.{form.replace('text', 'txt')} --depfile d"
    for axes in ("linear", "polar"):
        yield f"hpcomp hues layers/elevation.png roads.png --format svg --axes {axes} --scale log --weight chroma --bins 36"
    for options in (*(f"--space {s}" for s in SPACES), "--achromatic 0.3", "--weight alpha", "--scale linear", "--threads 1"):  # fmt: skip
        yield f"hpcomp hues layers/elevation.png wide.exr {options}"
    yield "hpcomp hues roads.png text.png parts.exr::part=right - < rivers.exr"
    yield "hpcomp hues nan.exr; hpcomp hues nan.exr --nonfinite zero; hpcomp hues nan.exr --nonfinite keep --format json"


def palettes() -> Iterator[str]:
    labels = "fault=#ff7200 streams=#0050ff band=#ffdd00 heath=d95f02 grey=#888"
    for form in ("text", "json", "svg", "png", "pdf"):
        yield f"hpcomp palette {labels} --format {form}"
        yield f"hpcomp palette '#e41a1c' '#377eb8' -o out.{form.replace('text', 'txt')} --depfile d"
    for figure in ("profiles", "discs"):
        yield f"hpcomp palette {labels} --format svg --figure {figure}"
    for options in (
        *(f"--space {s} --order simultaneous" for s in SPACES), "--background '#202020' --opacity 0.2", "--gray-bias 1 --hue-tolerance 0",
        "--least-difference 0.3 --close-hues 40 --grey-opacity 0.6 --achromatic 0.1", "--strict", "--blending foremost",
    ):  # fmt: skip
        yield f"hpcomp palette {labels} {options}"
    yield "hpcomp palette --from layers/fault.exr --from layers/elevation.png --from layers/streams.png"


def infos() -> Iterator[str]:
    yield "hpcomp info layers/*"
    yield "hpcomp info --json layers/* *.png *.exr"
    yield "hpcomp info *.png *.exr"
    yield "hpcomp info - < roads.png; hpcomp info --json - < parts.exr"
    yield "for s in bash zsh fish; do hpcomp completion $s; done"
    yield "_HPCOMP_COMPLETE=bash_complete COMP_WORDS='hpcomp stack --sp' COMP_CWORD=2 hpcomp"
    for line in ("stack roads.png::op=a", "stack roads.png -o a.exr --compression ", "batch "):
        yield f"_HPCOMP_COMPLETE=fish_complete COMP_LINE='hpcomp {line}' hpcomp"


def helps() -> Iterator[str]:
    yield "hpcomp"
    yield "hpcomp --help"
    for command in COMMANDS:
        yield f"hpcomp {command} --help; hpcomp {command} -h; hpcomp {command}"


def verbose() -> Iterator[str]:
    """Decisions and timings."""
    for command in (
        f"stack {MAP} -o out.png", f"stack {MAP} -o out.exr --threads 1 --max-memory 300k --order balanced --report r.json",
        "stack wide.exr large.png --canvas union -o out.png", "flatten smoke.exr points.exr -o out.exr", "batch jobs.toml -j 1",
        f"explain {MAP} --at 3,3", f"check roads.png {MAP} --max-foreign 5%", "info roads.png", "hues roads.png rivers.exr", "palette f00 00f",
    ):  # fmt: skip
        yield f"hpcomp {command} -v"
        yield f"HPCOMP_ENGINE=reference hpcomp {command} -v"


#: Command lines that are refused, or warn: each exit code from 2 to 5, and findings.
ERRORS = """\
frob | --frob | stack | stack base.png | stack base.png -o out | stack base.png -o out.jpg | stack base.png -o -
stack base.png -o out.png --frob | stack base.png -o out.png --op frob | stack base.png -o out.png --space frob
stack base.png::op=over -o out.png | stack base.png::frob=1 -o out.png | stack base.png::opacity=2 -o out.png
stack base.png roads.png::opacity=x,at=here -o out.png | stack base.png::alpha=x -o out.png
stack base.png roads.png -o out.png --order 0,1,2 | stack base.png roads.png -o out.png --order 0,0 | stack base.png -o out.png --order x
stack base.png -o out.png --region 3x3 | stack base.png -o out.png --canvas frob
stack base.png -o out.png --hue-tolerance 91 | stack base.png -o out.png --gray-bias 2 | stack base.png -o out.png --exposure nan
stack base.png -o out.png --depth half | stack base.png -o out.exr --depth 16 | stack base.png -o out.exr --compression small
stack base.png -o out.png --overscan | stack base.png -o out.png --max-memory much | stack base.png -o out.png --threads 0
stack base.png -o out.exr --out-primaries rec2020 | stack base.png -o out.png --report r.jpg | stack base.png -o out.png --report out.png
stack base.png -o base.png --provenance base.png | stack base.png -o out.png --energy-weights 1,2 | stack base.png -o out.png --bins 2
stack base.png -o out.png --provenance p.png | stack base.png -o out.png --frames 1-3 | stack bg.%04d.exr -o out.%04d.exr
stack bg.%04d.exr -o out.%04d.exr --frames 3-1 | stack base.png -o out.png --save-job x.txt | stack - - -o out.png
stack base.png -o out.png --depfile-target x | stack base.png -o out.png --achromatic 0.1 | stack base.png -o out.png --jobs 2
batch | batch jobs.toml --format frob | batch roads.png | batch - | batch missing.toml | batch jobs.toml -j 0 | batch jobs.toml --dask local:x
flatten smoke.exr -o out.png --order 1,0 | flatten smoke.exr::op=over -o out.png | flatten base.png -o out.png | flatten cut-rivers.exr -o out.png
explain base.png | explain base.png --at x | explain base.png --at 999,3 | explain base.png --at 1,1 --format xml | explain nan.exr --at 7,5
check | check base.png base.png | check base.png --max-foreign 1% | check base.png base.png --hues 0 --max-foreign 1%
check base.png base.png --max-foreign 101% | check base.png base.png --require-hue frob | check base.png base.png --require-hue layer:7
check base.png base.png --min-visible lots | check base.png base.png --min-visible layer:bse=90% | check base.png base.png --min-visible 1% --min-visible 2%
check missing.png base.png --max-foreign 1% | check large.png base.png --max-foreign 1% | check roads.png base.png --require-hue 120
info | info missing.png text.png base.png | info cut-roads.png cut-rivers.exr empty.png . | hues | hues missing.png | hues base.png -o out.jpg
hues base.png --bins 5 | hues base.png::op=over | hues roads.png --format frob | hues large.png missing.png -o out.json | completion | completion tcsh
palette | palette f00 | palette f00 f00 --format csv | palette a=f00 a=00f | palette f00 00f --opacity 2 | palette f00 f10 --strict
stack missing.png -o out.png | stack text.png -o out.png | stack empty.png -o out.png | stack . -o out.png | stack base.png cut-roads.png -o out.png
stack cut-rivers.exr -o out.png | stack smoke.exr -o out.png | stack render.exr::layer=frob -o out.png | stack parts.exr::part=up -o out.png
stack base.png::colorspace=frob -o out.png | stack base.png large.png -o out.png | stack nan.exr -o out.png | stack base.png mask.png::op=in -o out.png --strict
stack base.png -o out.png --max-memory 1k | stack base.png -o out.png --region 9x9+900+900 | stack base.png large.png::at=+900+900 --canvas intersection -o out.png
stack base.png -o nowhere/out.png | stack base.png -o layers/text.png/out.png | stack base.png -o roads.png --no-clobber | stack base.png -o /proc/out.png
stack base.png -o out.png --report nowhere/r.json | hues base.png -o nowhere/h.svg | palette f00 00f -o nowhere/p.txt | stack rivers.exr::alpha=straight -o out.png --strict
stack wide.exr --exposure 4 -o out.png --strict | stack wide.exr --exposure 4 -o out.png | stack base.png mask.png::op=dst-out -o out.png"""

JOB_ERRORS = (
    'version = 2\njobs = []', 'jobs = []', 'jobs = [{}]', 'jobs = [{layers = ["base.png"]}]', 'jobs = [{layers = [], output = "a.png"}]',
    'jobs = [{layers = ["base.png"], output = "a.png", spcae = "oklab"}]', 'jobs = [{layers = ["base.png"], output = "a.png", space = 3}]',
    'jobs = [{layers = ["base.png"], output = "a.png", space = "frob"}]', 'jobs = [{layers = [{path = "base.png", opactiy = 1}], output = "a.png"}]',
    'jobs = [{layers = [{op = "over"}], output = "a.png"}]', 'defaults = {frob = 1}\njobs = []', 'jobs = [{layers = ["base.png"], output = "a.png"}, {layers = ["roads.png"], output = "a.png"}]',
    'jobs = [{layers = ["b.png"], output = "a.png"}, {layers = ["a.png"], output = "b.png"}]', 'jobs = [', 'frob = 1', 'jobs = [{layers = "base.png", output = 3}]',
    'jobs = [{layers = ["base.png"], output = "a.png", gray_bias = true, strict = 1, threads = 1.5}]',
)  # fmt: skip
OTHER_JOB_ERRORS = {
    "json": ("{", "[]", '{"jobs": 3}', '{"jobs": [{"layers": ["base.png"], "output": "a.png", "order": null, "frob": {}}]}', '{"jobs": [3]}'),
    "jsonl": ('{"layers": ["base.png"], "output": "a.png"}\n{', '{"layers": ["base.png"], "output": "a.png"}\n{"output": 3}', "3", ""),
    "csv": ("", "output\na.png", "output,layer,frob\na.png,base.png,1", "output,layer,depth,strict\na.png,base.png,7,\nb.png,base.png,8,maybe", "output,layer\na.png,base.png,x"),
}  # fmt: skip


def errors() -> Iterator[str]:
    for words in ERRORS.replace("\n", " | ").split(" | "):
        yield f"hpcomp {words}"
    yield f"hpcomp stack {MAP} -o - --format png > /dev/full"
    yield "hpcomp info base.png > /dev/full"
    yield "HPCOMP_ENGINE=frob hpcomp stack base.png -o out.png"
    yield "SOURCE_DATE_EPOCH=soon hpcomp stack base.png -o out.exr"
    for text in JOB_ERRORS:
        yield f"cat > j.toml <<'END'\n{text}\nEND\nhpcomp batch j.toml -j 1"
    for ending, texts in OTHER_JOB_ERRORS.items():
        for text in texts:
            yield f"cat > j.{ending} <<'END'\n{text}\nEND\nhpcomp batch j.{ending} -j 1"


def colors() -> Iterator[str]:
    """Ways to write a colour, understood or refused."""
    for color in ("'#f80'", "'#ff8800'", "f80", "'#FF8800'", "red", "'#ff880080'", "'#f808'", "'rgb(1,2,3)'", "''", "'#ff88'", "frob"):
        yield f"hpcomp stack base.png -o out.png --background {color}"
        yield f"hpcomp stack base.png mask.png::tint={color} -o out.png"
        yield f"hpcomp palette {color} name={color} 00f"


#: Of each group, what it runs and what it starts from; the longest case comes first.
GROUPS: dict[str, tuple[Callable[[], Iterator[str]], Callable[[Path], None]]] = {
    "gallery": (lambda: iter([" ".join(["make", "-k", *GALLERY])]), put_gallery),
    "terrain": (lambda: iter(["make terrain OUT=out"]), put_terrain),
    "reports": (reports, put_small),
    "stack": (stacks, put_small),
    "batch": (batches, put_small),
    "flatten": (flattenings, put_small),
    "explain": (explanations, put_small),
    "check": (checks, put_small),
    "hues": (histograms, put_small),
    "palette": (palettes, put_small),
    "info": (infos, put_small),
    "verbose": (verbose, put_small),
    "errors": (errors, put_small),
    "colors": (colors, put_small),
    "schema": (lambda: iter(["hpcomp batch --schema"]), put_small),
    "help": (helps, put_small),
}


def command_cases() -> Iterator[Case]:
    for group, (scripts, put_inputs) in GROUPS.items():
        for number, script in enumerate(scripts()):
            yield Case(group, number, script, put_inputs)
