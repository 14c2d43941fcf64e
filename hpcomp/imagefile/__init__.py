"""Image files in and out, strip by strip. The only importer of OpenImageIO.

Reading gives linear Rec. 709, premultiplied float32 RGBA whatever the file holds; writing takes it.
Where a layer lies on the canvas, and what is done with it, is not known here.
"""

from .description import STDIN, ColorGroup, ImageFile, Part, choose, describe, seekable
from .library import codec_threads
from .reading import NONFINITE_POLICIES, STRIP_ROWS, LayerImage, LayerReader, Rgba
from .writing import ImageWriter, OutputForm, format_of_output

__all__ = [
    "NONFINITE_POLICIES",
    "STDIN",
    "STRIP_ROWS",
    "ColorGroup",
    "ImageFile",
    "ImageWriter",
    "LayerImage",
    "LayerReader",
    "OutputForm",
    "Part",
    "Rgba",
    "choose",
    "codec_threads",
    "describe",
    "format_of_output",
    "seekable",
]
