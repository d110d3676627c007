# SPDX-License-Identifier: Apache-2.0
"""Prophesee RAW and DAT files (core/recordings/README.md, section 1). Their words are sent as they are and not decoded."""

from __future__ import annotations

import os
import pathlib
import re
import stat
import sys
from typing import BinaryIO, Iterator, NamedTuple, Optional, Union

from evpose.errors import DataLossError, InvalidArgumentError, NotFoundError
from evpose.events import Encoding

_MAX_HEADER_BYTES = 64 * 1024
_MAX_DIGITS = 20  # of a number; int() fails beyond some thousands
_ENCODINGS = {"EVT3": Encoding.EVT3, "EVT21": Encoding.EVT21, "EVT2.1": Encoding.EVT21, "EVT2": Encoding.EVT2, "DAT": Encoding.DAT,
              "FLAT64": Encoding.FLAT64}
_VERSIONS = {"3.0": Encoding.EVT3, "3": Encoding.EVT3, "2.1": Encoding.EVT21, "2.0": Encoding.EVT2, "2": Encoding.EVT2}
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")


class Header(NamedTuple):
    """The header of a RAW or DAT file. size_bytes is that of the header, after which the words begin."""

    encoding: Encoding
    width_px: Optional[int]  # None: not stated
    height_px: Optional[int]
    size_bytes: int


def _lines(prefix: bytes) -> tuple[list[str], int]:
    """Returns the lines that begin with "% " and hold no control character, up to "% end", and their size."""
    lines: list[str] = []
    begin = 0
    while prefix[begin:begin + 1] == b"%":
        end = prefix.find(b"\n", begin)
        line = prefix[begin:end if end >= 0 else len(prefix)].removesuffix(b"\r")
        if (len(line) > 1 and line[1:2] != b" ") or _CONTROL.search(line):
            break
        begin = end + 1 if end >= 0 else len(prefix)
        lines.append(line[1:].decode("latin-1").strip())
        if lines[-1].lower() == "end":
            break
    return lines, begin


class _Statements:
    """The statements of a header, each with the number of its line for errors."""

    def __init__(self) -> None:
        self.values: dict[str, tuple[str, int]] = {}
        self.encoding: Optional[tuple[Encoding, int]] = None

    def set_encoding(self, encoding: Optional[Encoding], what: str, line: int) -> None:
        if encoding is None:
            raise InvalidArgumentError(f"header line {line}: {what} is not supported: only EVT3, EVT2.1, EVT2, DAT and FLAT64 are")
        if self.encoding and self.encoding[0] != encoding:
            raise InvalidArgumentError(
                f"header line {line}: states {encoding.name}, but line {self.encoding[1]} states {self.encoding[0].name}")
        self.encoding = self.encoding or (encoding, line)

    def set(self, key: str, value: str, line: int) -> None:
        if key in ("width", "height"):
            if not (value.isascii() and value.isdigit() and len(value) <= _MAX_DIGITS and int(value) > 0):
                raise InvalidArgumentError(f"header line {line}: the {key} {value!r} is not a positive number of pixels")
            if key in self.values and int(self.values[key][0]) != int(value):
                raise InvalidArgumentError(
                    f"header line {line}: states {key} {value}, but line {self.values[key][1]} states {self.values[key][0]}")
        self.values.setdefault(key, (value, line))

    def read(self, text: str, line: int) -> None:
        key, _, value = text.partition(" ")
        key, value = key.lower(), value.strip()
        if text.lower().startswith("data file containing"):
            self.set_encoding(Encoding.DAT, "", line)
        elif key == "evt":
            self.set_encoding(_VERSIONS.get(value), f"EVT {value}", line)
        elif key == "format":
            name, *options = value.split(";")
            self.set_encoding(_ENCODINGS.get(name.strip().upper()), f"the format {name!r}", line)
            for option in options:
                option_key, _, option_value = option.partition("=")
                self.set(option_key.strip().lower(), option_value.strip(), line)
        elif key == "geometry":
            width, _, height = value.partition("x")
            self.set("width", width, line)
            self.set("height", height, line)
        elif key in ("width", "height", "version", "endianness"):
            self.set(key, value, line)

    def size(self, key: str) -> Optional[int]:
        return int(self.values[key][0]) if key in self.values else None

    def check_variant(self) -> Encoding:
        if self.encoding is None:
            raise InvalidArgumentError("the header names no format: no line '% format ...', '% evt ...' or '% Data file containing ...'")
        encoding = self.encoding[0]
        version, order = self.values.get("version"), self.values.get("endianness")
        if encoding == Encoding.DAT and version and version[0] != "2":
            raise InvalidArgumentError(f"header line {version[1]}: version {version[0]} of DAT is not supported: only version 2 is")
        if encoding == Encoding.EVT21 and order and order[0] != "little":
            raise InvalidArgumentError(f"header line {order[1]}: EVT2.1 words in the order {order[0]!r} are not supported: only 'little' is")
        return encoding


def parse_header(prefix: bytes) -> Header:
    """Reads the header at the start of a file. Raises InvalidArgumentError with the number of the line."""
    lines, size = _lines(prefix[:_MAX_HEADER_BYTES + 1])
    if size > _MAX_HEADER_BYTES:
        raise InvalidArgumentError(f"the header is longer than {_MAX_HEADER_BYTES} bytes")
    if not lines:
        raise InvalidArgumentError("there is no header: a RAW or DAT recording begins with lines that start with '% '; "
                                   "`evpose convert FILE recording.raw` makes one of other formats")
    statements = _Statements()
    for number, line in enumerate(lines, 1):
        statements.read(line, number)
    encoding = statements.check_variant()
    if encoding == Encoding.DAT:
        binary = prefix[size:size + 2]
        if len(binary) < 2:
            raise InvalidArgumentError("the file ends before the two bytes that end a DAT header")
        if binary[0] not in (0, 12) or binary[1] != 8:
            raise InvalidArgumentError(f"the two bytes after the DAT header state events of type {binary[0]} and {binary[1]} bytes; "
                                       "only types 0 and 12 of 8 bytes are supported")
        size += 2
    return Header(encoding, statements.size("width"), statements.size("height"), size)


class Recording:
    """A RAW or DAT file. Iterate over it for its chunks of encoded events; each iteration begins at the start of a file.

    encoding             of the words
    width_px, height_px  of the sensor; None if the header does not state them
    """

    def __init__(self, path: Union[str, pathlib.Path], chunk_bytes: int = 128 * 1024) -> None:
        """Opens a file, or standard input for "-". `chunk_bytes` is the maximum size of a chunk; the poses do not depend on it.
        From a pipe, what has arrived is a chunk. Raises NotFoundError and InvalidArgumentError with the path."""
        if chunk_bytes < 8 or chunk_bytes % 8:
            raise InvalidArgumentError(f"chunk_bytes is {chunk_bytes}, but must be a multiple of 8, the longest word")
        self.path = str(path)
        self._chunk_bytes = chunk_bytes
        self._file = self._open()
        self._opened = os.fstat(self._file.fileno())
        try:
            # A header ends with "% end" or with the first byte of data; a camera sends it at once.
            self._prefix = self._read_prefix()
            header = parse_header(self._prefix)
        except InvalidArgumentError as error:
            self.close()
            raise error.with_message(f"{self.path}: {error}") from None
        self.encoding, self.width_px, self.height_px, self._header_bytes = header
        self._is_pipe = not self._file.seekable()
        self._was_read = False
        if not self._is_pipe and len(self._prefix) <= self._header_bytes:
            self.close()
            raise InvalidArgumentError(f"{self.path}: has a header but no events")

    def _open(self) -> BinaryIO:
        if self.path == "-":
            return sys.stdin.buffer
        try:
            return open(self.path, "rb", buffering=0)
        except FileNotFoundError:
            raise NotFoundError(f"{self.path}: there is no such file") from None
        except OSError as error:
            raise InvalidArgumentError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _read_some(self, size: int) -> bytes:
        try:
            return os.read(self._file.fileno(), size)
        except OSError as error:
            raise InvalidArgumentError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _read_prefix(self) -> bytes:
        prefix = b""
        while len(prefix) <= _MAX_HEADER_BYTES + 2:
            lines, size = _lines(prefix)
            is_complete = (bool(lines) and lines[-1].lower() == "end") or size < len(prefix)
            if is_complete and len(prefix) >= size + 2:
                break
            more = self._read_some(_MAX_HEADER_BYTES)
            if not more:
                break
            prefix += more
        return prefix

    def __iter__(self) -> Iterator[bytes]:
        """Yields chunks of whole words; an unfinished word at the end is left out. Raises InvalidArgumentError with the path, and at the
        end DataLossError if the file has changed since it was opened."""
        if self._is_pipe and self._was_read:
            raise InvalidArgumentError(f"{self.path}: a pipe can be read only once")
        self._was_read = True
        rest = b""
        if self._is_pipe:
            rest = self._prefix[self._header_bytes:]
        else:
            os.lseek(self._file.fileno(), self._header_bytes, os.SEEK_SET)
        word = self.encoding.word_bytes
        while True:
            data = self._read_some(self._chunk_bytes)
            is_end = not data
            data = rest + data if rest else data
            whole = len(data) - len(data) % word
            for begin in range(0, whole, self._chunk_bytes):
                yield data[begin:min(begin + self._chunk_bytes, whole)]  # bytes[:] of everything is not a copy
            rest = data[whole:]
            if is_end:
                self._check_unchanged()
                return

    def _check_unchanged(self) -> None:
        """What was read is a recording only if the file was the same from its first byte to its last."""
        before, now = self._opened, os.fstat(self._file.fileno())
        if not stat.S_ISREG(before.st_mode):
            return
        if now.st_size != before.st_size:
            change = f"its size was {before.st_size} bytes and is {now.st_size}"
        elif now.st_mtime_ns != before.st_mtime_ns:
            change = "it was written to"
        elif self.path != "-" and self._is_replaced():
            change = "another file has replaced it"
        else:
            return
        raise DataLossError(f"{self.path}: changed while it was read: {change}; read it again when it is complete")

    def _is_replaced(self) -> bool:
        try:
            named = os.stat(self.path)
        except OSError:  # it was removed: what was opened is still whole
            return False
        return (named.st_dev, named.st_ino) != (self._opened.st_dev, self._opened.st_ino)

    def close(self) -> None:
        """Closes the file."""
        if self.path != "-":
            self._file.close()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
