"""The bytes of a file that has been described before, and is still the same. Parses nothing."""

from __future__ import annotations

import os

from ..errors import InputError, why

#: Device, number, size and time of the last change.
Identity = tuple[int, int, int, int]


def identity_of(path: str) -> Identity:
    """What changes when another file takes its place, or when it is written to."""
    return _identity(os.stat(path))


def _identity(status: os.stat_result) -> Identity:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


class RawFile:
    """A file, opened when it is first read, then read at any offset; `label` names it in errors.

    Errors: `InputError`, also where it is no longer the one of that identity.
    """

    def __init__(self, path: str, identity: Identity, label: str) -> None:
        self._path, self._identity, self._label = path, identity, label
        self._descriptor: int | None = None

    @property
    def size(self) -> int:
        """The bytes of the file."""
        return self._identity[2]

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def bytes_at(self, offset: int, size: int) -> bytes:
        """`size` bytes from `offset` on; where the file ends before, an error says so."""
        try:
            descriptor, file_bytes = self._opened(), self.size
            # What a damaged file asks for in vain is not even reserved.
            data = os.pread(descriptor, size, offset) if offset + size <= file_bytes else b""
        except OSError as reason:
            raise InputError(f"{self._label}: cannot be read: {why(reason)}") from None
        if len(data) != size:
            raise InputError(f"{self._label}: cannot be read: it ends before byte {offset + size}")
        return data

    def _opened(self) -> int:
        if self._descriptor is None:
            descriptor = os.open(self._path, os.O_RDONLY)
            if _identity(os.fstat(descriptor)) != self._identity:
                os.close(descriptor)
                raise InputError(f"{self._label}: it was changed while it was read: try again")
            self._descriptor = descriptor
        return self._descriptor
