"""`hpcomp completion`: prints the script that completes words in a shell; answers what it asks."""

from __future__ import annotations

import os
import re

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    ShellComplete,
    ZshComplete,
    add_completion_class,
    split_arg_string,
)

from .options import STDIN_MARK, Command
from .printing import print_data
from .words import Choice

# The scripts hand over the line up to the cursor: bash parts words at : and =, which LAYERs have.
_BASH = """\
%(complete_func)s() {
    local type value
    COMPREPLY=()
    while IFS=, read -r type value; do
        COMPREPLY+=("$value")
    done < <(env COMP_LINE="${COMP_LINE:0:COMP_POINT}" COMP_WORDBREAKS="$COMP_WORDBREAKS" \
%(complete_var)s=bash_complete "$1")
    if [[ ${#COMPREPLY[@]} -eq 1 && ${COMPREPLY[0]} == *[/:=,] ]]; then
        compopt -o nospace
    fi
}

complete -o nosort -F %(complete_func)s %(prog_name)s
"""
_ZSH = """\
#compdef %(prog_name)s

%(complete_func)s() {
    local -a described ended open response
    local type value help
    (( ! $+commands[%(prog_name)s] )) && return 1
    response=("${(@f)$(env COMP_LINE="${words[1,CURRENT-1]} $QIPREFIX$PREFIX" \
%(complete_var)s=zsh_complete %(prog_name)s)}")
    for type value help in ${response}; do
        if [[ "$help" != "_" ]]; then
            described+=("$value":"$help")
        elif [[ "$value" == *[/:=,] ]]; then
            open+=("$value")
        else
            ended+=("$value")
        fi
    done
    [[ -n "$described" ]] && _describe -V unsorted described -U
    [[ -n "$open" ]] && compadd -Q -U -V unsorted -S '' -a open
    [[ -n "$ended" ]] && compadd -Q -U -V unsorted -a ended
}

if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    %(complete_func)s "$@"
else
    compdef %(complete_func)s %(prog_name)s
fi
"""
_FISH = """\
function %(complete_func)s
    for completion in (env COMP_LINE=(commandline -cp | string collect) \
%(complete_var)s=fish_complete %(prog_name)s)
        string split --fields 2 --max 1 -- , $completion
    end
end

complete --no-files --keep-order --command %(prog_name)s --arguments "(%(complete_func)s)"
"""

#: What a word has at its end while the line is taken apart: of private use, too.
_CURSOR = "\U000f0001"
#: What a shell would take for something else outside quotes.
_SPECIAL = re.compile(r"[^\w@%+=:,./~-]")


class _OfLine(ShellComplete):
    """A shell whose script gives the command line up to the cursor, as `COMP_LINE`."""

    def get_completion_args(self) -> tuple[list[str], str]:
        line = os.environ.get("COMP_LINE")
        if line is None:  # as the scripts of click give it
            return super().get_completion_args()
        words = split_arg_string(line + _CURSOR)
        return words[1:-1], words[-1].removesuffix(_CURSOR)

    def get_completions(self, args: list[str], incomplete: str) -> list[CompletionItem[str]]:
        """Sorted; with the name of an option where its value stands behind a =."""
        marked = f"{STDIN_MARK}{incomplete}" if incomplete.startswith("-::") else incomplete
        items = super().get_completions(args, marked)
        option, equals, _ = incomplete.partition("=")
        for item in items:
            item.value = item.value.removeprefix(STDIN_MARK)
            if equals and option.startswith("--"):
                item.value = f"{option}={item.value}"
        return sorted(items, key=lambda item: item.value)


class _Bash(_OfLine, BashComplete):
    """Bash replaces the last word up to the last of its `COMP_WORDBREAKS` in it."""

    source_template = _BASH

    def format_completion(self, item: CompletionItem[str]) -> str:
        line = os.environ.get("COMP_LINE")
        if line is None:
            return super().format_completion(item)
        quote, kept = _typed(line, os.environ.get("COMP_WORDBREAKS", " \t\n"))
        rest = item.value[kept:]
        return f"{item.type},{rest if quote else _quoted(rest)}"


class _Zsh(_OfLine, ZshComplete):
    """Zsh replaces the last word but for a quote that it begins with."""

    source_template = _ZSH

    def format_completion(self, item: CompletionItem[str]) -> str:
        line = os.environ.get("COMP_LINE")
        if line is not None and not item.help and not _typed(line, " \t\n")[0]:
            item.value = _quoted(item.value)
        return super().format_completion(item)


class _Fish(_OfLine, FishComplete):
    """Fish quotes words itself."""

    source_template = _FISH


SHELLS: dict[str, type[ShellComplete]] = {"bash": _Bash, "zsh": _Zsh, "fish": _Fish}
for _name, _shell in SHELLS.items():
    add_completion_class(_shell, _name)


def _quoted(word: str) -> str:
    return _SPECIAL.sub(r"\\\g<0>", word)


def _typed(line: str, breaks: str) -> tuple[str, int]:
    """The quote that is open at the end of a line; how much of the last word's text is kept there.

    What a shell replaces begins behind an open quote, or behind the last unquoted one of `breaks`.
    """
    quote, length, kept, escaped = "", 0, 0, False
    for character in line:
        if escaped:
            length, escaped = length + 1, False
        elif character == "\\" and quote != "'":
            escaped = True
        elif character == quote:
            quote, kept = "", length
        elif not quote and character in "'\"":
            quote, kept = character, length
        elif not quote and character.isspace():
            length = kept = 0
        else:
            length += 1
            if not quote and character in breaks:
                kept = length
    return quote, kept


@click.command("completion", cls=Command, short_help="Print the completion script of a shell.")
@click.argument("shell", type=Choice(SHELLS, "shell"))
def command(shell: str) -> None:
    """Print the completion script of a shell.

    \b
      bash  eval "$(hpcomp completion bash)" in ~/.bashrc
      zsh   eval "$(hpcomp completion zsh)" in ~/.zshrc
      fish  hpcomp completion fish > ~/.config/fish/completions/hpcomp.fish

    The shell then completes commands, options and their values, files of the kinds that a command
    reads, and behind the :: of a LAYER its keys and their values, with the parts and layers that
    the file has. Hidden files are shown where a name begins with a dot.
    """
    from .group import COMPLETING, cli

    print_data(SHELLS[shell](cli, {}, "hpcomp", COMPLETING).source())
