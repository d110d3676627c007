# SPDX-License-Identifier: Apache-2.0
"""Reads whole files, with errors that name the file."""

from __future__ import annotations

import enum
import json
import math
import pathlib
import reprlib
from typing import Any, Optional, TypeVar, Union

import yaml

from evpose.errors import InvalidArgumentError, NotFoundError

PathLike = Union[str, pathlib.Path]
_Enum = TypeVar("_Enum", bound=enum.Enum)

# A camera file or a sensor profile is a page of text; the limit bounds the work on another file.
_MAX_TEXT_BYTES = 100_000
# Shortens values in error messages: by YAML aliases, a small file can describe a list that is too large to print.
_REPR = reprlib.Repr()
_REPR.maxlevel = 2
# The limit of google.protobuf.Duration.
_MAX_DURATION_S = 315_576_000_000


def read_file(path: PathLike, max_bytes: Optional[int] = None, what: str = "") -> bytes:
    """Returns the content of a file of at most `max_bytes`; `what` explains this limit. Raises NotFoundError and
    InvalidArgumentError."""
    try:
        with open(path, "rb") as file:
            data = file.read(-1 if max_bytes is None else max_bytes + 1)
    except FileNotFoundError:
        raise NotFoundError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InvalidArgumentError(f"{path}: cannot be read: {error.strerror}") from None
    if max_bytes is not None and len(data) > max_bytes:
        raise InvalidArgumentError(f"{path}: larger than {max_bytes} bytes{what}")
    return data


def read_yaml(path: PathLike, what: str = "") -> Any:
    """Returns the first document of a YAML or JSON file, None if there is none. Raises as read_file()."""
    try:
        text = read_file(path, _MAX_TEXT_BYTES, what).decode()
    except UnicodeDecodeError as error:
        raise InvalidArgumentError(f"{path}: cannot be read: {error}") from None
    try:
        return json.loads(text) if text.lstrip().startswith("{") else next(iter(yaml.safe_load_all(text)), None)
    # LookupError and AttributeError: PyYAML, for a value that contradicts its tag, such as !!int ''.
    except (yaml.YAMLError, ValueError, RecursionError, LookupError, AttributeError) as error:
        raise InvalidArgumentError(f"{path}: neither YAML nor JSON: {error}") from None


def to_number(value: Any, key: str) -> float:
    """Returns the value of a key as a number. Raises InvalidArgumentError with the key."""
    try:
        if isinstance(value, bool):
            raise ValueError
        return float(value)  # YAML 1.1 reads 1e-5 as a text
    except (TypeError, ValueError, OverflowError):  # OverflowError: an integer of hundreds of digits
        raise InvalidArgumentError(f"{key}: {_REPR.repr(value)} is not a number") from None


def to_duration_ns(value: Any, key: str, least_s: float) -> int:
    """Returns a duration in seconds as nanoseconds. Raises InvalidArgumentError with the key."""
    seconds = to_number(value, key)
    if not least_s <= seconds <= _MAX_DURATION_S:
        limit = "" if math.isnan(seconds) or seconds < least_s else f", and at most {_MAX_DURATION_S}"
        raise InvalidArgumentError(f"{key} is {value!r}, but must be a finite number of at least {least_s:g} s{limit}")
    return round(1e9 * seconds)


def to_enum(value: Any, kind: type[_Enum], key: str) -> _Enum:
    """Returns the value of a key as a member of an enumeration. Raises InvalidArgumentError with the key."""
    try:
        return kind(value)
    except ValueError:
        members = ", ".join(f"{kind.__name__}.{each.name}" for each in kind)
        raise InvalidArgumentError(f"{key}: {_REPR.repr(value)} is none of {members}") from None


def to_text(value: Any, key: str) -> str:
    """Returns the value of a key as a text. Raises InvalidArgumentError with the key."""
    if not isinstance(value, (str, int, float)):
        raise InvalidArgumentError(f"{key}: {_REPR.repr(value)} is not a text")
    return str(value)
