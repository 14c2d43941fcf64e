"""The layers of a stack, opened and placed on their canvas. Blends nothing, writes nothing."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence

from ..blending.rules import StackRules
from ..color.primaries import BOTTOM
from ..color.samples import NOTHING, Strip, cropped, nonfinite_pixels
from ..errors import SettingError
from ..geometry import Window
from ..imagefile.reading import LayerReader
from ..options import RuleOptions, StackOptions
from ..records import record
from .canvas import LayerWindows, lay_out
from .layerspec import LayerSpec, check_stdin, layer_spec
from .notices import Notices, warn_of_layers
from .opening import opened_layer

Layer = LayerSpec | str | os.PathLike[str]

#: Files that are open beside the layers: libraries, the output, the standard streams.
OTHER_OPEN_FILES = 64


@record
class PlacedLayer:
    """An open layer and how far its file's coordinates move to the canvas."""

    reader: LayerReader
    dx: int
    dy: int

    @property
    def window(self) -> Window:
        """Its pixels, in canvas coordinates."""
        return self.reader.window.moved(self.dx, self.dy)

    def read(self, rows: Window) -> Strip:
        """What the layer has of `rows` of the canvas, `NOTHING` where it has nothing there.

        Its file is open from its first row to its last one: thousands of layers may follow.
        """
        common = self.window.intersection(rows)
        if common is None:
            return NOTHING
        begin = common.y - self.dy
        samples = self.reader.read_samples(begin, begin + common.height)
        if common.bottom == self.window.bottom:
            self.reader.close()
        return Strip(samples, self.reader.decoding, self.window.x - rows.x, common.y - rows.y)

    def read_checked(self, rows: Window) -> Strip:
        """What the layer has of `rows` and of no column beside them; the samples are a view.

        Errors: also `MismatchError`, for NaN and Inf where the policy refuses them.
        """
        strip = cropped(self.read(rows), rows.width, rows.height)
        broken = nonfinite_pixels(strip.samples)
        if broken is not None:
            self.reader.note_nonfinite(max(rows.y, self.window.y) - self.dy, int(broken.sum()))
        return strip


@record
class PlacedStack:
    """Open layers, bottom first, on their canvas.

    `rules`: those that were asked for, in the working primaries that the layers are read in.
    """

    rules: StackRules
    canvas: Window
    layers: tuple[PlacedLayer, ...]


def layer_specs(layers: Sequence[Layer]) -> list[LayerSpec]:
    """Every layer's settings, in the order given; `SettingError` names the layer."""
    return [_numbered(number, layer) for number, layer in enumerate(layers)]


def _numbered(number: int, layer: Layer) -> LayerSpec:
    try:
        return layer_spec(layer)
    except SettingError as problem:
        raise SettingError(f"layer {number} ({layer}): {problem}") from None


def rules_of(specs: Sequence[LayerSpec], options: RuleOptions) -> StackRules:
    """The rules of a stack of these layers, whose own settings go first. Errors: `SettingError`.

    With the primaries `bottom` they are in Rec. 709, until `opened_stack` knows better.
    """
    return options.of_layers(
        [spec.op or (options.op if number else None) for number, spec in enumerate(specs)],
        [spec.opacity for spec in specs],
    )


@contextlib.contextmanager
def opened_stack(
    specs: Sequence[LayerSpec], rules: StackRules, options: StackOptions, notices: Notices
) -> Iterator[PlacedStack]:
    """The layers opened and placed as `stack` does, with its warnings; closed at the end.

    `rules`: those of `rules_of`; they are put into the primaries that `options` ask for.
    Errors: `SettingError`, `InputError`, `MismatchError`.
    """
    check_stdin(specs, "layers")
    nonfinite, max_pixels = options.rules.nonfinite, options.resources.max_pixels
    with contextlib.ExitStack() as opened:
        _allow_open_files(len(specs))
        readers = [
            opened.enter_context(opened_layer(spec, spec.label(number), nonfinite, max_pixels))
            for number, spec in enumerate(specs)
        ]
        if options.rules.primaries == BOTTOM:
            rules = rules.in_primaries(readers[0].decoding.encoding.primaries)
        for reader in readers:
            reader.work_in(rules.primaries)
        warn_of_layers(rules, readers, notices)
        window, placed = _placed(specs, readers, options.canvas.canvas)
        yield PlacedStack(rules, window, tuple(placed))


def _allow_open_files(layers: int) -> None:
    """Raises the limit on open files to what a stack of so many layers needs, where it may be."""
    try:
        import resource
    except ImportError:
        return  # not a Unix: no such limit
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = layers + OTHER_OPEN_FILES
    if soft != resource.RLIM_INFINITY and soft < wanted:
        allowed = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))


def _placed(
    specs: Sequence[LayerSpec], readers: Sequence[LayerReader], canvas: str | Window
) -> tuple[Window, list[PlacedLayer]]:
    """The canvas, and the layers on it."""
    layout = lay_out(
        [
            LayerWindows(r.label, r.part.display_window, r.window, spec.placement)
            for spec, r in zip(specs, readers, strict=True)
        ],
        canvas,
    )
    layers = [PlacedLayer(r, *offset) for r, offset in zip(readers, layout.offsets, strict=True)]
    return layout.window, layers
