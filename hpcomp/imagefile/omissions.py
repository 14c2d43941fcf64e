"""What a file holds that is not in the picture which is read of it. From headers alone, no pixels.

Metadata that say nothing of the picture, smaller levels of a mipmap, and channels that are no
colour, such as depth, are not spoken of.
"""

from __future__ import annotations

from .parts import ColorGroup, ImageFile, Omission, Part
from .pngheader import PngHeader


def omissions_of_png(header: PngHeader) -> tuple[Omission, ...]:
    """What of a PNG is not read, whatever is chosen of it."""
    return tuple(Omission(text) for text in header.dropped)


def omissions(file: ImageFile, part: Part, group: ColorGroup) -> tuple[Omission, ...]:
    """What of the file is not in the picture where this colour of this part is read."""
    found = list(part.omissions)
    if part.deep and not group.color and group.alpha is not None:
        found.append(
            Omission(
                f"it has no colour, only the alpha {group.alpha.name}: its samples are black, and "
                "hide what is behind them",
                ("part", "layer"),
            )
        )
    return tuple(found)
