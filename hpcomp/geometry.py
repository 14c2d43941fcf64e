"""Windows of pixels and where a layer is placed: integer rectangles, no pixels."""

from __future__ import annotations

import re
from collections.abc import Iterator

from .errors import SettingError, unknown_name
from .records import record


@record
class Window:
    """A rectangle of pixels: its top-left pixel and its size; y grows downwards."""

    x: int
    y: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}{self.x:+d}{self.y:+d}"

    @property
    def right(self) -> int:
        """The first column beyond the window."""
        return self.x + self.width

    @property
    def bottom(self) -> int:
        """The first row beyond the window."""
        return self.y + self.height

    @property
    def pixels(self) -> int:
        """How many there are in it."""
        return self.width * self.height

    def moved(self, dx: int, dy: int) -> Window:
        return Window(self.x + dx, self.y + dy, self.width, self.height)

    def union(self, other: Window) -> Window:
        return _between(
            min(self.x, other.x),
            min(self.y, other.y),
            max(self.right, other.right),
            max(self.bottom, other.bottom),
        )

    def intersection(self, other: Window) -> Window | None:
        """What both cover, or None where they do not touch."""
        common = _between(
            max(self.x, other.x),
            max(self.y, other.y),
            min(self.right, other.right),
            min(self.bottom, other.bottom),
        )
        return common if common.width > 0 and common.height > 0 else None

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns, of an array that begins where coordinates do."""
        return slice(self.y, self.bottom), slice(self.x, self.right)

    def strips(self, rows: int, missing: int = 0) -> Iterator[Window]:
        """Its rows from the top, so many at a time; the first ones are fewer by what is missing."""
        for top, bottom in _pieces(self.y, self.bottom, rows, missing):
            yield Window(self.x, top, self.width, bottom - top)

    def blocks(self, pixels: int, cell: int = 1) -> Iterator[Window]:
        """All of it in blocks of up to so many pixels: of whole rows, or else of parts of a few.

        Every cell, a square of that side between multiples of it, is in one block, and a block has
        one at least.
        """
        rows = max(cell, pixels // max(1, self.width) // cell * cell)
        columns = max(cell, pixels // min(rows, max(1, self.height)) // cell * cell)
        for strip in self.strips(rows, self.y % cell):
            for left, right in _pieces(self.x, self.right, columns, self.x % cell):
                yield Window(left, strip.y, right - left, strip.height)

    def contains(self, other: Window) -> bool:
        return self.intersection(other) == other


def _pieces(begin: int, end: int, size: int, missing: int) -> Iterator[tuple[int, int]]:
    """Begins and ends of pieces of that size; the first lacks what is missing at its begin."""
    for at in range(begin - missing, end, size):
        yield max(at, begin), min(at + size, end)


def _between(left: int, top: int, right: int, bottom: int) -> Window:
    return Window(left, top, right - left, bottom - top)


#: How far from the origin a window may be: pictures are counted in 32-bit numbers.
FARTHEST = 2**28

_WINDOW = re.compile(r"(\d{1,99})x(\d{1,99})([+-]\d{1,99})([+-]\d{1,99})", re.ASCII)


def parse_window(text: str) -> Window:
    """A window from `WxH+X+Y`; `SettingError` otherwise, or where it holds no pixel."""
    match = _WINDOW.fullmatch(text)
    if not match:
        raise SettingError(f"'{text}' is not a window: write WxH+X+Y, {_window_like(text)}")
    width, height, x, y = map(int, match.groups())
    if not width or not height:
        raise SettingError(f"window '{text}' holds no pixel: give it a width and a height")
    if max(width, height, abs(x), abs(y)) > FARTHEST:
        raise SettingError(f"window '{text}' reaches beyond {FARTHEST} pixels")
    return Window(x, y, width, height)


#: The canvases that have a name; any other is a window.
CANVASES = ("bottom", "union", "intersection")


def parse_canvas(canvas: str | Window) -> str | Window:
    """A canvas's name as it is, or its window from `WxH+X+Y`; `SettingError` otherwise."""
    if isinstance(canvas, Window) or canvas in CANVASES:
        return canvas
    try:
        return parse_window(canvas)
    except SettingError:
        if _WINDOW.fullmatch(canvas):
            raise
        window = f", or WxH+X+Y, {_window_like(canvas)}"
        raise unknown_name("canvas", canvas, CANVASES, otherwise=window) from None


#: Where in a reference window a layer sits: its share of the free space to the left and above.
GRAVITIES: dict[str, tuple[float, float]] = {
    "north-west": (0.0, 0.0),
    "north": (0.5, 0.0),
    "north-east": (1.0, 0.0),
    "west": (0.0, 0.5),
    "center": (0.5, 0.5),
    "east": (1.0, 0.5),
    "south-west": (0.0, 1.0),
    "south": (0.5, 1.0),
    "south-east": (1.0, 1.0),
}


@record
class Placement:
    """Where a layer's display window goes: at (x, y), or that far from where `gravity` puts it."""

    gravity: str | None
    x: int
    y: int

    def __str__(self) -> str:
        offset = f"{self.x:+d}{self.y:+d}" if self.gravity is None or self.x or self.y else ""
        return (self.gravity or "") + offset

    def turned_inwards(self) -> Placement:
        """The same where its offsets lead away from the edges at which its gravity is.

        Other programs, such as ImageMagick, count from these edges.
        """
        left, above = GRAVITIES[self.gravity] if self.gravity else (0.5, 0.5)
        x = {0.0: abs(self.x), 1.0: -abs(self.x)}.get(left, self.x)
        y = {0.0: abs(self.y), 1.0: -abs(self.y)}.get(above, self.y)
        return Placement(self.gravity, x, y)

    def place(self, window: Window, reference: Window) -> Window:
        """`window` moved to its place; `reference` is what a gravity refers to."""
        if self.gravity is None:
            return Window(self.x, self.y, window.width, window.height)
        left, above = GRAVITIES[self.gravity]
        # Half a pixel of free space goes to the right and below, as in ImageMagick.
        return Window(
            reference.x + int((reference.width - window.width) * left // 1) + self.x,
            reference.y + int((reference.height - window.height) * above // 1) + self.y,
            window.width,
            window.height,
        )


_PLACEMENT = re.compile(r"([a-z-]*[a-z])?(?:([+-]\d{1,99})([+-]\d{1,99}))?", re.ASCII)


def parse_placement(text: str) -> Placement:
    """A placement from `+X+Y`, a gravity, or a gravity with an offset such as `south+0-10`.

    Offsets count pixels to the right and downwards, whatever the gravity.
    """
    match = _PLACEMENT.fullmatch(text)
    if not match or not text:
        raise SettingError(f"'{text}' is not a place: write {_place_like(text)}")
    gravity, x, y = match.groups()
    if gravity is not None and gravity not in GRAVITIES:
        raise unknown_name("gravity", gravity, GRAVITIES, meant=_gravity_like(gravity))
    if max(abs(int(x or 0)), abs(int(y or 0))) > FARTHEST:
        raise SettingError(f"place '{text}' is beyond {FARTHEST} pixels")
    return Placement(gravity, int(x or 0), int(y or 0))


# --- what was probably meant by another spelling --------------------------------------------------

_SIZE = re.compile(r"([1-9][0-9]{0,8}) *[xX×*] *([1-9][0-9]{0,8})(?![0-9])")
_INTEGER = re.compile(r"[+-]?[0-9]{1,9}(?![0-9])")
#: What people write between the numbers of a window or a place.
_BETWEEN = re.compile(r"[\s+,;:@xX×*-]*")


def _window_like(text: str) -> str:
    """The window that was probably meant, as the end of a message; any window if that is none."""
    size = _SIZE.search(text)
    beside = integers(_SIZE.sub(" ", text, count=1))
    numbers = integers(text) or []
    if size and beside is not None and len(beside) in (0, 2):
        return f"such as {Window(*(beside or (0, 0)), *map(int, size.groups()))}"
    if len(numbers) == 4 and min(numbers[2:]) > 0:
        x, y, width, height = numbers
        return f"such as {Window(*numbers)} for the corner {x},{y} and the size {width}x{height}"
    return "such as 640x480+0+0"


def integers(text: str) -> list[int] | None:
    """The whole numbers of a text; None where it has more than these and what parts them."""
    if not _BETWEEN.fullmatch(_INTEGER.sub(" ", text)):
        return None
    return [int(number) for number in _INTEGER.findall(text)]


#: What the sides of a picture are called elsewhere.
_SIDES = {"top": "north", "upper": "north", "bottom": "south", "lower": "south", "left": "west",
          "right": "east", "middle": "center", "centre": "center"}  # fmt: skip


def _place_like(text: str) -> str:
    """The place that was probably meant; any place if that is none."""
    gravity, rest = re.fullmatch(r"\s*([A-Za-z -]*[A-Za-z])?(.*)", text, re.DOTALL).groups()  # type: ignore[union-attr]
    numbers = integers(_SIZE.sub(" ", rest, count=1)) or integers(rest) or []
    offset = f"{numbers[0]:+d}{numbers[1]:+d}" if len(numbers) == 2 else ""
    name = gravity and (gravity if gravity in GRAVITIES else _gravity_like(gravity))
    if (offset and not gravity) or (name and (offset or not rest)):
        return f"{name or ''}{offset}"
    return "+X+Y, or a gravity such as center or south+0-10"


def _gravity_like(name: str) -> str:
    """The gravity that says the same in other words; empty if they are none."""
    words = [_SIDES.get(word, word) for word in re.split(r"[\s_-]+", name.lower())]
    said = {"".join(words), "".join(words[::-1])}
    return next((gravity for gravity in GRAVITIES if gravity.replace("-", "") in said), "")
