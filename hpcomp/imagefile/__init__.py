"""Image files in and out, strip by strip. `openimageio` is the only importer of OpenImageIO.

Reading gives samples as stored and what they mean; writing takes samples of the output's type.
Where a layer lies on the canvas, and what is done with it, is not known here.
"""

from .deepreading import DeepReader, open_deep
from .description import describe
from .parts import METRES_PER_INCH, ColorGroup, ImageFile, Part, choose
from .reading import NONFINITE_POLICIES, STRIP_ROWS, LayerImage, LayerReader
from .seekable import STDIN, seekable
from .source import codec_threads
from .writing import ImageWriter, OutputForm, format_of_output, open_writer

__all__ = [
    "METRES_PER_INCH",
    "NONFINITE_POLICIES",
    "STDIN",
    "STRIP_ROWS",
    "ColorGroup",
    "DeepReader",
    "ImageFile",
    "ImageWriter",
    "LayerImage",
    "LayerReader",
    "OutputForm",
    "Part",
    "choose",
    "codec_threads",
    "describe",
    "format_of_output",
    "open_deep",
    "open_writer",
    "seekable",
]
