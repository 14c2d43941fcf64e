"""The options of a stack on the command line, made from the table of `hpcomp.options`.

Beside `options`, which all commands import: here are tables of the mathematics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from ..blending.orders import ORDERS
from ..geometry import CANVASES
from ..imagefile.forms import COMPRESSIONS, DEPTHS
from ..measures.defaults import DEFAULT_ACHROMATIC
from ..options import OPTIONS, PRESET_OPTIONS, NamedOption
from .options import F
from .words import PICTURES, Choice, File, Offer, Text, color_names, of_output

#: What a shell is offered for options whose values are not all names, or not all for any output.
_OFFERED: dict[str, Offer] = {
    "order": lambda ctx: ORDERS,
    "canvas": lambda ctx: CANVASES,
    "background": color_names,
    "compression": of_output(COMPRESSIONS),
    "depth": of_output(DEPTHS),
}


class GivenOption(click.Option):
    """An option that a preset may choose: the command gets it where it is given, and only there."""

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        result = super().handle_parse_result(ctx, opts, args)
        name = self.name or ""
        if ctx.get_parameter_source(name) is click.core.ParameterSource.DEFAULT:
            ctx.params.pop(name, None)
        return result


def _click_option(row: NamedOption, help: str | None, hidden: bool) -> Callable[[F], F]:
    option = row.option
    flag = f"--{row.name.replace('_', '-')}"
    how: dict[str, Any] = {
        "cls": GivenOption if row.name in PRESET_OPTIONS else click.Option,
        "help": help or option.help,
        "default": row.default,
        "metavar": option.metavar or None,
        "hidden": hidden,
    }
    if row.default is True:
        return click.option(f"{flag}/--no-{flag[2:]}", show_default=True, **how)
    if row.default is False:
        return click.option(flag, is_flag=True, **how)
    offered = _OFFERED.get(row.name)
    if option.is_path:
        how["type"] = File()
    elif option.choices:
        how["type"] = Choice(option.choices, option.noun or row.name, offered)
    elif offered:
        how["type"] = Text(offered)
    elif option.least is not None:
        how["type"] = click.IntRange(min=option.least)
    elif row.kind is not None:
        how["type"] = row.kind
    if row.default == ():
        del how["default"]
        return click.option(flag, multiple=True, **how)
    return click.option(flag, show_default=row.default is not None, **how)


def stack_options(
    *names: str, help: Mapping[str, str] | None = None, hidden: bool = False
) -> Callable[[F], F]:
    """The options of those names, in that order in the help; `help`: other sentences of some.

    `hidden`: accepted, and not shown, since they change nothing.
    """

    def decorate(function: F) -> F:
        for name in reversed(names):
            function = _click_option(OPTIONS[name], (help or {}).get(name), hidden)(function)
        return function

    return decorate


#: What the options of reports mean where one pixel or one picture is judged.
NEAR_A_LAYER = {
    "foreign_tolerance": "A hue this near to a layer's is that layer's: twice the hue tolerance if "
    "not given, more in oklab and cielab.",
    "achromatic": f"Pixels of less saturation are grey; {DEFAULT_ACHROMATIC:g} if not given.",
}


def other_options(*names: str) -> Callable[[F], F]:
    """All options of a stack but those of these names, which change nothing where this stands.

    So one list of options can be given to `stack`, `check` and `explain`. `format` is not among
    them: it says where a picture goes, and a report has formats of its own.
    """
    return stack_options(*(n for n in OPTIONS if n not in (*names, "format")), hidden=True)


#: What makefiles ask of every command that reads files, and of every one that writes them.
depfile_options = stack_options("depfile", "depfile_target")
make_options = stack_options("depfile", "depfile_target", "write_if_changed")

#: What every command that makes one picture takes first.
output_option = click.option(
    "-o",
    "--output",
    required=True,
    metavar="PATH",
    type=File(*PICTURES),
    help="Write here: a path ending in .png or .exr, or - for stdout with --format.",
)
