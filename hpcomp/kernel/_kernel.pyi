# The binding in `module.cpp` and `packing_binding.cpp`, for mypy: what is passed, by keyword. A
# test holds the names against the module that was built.

from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Samples = NDArray[Any]
_Pairs = Sequence[Sequence[float]]

class Blending(Enum):
    HUE_PRESERVING = ...
    TRADITIONAL = ...
    FOREMOST = ...
    WOVEN = ...

class Strength(Enum):
    PERCEIVED = ...
    COVERAGE = ...

class Pattern(Enum):
    STRIPES = ...
    NOISE = ...

class Order(Enum):
    BOTTOM_UP = ...
    FRONT_TO_BACK = ...
    PERMUTATION = ...
    BALANCED = ...
    SIMULTANEOUS = ...
    WOVEN = ...

class Factor(Enum):
    ZERO = ...
    ONE = ...
    ALPHA = ...
    REST = ...

class Layer: ...
class SpaceMaps: ...
class Background: ...
class Competition: ...
class Weave: ...
class Rules: ...
class Codes: ...
class Provenance: ...

class Losses:
    out_of_gamut: int
    light_without_alpha: int
    not_a_number: int
    beyond_half: int

class Accumulator:
    def __init__(
        self,
        *,
        rules: Rules,
        width: int,
        height: int,
        left: int,
        top: int,
        phases: NDArray[np.float32] | None,
        level: str = "",
    ) -> None: ...
    def add(self, *, numbers: Sequence[int], layers: Sequence[Layer | None]) -> list[int]: ...
    def result(
        self, *, out: _Samples, codes: Codes | None, measures: Measures | None = None
    ) -> tuple[Losses, list[int]]: ...

class HueSums:
    count: NDArray[np.int64]
    chroma: NDArray[np.int64]
    alpha: NDArray[np.int64]
    rgb: NDArray[np.int64]
    grey: int
    transparent: int
    nonfinite: int

class ContributorSums:
    pixels: int
    survived: int
    visible: int
    chroma: int
    kept: int

class ResultSums:
    chromatic: int
    chroma: int
    foreign: int
    foreign_chroma: int
    light: tuple[int, int, int]
    layers: list[ContributorSums]
    background: ContributorSums

class Measures:
    unmeasured: int
    order_sensitive: int
    result: ResultSums
    traditional: ResultSums
    result_hues: HueSums
    traditional_hues: HueSums
    def layer_hues(self, *, number: int) -> HueSums: ...
    def layer_squares(self, *, number: int) -> NDArray[np.int64]: ...
    def result_squares(self) -> NDArray[np.int64]: ...
    def traditional_squares(self) -> NDArray[np.int64]: ...

def levels() -> list[str]: ...
def scratch_bytes(*, order: Order, layers: int) -> int: ...
def run_bytes(*, terms: int) -> int: ...
def keep_runs(
    *,
    rules: Rules,
    counts: NDArray[np.int64],
    p: NDArray[np.float64],
    strengths: NDArray[np.float64] | None,
    kept: NDArray[np.float64],
) -> None: ...
def layer(
    *,
    samples: _Samples,
    decode: NDArray[np.float32] | None,
    alpha_straight: bool,
    matrix: _Pairs | None,
    left: int,
    top: int,
    opacity: float,
    factor_a: Factor,
    factor_b: Factor,
    behind: bool,
    zero_nonfinite: bool,
) -> Layer: ...
def linear_maps(
    *, weight_red: float, weight_blue: float, to_p: _Pairs, from_p: _Pairs
) -> SpaceMaps: ...
def hsl_maps(
    *, weight_red: float, weight_blue: float, to_p: _Pairs, from_p: _Pairs
) -> SpaceMaps: ...
def oklab_maps(
    *,
    weight_red: float,
    weight_blue: float,
    to_lms: _Pairs,
    to_lab: _Pairs,
    to_roots: _Pairs,
    from_lms: _Pairs,
    inverse_largest: float,
    slack_lo: float,
    slack_hi: float,
) -> SpaceMaps: ...
def cielab_maps(
    *,
    weight_red: float,
    weight_blue: float,
    to_xz: _Pairs,
    from_xz: _Pairs,
    inverse_largest: float,
    slack_lo: float,
    slack_hi: float,
) -> SpaceMaps: ...
def background(
    *,
    luminance: float,
    p: Sequence[float],
    rgb: Sequence[float],
    lo: float,
    hi: float,
    strength: float,
) -> Background: ...
def competition(*, strength: Strength, oklab: SpaceMaps, half_chroma: float) -> Competition: ...
def weave(*, pattern: Pattern, size: int, tile: NDArray[np.uint16] | None) -> Weave: ...
def rules(
    *,
    blending: Blending,
    hue_tolerance: float,
    rounding_angle: float,
    gray_bias: float,
    order: Order,
    permutation: Sequence[int],
    layers: int,
    background: Background | None,
    gain: float,
    space: SpaceMaps,
    competition: Competition | None,
    weave: Weave | None,
) -> Rules: ...
def codes(
    *,
    thresholds: NDArray[np.float32],
    first_code: NDArray[np.uint16],
    bucket_bits: int,
    smallest: float,
    lowest: float,
    darkest: float,
    highest: float,
    matrix: _Pairs | None,
    luminance_weights: Sequence[float],
    space: SpaceMaps,
) -> Codes: ...
def provenance(
    *, layer: NDArray[np.uint32], grey: NDArray[np.float32], margin: NDArray[np.float32]
) -> Provenance: ...
def measures(
    *,
    layers: int,
    width: int,
    height: int,
    left: int,
    top: int,
    bins: int,
    half_step: float,
    achromatic: float,
    foreign_sine: float,
    foreign_cosine: float,
    depends_on_order: bool,
    provenance: Provenance | None,
    square_scale: int = 0,
    square_top: int = 0,
) -> Measures: ...
def measure(
    *, rules: Rules, layers: Sequence[Layer | None], measures: Measures, level: str = ""
) -> None: ...

class _Packing:
    def exr_unpack(
        self,
        *,
        block: NDArray[np.uint8],
        packed: bool,
        row_units: int,
        channels: Sequence[int],
        first_row: int,
        out: _Samples,
        level: str = "",
    ) -> None: ...
    def exr_pack(self, *, samples: _Samples, out: NDArray[np.uint8], level: str = "") -> None: ...
    def png_unfilter(
        self,
        *,
        filtered: NDArray[np.uint8],
        pixel_bytes: int,
        above: NDArray[np.uint8],
        out: NDArray[np.uint8],
        level: str = "",
    ) -> None: ...
    def png_filter(
        self,
        *,
        rows: NDArray[np.uint8],
        pixel_bytes: int,
        out: NDArray[np.uint8],
        level: str = "",
    ) -> None: ...

packing: _Packing
