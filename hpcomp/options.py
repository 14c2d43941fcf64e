"""Every option of a stack once: its default, its check, and the sentence that help texts show.

The command line parses into a `StackOptions`, a job file is read into one, and `stack`, `flatten`,
`check` and `explain` make one of their keywords. What an option does lives elsewhere, in the module
whose table or check stands beside it here. Settings of one layer are those of a `LayerSpec`.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import Field, field, fields, replace
from functools import cache
from typing import Any, TypeVar, get_type_hints

import numpy as np

from .blending.addition import DEFAULT_HUE_TOLERANCE, check_gray_bias, check_hue_tolerance
from .blending.blendings import BLENDINGS
from .blending.orders import ORDERS, check_order
from .blending.porter_duff import OPERATOR_NAMES
from .blending.rules import StackRules, check_exposure, checked_rules
from .blending.strength import STRENGTHS
from .blending.weaving import DEFAULT_WEAVE_SIZE, PATTERNS, check_weave_size
from .color.css import css_color
from .color.primaries import (
    BOTTOM,
    OUT_PRIMARIES,
    REC709,
    WORKING_PRIMARIES,
    converted,
    working_primaries,
)
from .color.spaces import BUILDERS, DEFAULT_SPACE
from .errors import SettingError, nearest, nearest_name, unknown_name
from .geometry import Window, parse_canvas, parse_window
from .imagefile.forms import COMPRESSIONS, DEPTHS, FORMATS, NONFINITE_POLICIES
from .measures.defaults import (
    DEFAULT_ACHROMATIC,
    DEFAULT_BINS,
    REPORT_ENDINGS,
    check_achromatic,
    check_bins,
    check_energy_weights,
    check_foreign_tolerance,
    check_provenance,
    check_report,
)
from .records import record, unique_record
from .system.memory import MAX_PIXELS, parse_bytes, parse_pixels
from .system.threads import check_threads

Path = str | os.PathLike[str]
F = TypeVar("F", bound=Callable[..., Any])


@unique_record
class Option:
    """What is said of an option beside its name, its type and its default.

    `help`: what it does. `takes`: the type of a value, where what is kept of it has another.
    `metavar`: what help calls its value. `choices`: the names that it takes, where it takes no
    other value, and `noun`: what errors call these. `check`: gives the value to keep, and raises
    `SettingError` for a wrong one; without it `choices` decide. `least`: the smallest whole number.
    `is_path`: whether its values are names of files.
    """

    help: str
    takes: Any = None
    metavar: str = ""
    choices: tuple[str, ...] = ()
    noun: str = ""
    check: Callable[[Any], Any] | None = None
    least: int | None = None
    is_path: bool = False

    def checked(self, value: Any) -> Any:
        """The value to keep; None where nothing is asked. Errors: `SettingError`."""
        if value is None:
            return None
        if self.check is not None:
            return self.check(value)
        if self.choices and value not in self.choices:
            raise unknown_name(self.noun, value, self.choices)
        return value


def _option(default: Any, help: str, **more: Any) -> Any:
    return field(default=default, metadata={"option": Option(help, **more)})


class _Group:
    """Options that belong together; each is checked when they are made."""

    def __post_init__(self) -> None:
        for item in fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass
            value = getattr(self, item.name)
            if value is not item.default:
                object.__setattr__(self, item.name, _checked(item, value))


def _checked(item: Field[Any], value: Any) -> Any:
    """The value to keep of an option. Errors: `SettingError`, also for a value of another type."""
    option: Option = item.metadata["option"]
    try:
        if isinstance(item.default, bool) and not isinstance(value, bool):
            raise TypeError
        if value is None and item.default is not None:
            raise TypeError
        return option.checked(value)
    except SettingError:
        raise
    except (TypeError, ValueError):
        if option.choices and option.check is None:
            raise unknown_name(option.noun, str(value), option.choices) from None
        takes = str(option.takes or item.type).replace("hpcomp.geometry.", "")
        raise SettingError(
            f"{item.name.replace('_', ' ')} is {value!r}: it takes {takes}"
        ) from None


def _checked_background(color: str | Sequence[float]) -> str | Sequence[float]:
    if isinstance(color, str):
        css_color(color, "background")
    elif len(color) != 3 or not np.isfinite(color).all():
        raise SettingError(f"background {color} is not three finite components, linear RGB")
    return color


def _checked_region(region: str | Window) -> Window:
    return parse_window(region) if isinstance(region, str) else region


def _checked_memory(memory: str | int) -> str | int:
    parse_bytes(memory)
    return memory


def _checked_pixels(pixels: str | int) -> str | int:
    parse_pixels(pixels)
    return pixels


def _checked_order(order: str | Sequence[int]) -> str | Sequence[int]:
    check_order(order)
    return order


def _checked_compression(compression: str | int) -> str:
    name = str(compression)
    png, exr = COMPRESSIONS["png"], COMPRESSIONS["exr"]
    if name not in (*png, *exr):
        near = nearest_name(name, (*png, *exr))
        otherwise = f" for PNG, or of {', '.join(exr)} for EXR"
        raise unknown_name("compression", name, png, meant=near, otherwise=otherwise)
    return name


def _checked_reports(given: Path | Sequence[Path]) -> tuple[str, ...]:
    several = [given] if isinstance(given, (str, os.PathLike)) else given
    return tuple(check_report(os.fspath(path)) for path in several)


def _checked_provenance(given: Path) -> str:
    return check_provenance(os.fspath(given))


def _checked_weights(weights: str | Sequence[float]) -> str | Sequence[float]:
    check_energy_weights(weights)
    return weights


def _names(given: str | Sequence[str]) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given)


#: The options that a preset chooses; one that is given beside it stays as it is given.
PRESET_OPTIONS = (
    *("blending", "order", "space", "strength", "hue_tolerance", "gray_bias"),
    *("weave", "weave_size"),
)

#: What each preset chooses where it is not the default: what `labels` is best at was measured, see
#: `tests/bench/README.md`.
PRESETS: dict[str, dict[str, Any]] = {
    "paper": {},
    "labels": {
        "order": "simultaneous",
        "space": "oklab",
        "strength": "coverage",
        "gray_bias": 1.0,
    },
    "woven": {"blending": "woven", "strength": "coverage"},
}


@record
class RuleOptions(_Group):
    """What decides the colour of a pixel, and what is refused."""

    preset: str | None = _option(
        None,
        "A set of choices, of which options that are given override single ones: paper (the "
        "defaults), labels (translucent labels that overlap), woven (every label is seen).",
        choices=tuple(PRESETS),
        noun="preset",
    )
    op: str = _option(
        "over",
        "Operator of the layers that name none.",
        metavar="OPERATOR",
        choices=OPERATOR_NAMES,
        noun="operator",
    )
    blending: str = _option(
        "hue-preserving",
        "How colours are added: the stronger one keeps its hue, hues mix as usual, the one in "
        "front keeps its hue, or a pattern shows each hue in turn.",
        choices=tuple(BLENDINGS),
        noun="blending",
    )
    order: str | Sequence[int] = _option(
        "bottom-up",
        f"In which order the layers' colours are added: {', '.join(ORDERS)}, or a permutation such "
        "as 2,0,1.",
        metavar="ORDER",
        check=_checked_order,
    )
    space: str = _option(
        DEFAULT_SPACE, "Blending space.", choices=tuple(BUILDERS), noun="blending space"
    )
    primaries: str = _option(
        REC709.name,
        "Blend in these primaries, to which files in others are converted; bottom: in those of the "
        "bottom layer. They decide luminance and hue, and an EXR is written in them.",
        choices=(*WORKING_PRIMARIES, BOTTOM),
        noun="primaries",
    )
    hue_tolerance: float = _option(
        DEFAULT_HUE_TOLERANCE,
        "Hues closer than this, 0 to 90, are equal; 0 is the paper's operator.",
        metavar="DEGREES",
        check=check_hue_tolerance,
    )
    gray_bias: float = _option(
        0.0,
        "How much less different hues cancel each other to grey; 0 is the paper's operator.",
        metavar="0…1",
        check=check_gray_bias,
    )
    strength: str = _option(
        "chroma",
        "What a colour is as strong as where hues compete: its chroma, as in the paper; its chroma "
        "as it is perceived; or the share of a pixel that it covers.",
        choices=tuple(STRENGTHS),
        noun="strength",
    )
    weave: str = _option(
        "stripes",
        "Pattern of woven blending: diagonal stripes, or noise.",
        choices=tuple(PATTERNS),
        noun="weave",
    )
    weave_size: int = _option(
        DEFAULT_WEAVE_SIZE,
        "Period of the stripes, or size of a cell of the noise, in pixels, 2 to 1024.",
        metavar="PIXELS",
        check=check_weave_size,
    )
    exposure: float = _option(
        0.0, "Brighten or darken the result.", metavar="STOPS", check=check_exposure
    )
    background: str | Sequence[float] | None = _option(
        None,
        "Put a CSS colour, such as #ff8800 or white, under the result.",
        metavar="COLOR",
        check=_checked_background,
    )
    nonfinite: str = _option(
        "error",
        "NaN and Inf in a layer: error (refuse it), zero (the pixel becomes transparent), keep.",
        choices=NONFINITE_POLICIES,
        noun="nonfinite policy",
    )
    strict: bool = _option(False, "Treat warnings as errors.")

    def of_layers(self, operators: Sequence[str | None], opacities: Sequence[float]) -> StackRules:
        """The rules of a stack of layers with these operators, None first, and opacities.

        With the primaries `bottom` they are in Rec. 709, until those of the bottom layer are known.
        Errors: `SettingError`, also for an order that is not one of so many layers.
        """
        name = REC709.name if self.primaries == BOTTOM else self.primaries
        background = self.background
        if isinstance(background, str):
            color = np.array(css_color(background, "background"))
            background = converted(color, REC709, working_primaries(name)).tolist()
        return checked_rules(
            operators,
            opacities,
            blending=self.blending,
            order=self.order,
            space=self.space,
            hue_tolerance=self.hue_tolerance,
            gray_bias=self.gray_bias,
            background=background,
            exposure=self.exposure,
            primaries=name,
            strength=self.strength,
            weave=self.weave,
            weave_size=self.weave_size,
        )


@record
class CanvasOptions(_Group):
    """Which pixels there are."""

    canvas: str | Window = _option(
        "bottom",
        "bottom (the bottom layer's display window), union, intersection, or WxH+X+Y.",
        takes=str | Window,
        metavar="CANVAS",
        check=parse_canvas,
    )
    region: Window | None = _option(
        None,
        "Make only this part of the canvas.",
        takes=str | Window | None,
        metavar="WxH+X+Y",
        check=_checked_region,
    )
    overscan: bool = _option(False, "EXR: keep pixels beyond the canvas.")


@record
class OutputOptions(_Group):
    """In which form the picture is written, and what is written beside it for make."""

    format: str | None = _option(
        None, "Format of an output without an ending.", choices=FORMATS, noun="format"
    )
    depth: str | None = _option(
        None,
        "PNG: 8 (default), 16. EXR: half (default), float.",
        takes=str | int | None,
        choices=(*DEPTHS["png"], *DEPTHS["exr"]),
        check=str,
    )
    compression: str | None = _option(
        None,
        "PNG: fast (default), small, 0…9. EXR: zip (default), "
        f"{', '.join(COMPRESSIONS['exr'][1:])}.",
        takes=str | int | None,
        metavar="NAME",
        check=_checked_compression,
    )
    out_primaries: str | None = _option(
        None,
        "PNG: write it in these primaries instead of rec709, on the curve of sRGB. An EXR is "
        "written in those of --primaries.",
        choices=OUT_PRIMARIES,
        noun="out primaries",
    )
    clobber: bool = _option(True, "Replace an existing output.")
    depfile: str | None = _option(
        None,
        "Write a rule for make or ninja: what is made, and the files that were read.",
        takes=Path | None,
        metavar="PATH",
        is_path=True,
        check=os.fspath,
    )
    depfile_target: tuple[str, ...] = _option(
        (),
        "Name this in the depfile as what is made; may be repeated.",
        takes=str | Sequence[str],
        metavar="NAME",
        check=_names,
    )
    write_if_changed: bool = _option(
        False, "Leave outputs that have the new bytes already as they are, with their times."
    )


@record
class ReportOptions(_Group):
    """What is said about the picture in files beside it."""

    report: tuple[str, ...] = _option(
        (),
        "Write what blending did to the hues, beside traditional blending: a path ending in "
        f"{', '.join(REPORT_ENDINGS[:-1])} or {REPORT_ENDINGS[-1]}; can be "
        "given several times.",
        takes=Path | Sequence[Path],
        metavar="PATH",
        is_path=True,
        check=_checked_reports,
    )
    provenance: str | None = _option(
        None,
        "Write an EXR of each pixel's surviving layer: layer (its number plus 1, 0 for none), grey "
        "(the share of chroma that is cancelled), margin (over the strongest rival).",
        takes=Path | None,
        metavar="PATH",
        is_path=True,
        check=_checked_provenance,
    )
    foreign_tolerance: float | None = _option(
        None,
        "Reports: a hue farther than this from every layer's is foreign; twice the hue tolerance "
        "if not given, more in oklab and cielab.",
        metavar="DEGREES",
        check=check_foreign_tolerance,
    )
    achromatic: float | None = _option(
        None,
        f"Reports: colours of less saturation are grey; {DEFAULT_ACHROMATIC:g} if not given.",
        metavar="0…1",
        check=check_achromatic,
    )
    bins: int | None = _option(
        None,
        f"Reports: bins of the histograms; {DEFAULT_BINS} if not given.",
        metavar="N",
        check=check_bins,
    )
    energy_weights: str | Sequence[float] | None = _option(
        None,
        "Reports: shares of red, green and blue in the power of a display; 0.3,0.25,0.45, an "
        "estimate, if not given.",
        metavar="R,G,B",
        check=_checked_weights,
    )

    @property
    def is_asked(self) -> bool:
        """Whether anything is to be written beside the picture."""
        return bool(self.report) or self.provenance is not None

    def check_unasked(self) -> None:
        """`SettingError` where an option is given that changes nothing, as nothing is asked."""
        for name in ("foreign_tolerance", "achromatic", "energy_weights", "bins"):
            value = getattr(self, name)
            if value is not None:
                raise SettingError(
                    f"{name.replace('_', ' ')} {value} changes reports alone: name one with "
                    "--report"
                )


@record
class ResourceOptions(_Group):
    """What the work may take."""

    threads: int | None = _option(
        None,
        "Threads to use: all cores if not given.",
        metavar="N",
        least=1,
        check=check_threads,
    )
    max_memory: str | int = _option(
        "1G", "Memory for pixels and codecs, such as 512M.", metavar="SIZE", check=_checked_memory
    )
    max_pixels: str | int = _option(
        MAX_PIXELS,
        "Refuse a file or a canvas of more pixels than this, such as 500M or 4G (powers of 1000).",
        metavar="NUMBER",
        check=_checked_pixels,
    )


@record
class StackOptions:
    """All options of a stack, checked one by one, in the groups that they belong to."""

    rules: RuleOptions = RuleOptions()
    canvas: CanvasOptions = CanvasOptions()
    output: OutputOptions = OutputOptions()
    reports: ReportOptions = ReportOptions()
    resources: ResourceOptions = ResourceOptions()

    @staticmethod
    def of(
        given: Mapping[str, Any],
        base: StackOptions | None = None,
        names: Iterable[str] | None = None,
    ) -> StackOptions:
        """From options by name; the others are those of `base`, or have their defaults.

        A preset chooses those that are not given beside it. `names`: those that may be given, all
        if None. Errors: `SettingError` for a value, and for another option that `base` has;
        `TypeError` for another name.
        """
        valid = OPTIONS if names is None else tuple(names)
        given = {**_preset(given.get("preset")), **given}
        groups: dict[str, dict[str, Any]] = {}
        for name, value in given.items():
            if name not in valid:
                raise TypeError(f"there is no option '{name}' here{nearest(name, valid)}")
            groups.setdefault(OPTIONS[name].group, {})[name] = value
        base = base or DEFAULTS
        for name in OPTIONS:
            if name not in valid and base[name] != OPTIONS[name].default:
                raise SettingError(f"{name.replace('_', ' ')} is no option here: leave it out")
        return replace(base, **{g: replace(getattr(base, g), **some) for g, some in groups.items()})

    def __getitem__(self, name: str) -> Any:
        """The value of the option of that name."""
        return getattr(getattr(self, OPTIONS[name].group), name)


#: The groups by their names in `StackOptions`.
_GROUPS: dict[str, Callable[..., Any]] = {
    "rules": RuleOptions,
    "canvas": CanvasOptions,
    "output": OutputOptions,
    "reports": ReportOptions,
    "resources": ResourceOptions,
}


@unique_record
class NamedOption:
    """One row of `OPTIONS`: an option, its name, group, default, and type as it is written."""

    name: str
    group: str
    default: Any
    annotation: Any
    option: Option

    @property
    def hint(self) -> Any:
        """The type that it takes."""
        return self.option.takes or _hints(self.group)[self.name]

    @property
    def kind(self) -> type | None:
        """The type of a number; None of what is written as a text."""
        numbers: dict[str, type] = {"int": int, "float": float}
        return numbers.get(str(self.annotation).removesuffix(" | None"))


@cache
def _hints(group: str) -> dict[str, Any]:
    """The types of a group's options, which take a while to find: only where they are asked for."""
    return get_type_hints(_GROUPS[group])


#: Every option by its name, in the order of the groups.
OPTIONS: dict[str, NamedOption] = {
    item.name: NamedOption(
        item.name,
        name,
        item.default,
        item.metadata["option"].takes or item.type,
        item.metadata["option"],
    )
    for name, group in _GROUPS.items()
    for item in fields(group)  # type: ignore[arg-type]
}

#: What is used where nothing is asked.
DEFAULTS = StackOptions()


def _preset(name: str | None) -> dict[str, Any]:
    """All that a preset chooses. Errors: `SettingError` for a name."""
    if name is None:
        return {}
    chosen = PRESETS[OPTIONS["preset"].option.checked(name)]
    return {option: chosen.get(option, OPTIONS[option].default) for option in PRESET_OPTIONS}


def older_spelling(keywords: Any, name: str, value: Any) -> Any:
    """What the keywords of a call, a dict, have under an older spelling, and lose; else `value`."""
    return keywords.pop(name, value)


def takes_options(*names: str) -> Callable[[F], F]:
    """For a function whose last parameter is `**options`: shows those of these names instead."""

    def decorate(function: F) -> F:
        own = [
            parameter
            for parameter in inspect.signature(function).parameters.values()
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        rows = [OPTIONS[name] for name in names]
        shown = [
            inspect.Parameter(
                row.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=row.default,
                annotation=row.annotation,
            )
            for row in rows
        ]
        result = function.__annotations__["return"]
        function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [*own, *shown], return_annotation=result
        )
        function.__annotations__ = {
            **{parameter.name: parameter.annotation for parameter in (*own, *shown)},
            "return": result,
        }
        return function

    return decorate


#: The options that decide how arrays are composited: all rules but those about files.
ARRAY_RULES = (
    "preset",
    "blending",
    "order",
    "space",
    "hue_tolerance",
    "gray_bias",
    "strength",
    "weave",
    "weave_size",
    "background",
    "exposure",
    "primaries",
)


def stack_rules(
    n_layers: int,
    *,
    op: str | Sequence[str | None] = RuleOptions.op,
    opacity: float | Sequence[float] = 1.0,
    **rules: Any,
) -> StackRules:
    """The rules of a stack of `n_layers`, looked up and checked; the arguments of `composite`.

    `op`: of the layers above the bottom, or one for each layer, None first. `opacity`: of all
    layers, or one for each. `rules`: of `ARRAY_RULES`. Errors: `SettingError`.
    """
    working_primaries(rules.get("primaries", RuleOptions.primaries))  # `bottom` is of files
    if n_layers < 1:
        raise SettingError("a stack needs at least one layer")
    ops = [None, *[op] * (n_layers - 1)] if isinstance(op, str) else list(op)
    opacities = np.full(n_layers, opacity) if np.ndim(opacity) == 0 else np.asarray(opacity)
    for what, given in (("operators", len(ops)), ("opacities", len(opacities))):
        if given != n_layers:
            raise SettingError(f"{given} {what} for {n_layers} layers: give one for each")
    options = StackOptions.of(rules, names=ARRAY_RULES)
    return options.rules.of_layers(ops, opacities.tolist())
