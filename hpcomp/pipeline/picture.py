"""What `stack` and `flatten` share of one picture: what is asked, what is planned and made."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ..blending.rules import StackRules
from ..color.quantization import Losses
from ..errors import SettingError
from ..geometry import Window
from ..imagefile.header import PictureHeader
from ..imagefile.parts import Part
from ..imagefile.writing import ImageWriter, OutputForm, format_of_output, open_writer
from ..layers.layerspec import LayerSpec
from ..layers.notices import Notices
from ..options import StackOptions
from ..records import record
from ..system.outputs import check_places, whole_output
from ..system.streams import STDOUT

if TYPE_CHECKING:  # only few pictures need them
    from ..measures.summary import StackSummary
    from ..system.depfile import Depfile


@record
class StackResult:
    """What `stack` or `flatten` wrote: the file, its windows, what it cannot hold, findings."""

    output: str
    canvas: Window
    data_window: Window
    losses: Losses
    findings: StackSummary | None = None


@record
class PictureRequest:
    """What is asked of one picture, checked as far as no file has to be touched.

    `specs`: of the layers, or of the deep images. `output`: a path, or `-`.
    """

    specs: Sequence[LayerSpec]
    output: str
    options: StackOptions
    rules: StackRules
    form: OutputForm
    depfile: Depfile | None

    @staticmethod
    def checked(
        specs: Sequence[LayerSpec], output: str, options: StackOptions, rules: StackRules
    ) -> PictureRequest:
        """Errors: `SettingError` for options that do not go together."""
        asked = options.output
        form = OutputForm.checked(
            format_of_output(output, asked.format),
            asked.depth,
            asked.compression,
            asked.out_primaries,
        )
        if options.canvas.overscan and form.format == "png":
            raise SettingError("a PNG ends at its canvas: --overscan needs an EXR output")
        depfile = None
        if asked.depfile is not None or asked.depfile_target:
            from ..system.depfile import Depfile

            depfile = Depfile.asked(asked.depfile, asked.depfile_target, [output])
        return PictureRequest(specs, output, options, rules, form, depfile)

    @property
    def shown(self) -> str:
        """What messages call the output."""
        return "stdout" if self.output == STDOUT else self.output

    def check_places(self, beside: Sequence[str] = ()) -> None:
        """`SettingError` where two outputs are one file; `beside`: those that others write."""
        depfiles = [self.depfile.path] if self.depfile else []
        check_places([self.output, *beside, *depfiles])

    def placed(self, opened: contextlib.ExitStack) -> str:
        """Where the picture is written first; it appears when `opened` closes without an error."""
        asked = self.options.output
        return opened.enter_context(
            whole_output(self.output, clobber=asked.clobber, if_changed=asked.write_if_changed)
        )

    def place_depfile(self, opened: contextlib.ExitStack) -> None:
        """The same for the depfile. Errors: `SettingError` where it would replace an input."""
        if self.depfile is not None:
            read = [spec.path for spec in self.specs]
            changed = self.options.output.write_if_changed
            opened.enter_context(self.depfile.written(read, changed))


@record
class PicturePlan:
    """What will be done: inputs are open and placed, and memory is shared out.

    `target`: where the picture is written first. `rules`: in the working primaries. `window`: the
    pixels that are made, on `canvas`. `bottom`: the part whose shape of pixels is carried over.
    """

    request: PictureRequest
    target: str
    rules: StackRules
    canvas: Window
    window: Window
    threads: int
    bottom: Part
    notices: Notices

    @property
    def in_words(self) -> str:
        """The canvas and the rules, as a log shows them."""
        rules = self.rules
        woven = rules.blending.depends_on_place
        how = str(rules.weave) if woven else f"order {rules.order.name}"
        return (
            f"canvas {self.canvas}, {rules.blending.name}, {how}, space {rules.space.name}, "
            f"strength {rules.strength.name}, primaries {rules.primaries.name}"
        )

    @contextlib.contextmanager
    def writer(self) -> Iterator[ImageWriter]:
        """Writes the picture, which is complete when the block ends without an error."""
        header = PictureHeader(
            self.window,
            self.canvas,
            self.rules.primaries,
            self.bottom.pixel_aspect,
            self.bottom.pixels_per_metre,
        )
        writer = open_writer(self.target, self.request.form, header, self.request.shown)
        try:
            yield writer
            writer.finish()
        finally:
            writer.abandon()
