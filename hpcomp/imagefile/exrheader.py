"""Why OpenImageIO refuses an EXR, from its header. The only importer of OpenEXR."""

from __future__ import annotations


def explain(path: str) -> str:
    """What in the header of an EXR cannot be read here, or an empty string.

    Called only after a failure, so that the module is not imported for files that can be read.
    """
    try:
        import OpenEXR

        with OpenEXR.File(path, header_only=True) as file:
            channels = [channel for part in file.parts for channel in part.header["channels"]]
    except Exception:  # a damaged header fails in many ways, and then it explains nothing
        return ""
    subsampled = [c.name for c in channels if (c.xSampling, c.ySampling) != (1, 1)]
    if subsampled:
        names = ", ".join(subsampled)
        return f"its channels {names} are subsampled (luminance/chroma): store it as RGB"
    return ""
