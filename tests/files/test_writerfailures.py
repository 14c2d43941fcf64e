"""How the scanline writers of PNG and EXR fail: wherever it strikes, one error and a closed file."""

from __future__ import annotations

import errno
import io
import os
import resource
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pngfile
import pytest
from command import OLD, Desk, shell

import hpcomp
from hpcomp import OutputError, Window
from hpcomp.imagefile import exrscanlines, segments
from hpcomp.imagefile.exrscanlines import ExrForm, ExrScanlineWriter
from hpcomp.imagefile.header import PictureHeader
from hpcomp.imagefile.pngwriter import PngWriter


def header_of(samples):
    window = Window(0, 0, samples.shape[1], samples.shape[0])
    return PictureHeader(window, window)


def png_writer(path, samples):
    return PngWriter(str(path), header_of(samples), 8, "fast", "out.png")


def exr_writer(compression):
    def writer(path, samples):
        form = ExrForm("half", compression, header_of(samples))
        return ExrScanlineWriter(str(path), form, "out.exr")

    return writer


@dataclass(frozen=True)
class Kind:
    """A writer, and a picture of several segments for it."""

    ending: str
    writer: Callable[..., Any]
    size: tuple[int, int]
    largest: int
    dtype: type
    rows: int
    least_calls: int

    def noise(self, width, height):
        rng = np.random.default_rng([width, height])
        return rng.integers(0, self.largest, (height, width, 4)).astype(self.dtype)

    def fill(self, writer, samples):
        """Writes a whole picture in two strips, and gives it up in the end, whatever happened."""
        cut = samples.shape[0] // 2 // self.rows * self.rows
        try:
            writer.write(writer.prepare(0, samples[:cut]))
            writer.write(writer.prepare(cut, samples[cut:]))
            writer.finish()
        finally:
            writer.abandon()
            writer.abandon()


KINDS = {
    "png": Kind("png", png_writer, (1200, 140), 256, np.uint8, 64, 20),
    **{
        name: Kind("exr", exr_writer(name), (9, 40), 1024, np.float16, 16, 4)
        for name in exrscanlines.COMPRESSIONS
    },
}


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


class Failing(io.BytesIO):
    """A file whose `at`-th call, counted from 0, fails, and all behind it."""

    def __init__(self, at):
        super().__init__()
        self.at, self.calls, self.done = at, 0, False

    def _count(self):
        self.calls += 1
        if self.calls > self.at:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def write(self, data):
        self._count()
        return super().write(data)

    def seek(self, *where):
        self._count()
        return super().seek(*where)

    def close(self):
        if not self.done:
            self.done = True
            self._count()


def test_of_any_call(monkeypatch, kind):
    samples = kind.noise(*kind.size)

    def attempt(at):
        file = Failing(at)
        monkeypatch.setattr(segments, "open", lambda *_: file, raising=False)
        writer = kind.writer("any", samples)
        try:
            kind.fill(writer, samples)
        finally:
            assert file.done
        return file.calls

    calls = attempt(10**9)
    assert calls > kind.least_calls
    for at in range(calls):
        with pytest.raises(OutputError) as caught:
            attempt(at)
        assert f"out.{kind.ending}: cannot be written: input/output error" in str(caught.value)
        assert caught.value.exit_code == 5


def test_of_opening(tmp_path, kind):
    said = rf"^out\.{kind.ending}: cannot be written: no such file"
    with pytest.raises(OutputError, match=said):
        kind.writer(tmp_path / "gone" / "a", kind.noise(1, 1))


@pytest.mark.parametrize("size", [(2, 2), (600, 300)])
def test_a_full_device(kind, size):
    """A small picture waits in a buffer until the end, a large one does not."""
    samples = kind.noise(*size)
    with pytest.raises(OutputError, match=rf"out\.{kind.ending}: .*no space left on device"):
        kind.fill(kind.writer("/dev/full", samples), samples)


@pytest.mark.parametrize("ending", ["png", "exr"])
@pytest.mark.parametrize("limit", [0, 100, 10_000])
def test_a_limit_on_the_size_of_files(tmp_path, limit, ending):
    path = tmp_path / f"out.{ending}"
    path.write_bytes(OLD)
    pixels = np.random.default_rng(0).random((100, 100, 4))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(OutputError, match=rf"out\.{ending}: cannot be written: file too large"):
            hpcomp.write_image(path, pixels)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == OLD
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("ending", ["png", "exr"])
def test_it_is_exit_5_and_the_output_stays_what_it_was(tmp_path, ending):
    desk = Desk.made(tmp_path)
    desk.put("a.png", pngfile.random_png(pngfile.RGBA, 8, width=300, height=300).encode())
    desk.put(f"out.{ending}", OLD)
    desk.refuses(
        5, "stack", "a.png", "-o", f"out.{ending}",
        through=shell('ulimit -f 16; exec "$@"'), says=[f"out.{ending}", "file too large"],
    )  # fmt: skip


def test_given_up_in_the_middle(tmp_path, kind):
    samples = kind.noise(1200, 131)
    opened = kind.writer(tmp_path / "a", samples)
    opened.write(opened.prepare(0, samples[:48]))
    opened.abandon()
    with pytest.raises(ValueError, match="closed"):
        opened.write(opened.prepare(48, samples[48:]))
