"""What a file is that is neither PNG nor EXR, by its first bytes, and how to make one of it."""

from __future__ import annotations

import os
import shlex

from ..records import record


@record
class OtherFormat:
    """A format by the bytes with which its files begin, from `offset` on.

    `convert`: a command in which IN and OUT stand for paths, or what else to do; `oiiotool` comes
    with OpenImageIO, and so with hpcomp.
    """

    name: str
    magic: bytes
    convert: str
    offset: int = 0


_BY_OIIOTOOL = "oiiotool --no-autopremult IN -o OUT.png"
_BY_IMAGEMAGICK = "magick IN OUT.png"
_TO_EXR = "oiiotool IN -o OUT.exr"
_BY_AN_EDITOR = "write it as PNG or EXR with the program that made it"

OTHER_FORMATS = (
    OtherFormat("a JPEG file", b"\xff\xd8\xff", _BY_OIIOTOOL),
    OtherFormat("a TIFF file", b"II*\0", _BY_OIIOTOOL),
    OtherFormat("a TIFF file", b"MM\0*", _BY_OIIOTOOL),
    OtherFormat("a TIFF file", b"II+\0", _BY_OIIOTOOL),
    OtherFormat("a TIFF file", b"MM\0+", _BY_OIIOTOOL),
    OtherFormat("a WebP file", b"WEBP", _BY_OIIOTOOL, 8),
    OtherFormat("a GIF file", b"GIF8", _BY_OIIOTOOL),
    OtherFormat("a BMP file", b"BM", _BY_OIIOTOOL),
    OtherFormat("a PNM file", b"P5\n", _BY_OIIOTOOL),
    OtherFormat("a PNM file", b"P6\n", _BY_OIIOTOOL),
    OtherFormat("a DPX file", b"SDPX", _BY_OIIOTOOL),
    OtherFormat("a DPX file", b"XPDS", _BY_OIIOTOOL),
    OtherFormat("a Photoshop file", b"8BPS", _BY_OIIOTOOL),
    OtherFormat("a Radiance HDR file", b"#?RADIANCE", _TO_EXR),
    OtherFormat("a Radiance HDR file", b"#?RGBE", _TO_EXR),
    OtherFormat("an AVIF file", b"ftypavif", _BY_IMAGEMAGICK, 4),
    OtherFormat("a HEIF file", b"ftyphei", _BY_IMAGEMAGICK, 4),
    OtherFormat("a HEIF file", b"ftypmif1", _BY_IMAGEMAGICK, 4),
    OtherFormat("a JPEG XL file", b"JXL \r\n", _BY_IMAGEMAGICK, 4),
    OtherFormat("a JPEG XL file", b"\xff\x0a", _BY_IMAGEMAGICK),
    OtherFormat("a JPEG 2000 file", b"jP  \r\n", _BY_IMAGEMAGICK, 4),
    OtherFormat("a file of GIMP", b"gimp xcf", _BY_AN_EDITOR),
    OtherFormat("a PDF file", b"%PDF-", "pdftocairo -png -transp -r 300 IN OUT"),
    OtherFormat("a Git LFS pointer", b"version https://git-lfs", "git lfs pull"),
    OtherFormat("a ZIP archive", b"PK\3\4", "unpack it first"),
    OtherFormat("packed with gzip", b"\x1f\x8b", "unpack it first"),
)
_SVG = OtherFormat("an SVG file", b"<svg", "rsvg-convert IN -o OUT.png")
_WEB_PAGE = OtherFormat(
    "a web page", b"<html", "look into it, as a server may have sent it in place of the file"
)


def what_it_is(head: bytes, path: str, shown: bool) -> str:
    """What a file is that begins so, and what to do, behind its label; empty if that is unknown.

    `shown`: whether users know the file by its path, which then stands in the command.
    """
    known = next((f for f in OTHER_FORMATS if head[f.offset :].startswith(f.magic)), None)
    if known is None and head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        text = head.lower()
        known = next((f for f in (_SVG, _WEB_PAGE) if f.magic in text), None)
    if known is None:
        return ""
    if " IN" not in known.convert:
        return f"is {known.name}: {known.convert}"
    command = known.convert
    if shown:
        stem, ending = os.path.splitext(path)
        # The ending may lie, and no file is to be replaced by its own conversion.
        stem += "-converted" if ending and f"OUT{ending}" in command else ""
        paths = {"IN": path, "OUT": stem, "OUT.png": f"{stem}.png", "OUT.exr": f"{stem}.exr"}
        words = (_quoted(paths[w]) if w in paths else w for w in command.split())
        command = " ".join(words)
    return f"is {known.name}: convert it, such as with: {command}"


def _quoted(path: str) -> str:
    return shlex.quote(path if not path.startswith("-") else f"./{path}")
