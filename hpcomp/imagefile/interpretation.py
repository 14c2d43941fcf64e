"""How a layer's samples are to be taken: what its file says or the user instead. Reads no file."""

from __future__ import annotations

from collections.abc import Iterable

from ..color.css import css_color
from ..color.encodings import color_space
from ..color.samples import Decoding
from ..errors import InputError, unknown_name
from ..records import record
from .forms import NONFINITE_POLICIES
from .parts import ImageFile, Omission, Part


def check_nonfinite(policy: str) -> str:
    """The policy on NaN and Inf; `SettingError` lists the valid ones."""
    if policy not in NONFINITE_POLICIES:
        raise unknown_name("nonfinite policy", policy, NONFINITE_POLICIES)
    return policy


@record
class Interpretation:
    """What is asked of a reader beside its file.

    `alpha`: one of `encodings.ALPHA_MODES`, or None for the format's own. `colorspace`: a name of
    `encodings.COLOR_SPACES`, or None for what the file says. `tint`: a CSS colour for a mask,
    or None. `nonfinite`, on NaN and Inf: `error`, `zero` (such a pixel becomes transparent black,
    such a deep sample is left out), `keep`. `given`: the names of all settings of the layer that
    are given, with which its user says what is meant.
    Errors: `SettingError` for an unknown policy.
    """

    alpha: str | None = None
    colorspace: str | None = None
    tint: str | None = None
    nonfinite: str = "error"
    given: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        check_nonfinite(self.nonfinite)

    @property
    def believes_file(self) -> bool:
        """Whether the file's own word on colour counts.

        The values of a mask are no light, unless that is asked for.
        """
        return not self.colorspace and (self.tint is None or self.alpha == "luminance")

    def problems_of(self, part: Part, label: str) -> tuple[str, ...]:
        """What of the part is not honoured. Errors: `InputError` that names `label`."""
        if not self.believes_file:
            return ()
        if part.refusal:
            raise InputError(f"{label}: {part.refusal}")
        return part.problems

    def unanswered(self, omissions: Iterable[Omission]) -> tuple[str, ...]:
        """Those omissions that no setting says are meant, in words."""
        return tuple(o.text for o in omissions if self.given.isdisjoint(o.answered_by))

    def decoding_of(self, file: ImageFile, part: Part) -> Decoding:
        """The decoding into Rec. 709. Errors: `SettingError` for an unknown name or colour."""
        return Decoding(
            color_space(self.colorspace) if self.colorspace else part.encoding,
            self.alpha or file.alpha_mode,
            stored_straight=file.alpha_mode == "straight",
            zero_nonfinite=self.nonfinite == "zero",
            tint=None if self.tint is None else css_color(self.tint, "tint"),
        )


#: The file decides all of it.
AS_STORED = Interpretation()
