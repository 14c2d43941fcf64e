"""What is read only in part is said: headers of every kind, and which settings say what is meant."""

from __future__ import annotations

import json
import struct
import subprocess
import sysconfig
import warnings
from pathlib import Path

import command
import deepfile
import exrfile
import numpy as np
import pngfile
import pytest

import hpcomp
from hpcomp import InputError, InputWarning

SIZE = (9, 8)


def said_of(path, **options):
    """What a warning says of the file; a strict run refuses it for the same."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        hpcomp.read_layer(path, **options)
    said = [str(warning.message) for warning in caught]
    assert all(issubclass(warning.category, InputWarning) for warning in caught)
    if said:
        with pytest.raises(InputError) as refused:
            hpcomp.read_layer(path, strict=True, **options)
        assert str(refused.value) == f"{said[0]} (an error with --strict)"
    else:
        hpcomp.read_layer(path, strict=True, **options)
    return said


def assert_said(path, words, answers):
    """One line with these words, until a setting answers it; `info` says the same."""
    (line,) = said_of(path)
    assert words in line
    for answer in answers:
        assert said_of(path, **answer) == [], answer
    desk = command.Desk(path.parent, path.parent)
    (file,) = json.loads(desk.run("info", "--json", path).stdout)["files"]
    assert [f"{path}: {text}" for text in file["warnings"]] == [line]
    assert f"warning: {file['warnings'][0]}" in desk.run("info", path).stdout.decode()


# ---- EXR ------------------------------------------------------------------------------------


def exr(tmp_path, *parts, name="a.exr", sizes=None):
    """A file of parts, each of the channels of these names."""
    made = [
        (
            f"p{number}",
            exrfile.planes(names, *(sizes or [SIZE] * len(parts))[number]),
            {"display": (0, 0, *SIZE)},
        )
        for number, names in enumerate(parts)
    ]
    return exrfile.write_parts(tmp_path / name, made)


LEFT_OUT = {
    "alpha in another part": (["RGB", "A"], "the alpha A in part 1 (p1) is not read", ["alpha"]),
    "alpha in the part before": (["A", "RGB"], "the alpha A in part 0 (p0) is not read", ["alpha"]),
    "alpha of grey": (["Y", "A"], "the alpha A in part 1 (p1) is not read", ["alpha"]),
    "alpha of the layer in another part": (
        [["b.R", "b.G", "b.B"], ["b.A"]], "the alpha b.A in part 1 (p1) is not read", ["alpha"]
    ),
    "alpha around the layer": (
        [["b.R", "b.G", "b.B", "A"]], "the alpha A is not read, and the layer is opaque", ["alpha"]
    ),
    "alphas of colours": (
        [["R", "G", "B", "AR", "AG", "AB"]],
        "its alphas of single colours, AR, AG, AB, are not read, and the layer is opaque",
        ["alpha"],
    ),
    "alphas of colours beside an A": (
        [["R", "G", "B", "A", "AR", "AG", "AB"]], "AR, AG, AB, are not read, only A is", ["alpha"]
    ),
    "chroma in another part": (
        ["Y", ["RY", "BY"]], "the colours BY, RY in part 1 (p1) are not read, and it is grey", []
    ),
    "layers": (
        [[*"RGBA", "d.R", "d.G", "d.B", "s.Y"]],
        "the layer without a name is read, and not layer d, layer s: choose",
        ["part", "layer"],
    ),
    "a layer in another part": (
        ["RGBA", ["d.R", "d.G", "d.B"]],
        "the layer without a name of part 0 (p0) is read, and not layer d of part 1 (p1): choose",
        ["part", "layer"],
    ),
    "the other eye": (
        [[*"RGBA", "right.R", "right.G", "right.B", "right.A"]],
        "is read, and not layer right: choose",
        ["part", "layer"],
    ),
    "many layers": (
        [[*"RGB", *(f"l{n}.Y" for n in range(9))]],
        "not layer l0, layer l1, layer l2, layer l3, layer l4 and 4 others",
        ["part", "layer"],
    ),
}  # fmt: skip
ANSWERS = {"part": {"part": 0}, "layer": {"layer": "d"}, "alpha": {"alpha": "premultiplied"}}


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_of_an_exr(tmp_path, kind):
    parts, words, settings = LEFT_OUT[kind]
    path = exr(tmp_path, *parts)
    answers = [ANSWERS[name] for name in settings if name != "layer" or "layer d" in words]
    assert_said(path, words, answers)


@pytest.mark.parametrize(
    "parts",
    [
        ["RGBA"],
        ["RGB"],
        ["RGBAZ"],
        [["R", "G", "B", "A", "id", "N.X", "N.Y", "N.Z", "motion.x"]],
        ["RGBA", "Z"],
        [[*"RGBA", *(f"{layer}.{c}" for layer in ("N", "crypto_object00", "view.P", "uv") for c in "RGB")]],
        ["RGBA", ["motionVectors.R", "motionVectors.G", "motionVectors.B"]],
        ["RGB", ["crypto.A"]],
        [["b.R", "b.G", "b.B", "b.A"]],
    ],
    ids=str,
)
def test_depths_vectors_and_numbers_are_no_part_of_a_picture(tmp_path, parts):
    assert said_of(exr(tmp_path, *parts)) == []


def test_an_alpha_of_another_size_is_of_another_picture(tmp_path):
    assert said_of(exr(tmp_path, "RGB", "A", sizes=[SIZE, (5, 5)])) == []


def test_a_mask_is_no_picture_without_its_colours(tmp_path):
    assert said_of(exr(tmp_path, ["A", "Z"]), tint="red") == []
    assert said_of(exr(tmp_path, [*"RGBA", "m.A"]), tint="red", layer="m") == []


def test_colours_that_are_spread_over_parts_are_said_to_be(tmp_path):
    with pytest.raises(InputError, match="R, G and B are in several parts, of which one is read"):
        hpcomp.read_layer(exr(tmp_path, "RG", "B"))


def subsampled(tmp_path, *parts):
    """A file of parts in which RY and BY have one value for 2x2 pixels."""
    path = exr(tmp_path, *parts, sizes=[(8, 8)] * len(parts))
    data = bytearray(path.read_bytes())
    for name in (b"\0RY\0", b"BY\0"):
        place = data.index(name) + len(name) + 8
        assert struct.unpack_from("<ii", data, place) == (1, 1)
        struct.pack_into("<ii", data, place, 2, 2)
    path.write_bytes(data)
    return path


def test_a_part_that_cannot_be_read_is_not_passed_over(tmp_path):
    """OpenImageIO ends with the part before, as if the file had no more."""
    path = subsampled(tmp_path, "RGBA", ["Y", "RY", "BY"], "Z")
    said = said_of(path)
    words = "part 1 (p1) cannot be read, its channels are subsampled"
    assert [line.partition(": ")[2] for line in said] == [words]
    assert said_of(path, part=0) == []
    assert said_of(path, part=2, tint="red") == []
    assert [part.name for part in hpcomp.info(path).parts] == ["p0", "p1", "p2"]
    with pytest.raises(InputError, match="its channels BY, RY are subsampled"):
        hpcomp.read_layer(path, part=1)
    # Nor are its channels looked for a mask.
    with pytest.raises(InputError, match="there is no colour layer 'Y'"):
        hpcomp.read_layer(path, layer="Y", tint="red")


def test_a_part_behind_one_that_cannot_be_read(tmp_path):
    """OpenImageIO opens no such file; the part has its colours, and is told what is in its way."""
    path = subsampled(tmp_path, ["Y", "RY", "BY"], "RGBA")
    for settings in ({"part": 1}, {"part": 1, "tint": "red"}, {"part": 1, "layer": "A", "tint": "red"}):
        with pytest.raises(InputError, match="part p1 cannot be read, as the channels of part p0"):
            hpcomp.read_layer(path, **settings)
    with pytest.raises(InputError, match="its channels BY, RY are subsampled"):
        hpcomp.read_layer(path)


def test_flat_and_deep_parts_of_one_file(tmp_path):
    """Each command reads its own, and says that the others are there."""
    deep = deepfile.noise(5, 4, 3)
    deepfile.write(tmp_path / "deep.exr", deep, deepfile.noise(5, 4, 3, seed=1, name="second"))
    desk = command.Desk(tmp_path, tmp_path)
    run = desk.run("flatten", "deep.exr::part=second", "-o", "out.exr")
    assert (run.code, run.stderr) == (0, "")
    names = ("R", "G", "B", "A", "Z", "glow.R", "glow.G", "glow.B")
    pixel = [[[(0.5, 0, 0, 0.5, 1.0, 0, 0.5, 0)]]]
    deepfile.write(tmp_path / "layers.exr", deepfile.of_pixels(pixel, names))
    run = desk.run("flatten", "layers.exr", "-o", "out.exr")
    words = "layers.exr: the layer without a name is read, and not layer glow: choose"
    assert (run.code, run.stderr.count("\n")) == (0, 1)
    assert words in run.stderr
    assert words.removeprefix("layers.exr: ") in desk.run("info", "layers.exr").stdout.decode()
    assert desk.run("flatten", "layers.exr::part=0", "-o", "out.exr", "--strict").code == 0
    run = desk.run("flatten", "layers.exr", "-o", "out.exr", "--strict")
    assert run.code == 3
    assert words in run.stderr


# ---- PNG ------------------------------------------------------------------------------------


def exif(orientation, order="<"):
    start = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(f"{order}I", 8)
    entries = [(0x0100, 3, 1, 9), (0x0112, 3, 1, orientation)]
    rows = b"".join(struct.pack(f"{order}HHIHH", *entry, 0) for entry in entries)
    return b"eXIf", start + struct.pack(f"{order}H", len(entries)) + rows + bytes(4)


def actl(frames):
    return b"acTL", struct.pack(">II", frames, 0)


def offs(x, y, unit=0):
    return b"oFFs", struct.pack(">iiB", x, y, unit)


KINDS = {
    "rgba": pngfile.random_png(pngfile.RGBA, 8, width=9, height=8),
    "palette": pngfile.random_png(pngfile.PALETTE, 8, width=9, height=8),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("chunk", "words", "answer"),
    [
        (actl(12), "it is animated, and of its 12 frames none is read but", {"part": 0}),
        (exif(6), "it is to be turned (orientation 6), and it is read as stored", {"part": 0}),
        (exif(3, ">"), "it is to be turned (orientation 3)", {"part": 0}),
        (offs(10, -20), "its oFFs chunk puts it at +10-20, and it is not put there: at=+10-20", {}),
    ],
    ids=["acTL", "eXIf", "eXIf, big end first", "oFFs"],
)
def test_of_a_png(tmp_path, kind, chunk, words, answer):
    path = tmp_path / "a.png"
    path.write_bytes(KINDS[kind].with_chunks(head=[chunk]).encode())
    assert_said(path, words, [answer] if answer else [])


@pytest.mark.parametrize(
    "chunk",
    [actl(1), exif(1), exif(0), exif(9), (b"eXIf", b"II*\0"), (b"eXIf", b"MM\0*" + bytes(4)),
     (b"eXIf", b"Exif\0\0II*\0"), offs(0, 0), offs(5, 5, 1), (b"oFFs", b"\0\0"),
     pngfile.bkgd(1, 2, 3), (b"sBIT", b"\5\5\5\5"), pngfile.phys(300, 300), pngfile.time()],
    ids=lambda chunk: chunk[0].decode(),
)  # fmt: skip
def test_chunks_that_leave_nothing_out(tmp_path, chunk):
    path = tmp_path / "a.png"
    path.write_bytes(KINDS["rgba"].with_chunks(head=[chunk]).encode())
    assert said_of(path) == []


def test_a_place_answers_where_it_is_put(tmp_path):
    """In a stack it can be placed; a histogram is the same wherever it lies."""
    desk = command.Desk(tmp_path, tmp_path)
    (tmp_path / "a.png").write_bytes(KINDS["rgba"].with_chunks(head=[offs(3, 4)]).encode())
    run = desk.run("stack", "a.png", "-o", "out.png")
    assert (run.code, run.stderr.count("at=+3+4 does that")) == (0, 1)
    assert desk.run("stack", "a.png", "-o", "out.png", "--strict").code == 3
    for place in ("+3+4", "+0+0", "center"):
        assert desk.run("stack", f"a.png::at={place}", "-o", "out.png", "--strict").code == 0
    assert desk.run("hues", "a.png", "--strict").code == 0


def test_the_command_that_turns_a_picture_does(tmp_path):
    (tmp_path / "a.png").write_bytes(KINDS["rgba"].with_chunks(head=[exif(6)]).encode())
    tool = Path(sysconfig.get_path("scripts")) / "oiiotool"
    subprocess.run([tool, "--no-autopremult", "a.png", "--reorient", "-o", "b.png"], cwd=tmp_path, check=True)
    assert said_of(tmp_path / "b.png") == []
    turned = np.rot90(KINDS["rgba"].samples, -1)
    assert np.array_equal(pngfile.decode((tmp_path / "b.png").read_bytes()), turned)


def test_another_png_behind_the_end(tmp_path):
    """As a program that writes frames to a pipe makes it; any other bytes are no picture."""
    data = KINDS["rgba"].encode()
    path = tmp_path / "a.png"
    path.write_bytes(data + data)
    assert_said(path, "another PNG is behind its end, and it is left out", [])
    path.write_bytes(data + b"\n")
    assert said_of(path) == []


@pytest.mark.parametrize(
    ("png", "transparency"),
    [
        (pngfile.random_png(pngfile.RGBA, 8), bytes(6)),
        (pngfile.random_png(pngfile.GREY_ALPHA, 8), bytes(2)),
        (pngfile.random_png(pngfile.RGB, 8), bytes(5)),
        (pngfile.random_png(pngfile.GREY, 8), bytes(6)),
        (pngfile.random_png(pngfile.PALETTE, 2), bytes(5)),
        (pngfile.random_png(pngfile.PALETTE, 2), b""),
    ],
    ids=["RGBA", "grey and alpha", "RGB of 5 bytes", "grey of 6", "palette of more", "of none"],
)
def test_a_transparency_that_does_not_fit_is_left_out_with_a_word(tmp_path, png, transparency):
    path = tmp_path / "a.png"
    path.write_bytes(png.with_chunks(body=[(b"tRNS", transparency)]).encode())
    with pytest.warns(InputWarning, match="its tRNS chunk does not fit it, and it is left out"):
        found = hpcomp.read_layer(path).pixels
    assert np.abs(found - png.linear()).max() < 2e-6


def test_a_transparency_before_its_palette_is_left_out_with_a_word(tmp_path):
    """As libpng leaves it out: PNG third edition, 5.6, has it behind the palette."""
    png = pngfile.random_png(pngfile.PALETTE, 8)
    path = tmp_path / "a.png"
    path.write_bytes(png.with_chunks(head=[(b"tRNS", bytes(3))]).encode())
    assert_said(path, "its tRNS chunk does not fit it, and it is left out", [])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert np.abs(hpcomp.read_layer(path).pixels - png.linear()).max() < 2e-6
