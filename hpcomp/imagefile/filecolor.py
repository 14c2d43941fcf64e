"""What a file says of its colours, and what of it said so. Reads no file."""

from __future__ import annotations

from ..color.encodings import ColorEncoding
from ..records import record

#: What says it where the file does not.
DEFAULT = "default"


@record
class FileColor:
    """How stored RGB means light: `transfer_from` and `primaries_from` say what told each of them.

    `problems`: what is not honoured.
    """

    encoding: ColorEncoding
    transfer_from: str
    primaries_from: str
    problems: tuple[str, ...] = ()
