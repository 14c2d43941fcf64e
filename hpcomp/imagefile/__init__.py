"""Image files in and out, strip by strip. `openimageio` is the only importer of OpenImageIO.

Reading gives samples as stored and what they mean; writing takes samples of the output's type.
Where a layer lies on the canvas, and what is done with it, is not known here.
"""
