"""Builds what a release consists of and installs it as a stranger would: not run by pytest.

    python3 tests/package/check.py

The newest Python here that can builds the source distribution, and from that the wheel. What both
hold is looked at, the wheel is installed for the oldest Python that takes it, with the lowest
version of everything that pyproject.toml allows, and there the kernel composites and some tests
run. A wheel of Python 3.12 or later is for all that follow; where there is none, that is not tried.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

#: The first version whose stable ABI the kernel can be built for.
STABLE_ABI = (3, 12)
#: The last version that the lowest releases have wheels for.
LAST_WITH_LOWEST = (3, 12)

#: What each library that hpcomp needs is tried by.
TESTS = {
    "click": ["tests/math/test_kernel.py::TestChoice"],
    "colour-science": ["tests/math/test_spaces.py::TestAgainstColourScience"],
    "distributed": [
        "tests/command/test_cluster.py::test_a_cluster_of_ones_own_and_what_is_remembered"
    ],
    "htpy": ["tests/command/test_page.py::test_page_is_well_formed"],
    "isal": ["tests/files/test_pngwriter.py::TestChunks"],
    "markupsafe": ["tests/command/test_page.py::test_what_goes_into_a_page_comes_out_as_text"],
    "matplotlib": [
        "tests/command/test_report.py::test_figure_grows_with_its_images",
        "tests/command/test_report.py::test_svg_stands_alone",
    ],
    "msgspec": ["tests/command/test_jobfile.py"],
    "numpy": ["tests/math/test_porter_duff.py"],
    "OpenEXR": ["tests/files/test_fixtures.py"],
    "OpenImageIO": ["tests/files/test_stack.py::test_exr_compression"],
    "tqdm": ["tests/command/test_batch.py::test_a_terminal_has_a_bar_with_rate_and_time_left"],
    "webcolors": ["tests/files/test_tint.py::test_a_tint_is_a_css_colour"],
    "zlib-ng": ["tests/files/test_pngwriter.py::TestPixels::test_of_any_size"],
}

ASKED = """
import json, os, sys, sysconfig
import ensurepip
headers = os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h"))
free_threaded = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))
print(json.dumps([sys.version_info[:2], headers and not free_threaded, sys.executable]))
"""


@dataclass(frozen=True, order=True)
class Python:
    """An interpreter that can make environments and compile."""

    version: tuple[int, int]
    path: str

    @property
    def words(self) -> str:
        return "Python {}.{}".format(*self.version)


def pythons() -> list[Python]:
    """One of each version from 3.11 on, the oldest first."""
    found: dict[tuple[int, int], Python] = {}
    for candidate in _candidates():
        asked = subprocess.run([candidate, "-c", ASKED], capture_output=True, text=True)
        if asked.returncode == 0:
            version, usable, path = json.loads(asked.stdout)
            if usable and version >= [3, 11]:
                found.setdefault(tuple(version), Python(tuple(version), path))
    return sorted(found.values())


def _candidates() -> Iterator[str]:
    yield sys.executable
    for minor in range(11, 20):
        if path := shutil.which(f"python3.{minor}"):
            yield path
    managed = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    yield from map(str, sorted(managed.glob("3.*/bin/python3")))


def run(*arguments: str | Path, **how: object) -> None:
    """Runs a command; the check ends where it fails."""
    subprocess.run(arguments, check=True, **how)  # type: ignore[call-overload]


def environment(python: Python, folder: Path, *packages: str | Path) -> Path:
    """A new environment with these packages; its folder of commands."""
    run(python.path, "-m", "venv", folder)
    run(folder / "bin/python", "-m", "pip", "install", "-qq",
        "--disable-pip-version-check", *packages)  # fmt: skip
    return folder / "bin"


def build(python: Python, folder: Path) -> tuple[Path, Path]:
    """The source distribution and the wheel that was built from it, checked for an index."""
    stable = python.version >= STABLE_ABI
    tools = environment(
        python, folder / "tools", "build", "twine", *(["abi3audit"] if stable else [])
    )
    run(tools / "python", "-m", "build", "--outdir", folder / "dist", ROOT,
        stdout=subprocess.DEVNULL)  # fmt: skip
    (sdist,) = (folder / "dist").glob("*.tar.gz")
    (wheel,) = (folder / "dist").glob("*.whl")
    run(tools / "twine", "check", "--strict", sdist, wheel)
    if stable:
        run(tools / "abi3audit", "--strict", "--summary", wheel)
    return sdist, wheel


def check_contents(sdist: Path, wheel: Path, python: Python) -> None:
    """Everything that is needed, and nothing that is not."""
    stem = f"{PROJECT['name']}-{sdist.name.split('-')[1].removesuffix('.tar.gz')}"
    with tarfile.open(sdist) as archive:
        packed = {name.removeprefix(f"{stem}/") for name in archive.getnames()}
    tracked = _tracked()
    assert not tracked - packed, f"the sdist lacks {sorted(tracked - packed)}"
    assert not packed - tracked - {"PKG-INFO", stem}, f"the sdist has {sorted(packed - tracked)}"

    kernel = "hpcomp/kernel/_kernel.abi3.so"
    tag = "cp{}{}".format(*STABLE_ABI) + "-abi3-"
    if python.version < STABLE_ABI:
        version = "{}{}".format(*python.version)
        kernel, tag = f"hpcomp/kernel/_kernel.cpython-{version}-*.so", f"cp{version}-cp{version}-"
    assert tag in wheel.name, f"{wheel.name} is not tagged {tag}"
    names = [Path(name) for name in zipfile.ZipFile(wheel).namelist()]
    data = ["blending/bluenoise.npy", "py.typed", "report/page.css", "report/page.js"]
    for pattern in [kernel, *(f"hpcomp/{name}" for name in data)]:
        assert any(name.match(pattern) for name in names), f"the wheel lacks {pattern}"
    share = Path(f"{stem}.data/data/share")
    pages = {share / name for name in tracked if re.fullmatch(r"man/man\d/.*", name)}
    assert pages, "no man page is tracked"
    assert pages <= set(names), f"the wheel lacks {sorted(pages - set(names))}"
    modules = {Path(name) for name in tracked if re.fullmatch(r"hpcomp/.*\.py", name)}
    assert modules <= set(names), f"the wheel lacks {sorted(modules - set(names))}"
    allowed = {".py", ".pyi", ".so", ".typed", ".css", ".js", ".npy", ".1", ".5", ".7"}
    for name in names:
        if name.parts[0] != f"{stem}.dist-info":
            assert name.suffix in allowed, f"the wheel has {name}"
            assert name.parts[0] in ("hpcomp", f"{stem}.data"), f"the wheel has {name}"


def _tracked() -> set[str]:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return set(listed.stdout.split("\0")) - {""}


def lowest(requirements: Sequence[str]) -> list[str]:
    """The lowest version that each requirement allows."""
    found = []
    for requirement in requirements:
        match = re.fullmatch(r"([\w.-]+)>=([\w.]+)", requirement)
        assert match, f"{requirement} does not say its lowest version"
        found.append("{}=={}".format(*match.groups()))
    return found


def check_installed(wheel: Path, python: Python, folder: Path) -> None:
    """The wheel by itself, with the lowest versions: the kernel composites, and tests pass."""
    extras = PROJECT["optional-dependencies"]
    needed = [*PROJECT["dependencies"], *extras["dask"], *extras["plot"]]
    untried = {name.partition("=")[0] for name in lowest(needed)} - TESTS.keys()
    assert not untried, f"no test tries the lowest version of {sorted(untried)}"
    pinned = []
    if python.version <= LAST_WITH_LOWEST:
        pinned = lowest([*PROJECT["dependencies"], *(r for rows in extras.values() for r in rows)])
    constraints = folder / "constraints.txt"
    constraints.write_text("\n".join(pinned))
    commands = environment(
        python, folder / "installed", "--only-binary", ":all:", "--constraint", constraints,
        f"{wheel}[test]",
    )  # fmt: skip
    variables = {**os.environ, "HPCOMP_ENGINE": "kernel"}
    run(commands / "hpcomp", "--version", env=variables)
    layers = [ROOT / "samples/terrain/layers" / name for name in ("hillshade.png", "fault.exr")]
    run(commands / "hpcomp", "stack", *layers, "-o", folder / "out.png", env=variables)
    variables["PATH"] = f"{commands}{os.pathsep}{os.environ['PATH']}"
    tests = [test for those in TESTS.values() for test in those]
    run(commands / "pytest", "--quiet", "-p", "no:cacheprovider", *tests, cwd=ROOT, env=variables)


def main() -> None:
    found = pythons()
    builder = found[-1]
    installer = next(
        python for python in found if python.version >= min(STABLE_ABI, builder.version)
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sdist, wheel = build(builder, folder)
        check_contents(sdist, wheel, builder)
        print(f"{wheel.name}: built with {builder.words}, installed for {installer.words}")
        if builder.version < STABLE_ABI:
            print("not tried: a wheel for several versions needs Python 3.12 or later to build it")
        elif builder == installer:
            print(f"not tried: the wheel on another version, as {builder.words} is the only one")
        check_installed(wheel, installer, folder)


if __name__ == "__main__":
    main()
