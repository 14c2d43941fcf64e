"""How a stack is written down: the LAYER syntax of the command line. Reads no file."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Sequence
from typing import Any

from ..blending.porter_duff import OPERATOR_NAMES, operator
from ..color.css import css_color
from ..color.encodings import ALPHA_MODES, COLOR_INTEROP_IDS, COLOR_SPACES, color_space
from ..errors import SettingError, unknown_name
from ..geometry import GRAVITIES, Placement, parse_placement
from ..options import OPTIONS
from ..records import record
from ..system.streams import STDIN


@record
class LayerSpec:
    """One layer of a stack and its settings; None leaves a setting to the file or to the stack.

    `path`: a file, or `-` for stdin. `op`: an operator's name. `opacity`: 0 to 1.
    `at`: `+X+Y`, or a gravity with an optional offset: where the display window goes.
    `alpha`: one of `encodings.ALPHA_MODES`. `colorspace`: a name of `encodings.COLOR_SPACES`.
    `tint`: a CSS colour for a grey or single-channel mask, whose stored values are the alpha.
    `part`: name or index in a multi-part EXR. `layer`: the prefix of layered channel names, of a
    mask also the name of a channel. `name`: what reports and errors call it.
    Errors: `SettingError`.
    """

    path: str
    op: str | None = None
    opacity: float = 1.0
    at: str | None = None
    alpha: str | None = None
    colorspace: str | None = None
    tint: str | None = None
    part: str | None = None
    layer: str | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        if self.op is not None:
            operator(self.op)
        if not 0 <= self.opacity <= 1:
            raise SettingError(f"opacity {self.opacity:g} is outside 0 to 1")
        if self.alpha is not None and self.alpha not in ALPHA_MODES:
            raise unknown_name("alpha", self.alpha, ALPHA_MODES)
        if self.colorspace is not None:
            color_space(self.colorspace)
        if self.tint is not None:
            css_color(self.tint, "tint")
            if self.colorspace is not None and self.alpha != "luminance":
                raise SettingError(
                    "a mask with a tint says how much it covers, not how bright it is, so "
                    f"colorspace={self.colorspace} changes nothing: leave it out, or add "
                    "alpha=luminance"
                )
        _ = self.placement

    @property
    def placement(self) -> Placement | None:
        return None if self.at is None else parse_placement(self.at)

    @property
    def title(self) -> str:
        """What reports call the layer."""
        return self.name or ("stdin" if self.path == STDIN else self.path)

    def label(self, number: int) -> str:
        """How errors name the layer, such as `layer 3 (leaf.png)`."""
        shown = "stdin" if self.path == STDIN else self.path
        return f"layer {number} ({self.name + ': ' if self.name else ''}{shown})"


def _opacity(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SettingError(
            f"opacity '{text}' is not a number from 0 to 1{_opacity_like(text)}"
        ) from None


#: The keys of a LAYER: what turns the text after `=` into the setting.
LAYER_KEYS: dict[str, Callable[[str], Any]] = {
    "op": str,
    "opacity": _opacity,
    "at": str,
    "alpha": str,
    "colorspace": str,
    "tint": str,
    "part": str,
    "layer": str,
    "name": str,
}
#: Of the keys whose values are names of a table: those names.
LAYER_NAMES: dict[str, tuple[str, ...]] = {
    "op": OPERATOR_NAMES,
    "at": tuple(GRAVITIES),
    "alpha": ALPHA_MODES,
    "colorspace": (*COLOR_SPACES, *COLOR_INTEROP_IDS),
}


def parse_layer(text: str) -> LayerSpec:
    """A layer from `PATH[::key=value[,key=value]...]`.

    The last `::` splits, unless the whole text is an existing file.
    Errors: `SettingError` for an unknown or repeated key and for an opacity out of range.
    """
    path, separator, settings = text.rpartition("::")
    if os.path.exists(text):
        return LayerSpec(text)
    if not os.path.exists(path) and (meant := _layer_like(text)):
        raise SettingError(f"'{text}' names no file: did you mean '{meant}'?")
    if not separator:
        return LayerSpec(text)
    if not path:
        raise SettingError(f"'{text}' names no file before its ::")
    values: dict[str, Any] = {}
    for setting in _settings(settings):
        key, equals, value = setting.partition("=")
        if not equals or not value:
            raise SettingError(f"'{setting}' in '{text}' is not key=value{_setting_like(setting)}")
        if key not in LAYER_KEYS:
            if key.replace("-", "_") in OPTIONS:
                raise SettingError(f"'{key}' is an option of the stack: write --{key} {value}")
            raise unknown_name("layer key", key, LAYER_KEYS)
        if key in values:
            raise SettingError(f"key '{key}' stands twice in '{text}'")
        values[key] = LAYER_KEYS[key](value)
    return LayerSpec(path, **values)


# --- what was probably meant by another spelling --------------------------------------------------

#: Keys whose values are sometimes written as numbers with commas between them.
_OF_NUMBERS = ("opacity", "at", "tint")
_NUMBER = re.compile(r"\s*[+-]?[0-9.]+%?\s*\)?")
#: A path with its settings, but with another sign than `::` between them, or with several `::`.
_MISWRITTEN = re.compile(
    rf"(?P<path>.+?)(?::+|[,?]) *(?P<settings>(?:{'|'.join(LAYER_KEYS)})=.*)", re.DOTALL
)


def _settings(text: str) -> list[str]:
    """What stands between the commas; numbers stay with the setting that they seem to belong to."""
    settings: list[str] = []
    for setting in filter(None, text.split(",")):
        before = settings[-1].partition("=")[0] if settings else ""
        if before in _OF_NUMBERS and _NUMBER.fullmatch(setting):
            settings[-1] += f",{setting}"
        else:
            settings.append(setting)
    return settings


def _opacity_like(text: str) -> str:
    """The opacity that was probably meant, as the end of a message."""
    with contextlib.suppress(ValueError):
        number = text.strip().replace(",", ".")
        value = float(number[:-1]) / 100 if number.endswith("%") else float(number)
        if 0 <= value <= 1:
            return f": write {value:g}"
    return ""


def _layer_like(text: str) -> str:
    """The layer that was probably meant; empty unless its file exists."""
    match = _MISWRITTEN.fullmatch(text)
    if match is None or not os.path.exists(match["path"]):
        return ""
    return f"{match['path']}::{re.sub('::+', ',', match['settings'])}"


def _setting_like(text: str) -> str:
    """The setting that was probably meant, as the end of a message."""
    key, colon, value = text.partition(":")
    if colon and value and key in LAYER_KEYS:
        return f": write {key}={value}"
    keys = [key for key, names in LAYER_NAMES.items() if text in names]
    return f": did you mean {keys[0]}={text}?" if keys else ""


def check_stdin(specs: Sequence[LayerSpec], what: str) -> None:
    """Refuses stdin for more than one of `what`, such as "layers". Errors: `SettingError`."""
    if [spec.path for spec in specs].count(STDIN) > 1:
        raise SettingError(f"stdin can be only one of the {what}")


def layer_spec(layer: LayerSpec | str | os.PathLike[str]) -> LayerSpec:
    """A layer from LAYER syntax, from a path object (taken whole), or as it is."""
    if isinstance(layer, LayerSpec):
        return layer
    return parse_layer(layer) if isinstance(layer, str) else LayerSpec(os.fspath(layer))
