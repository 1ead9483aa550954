"""JSON text from files of strangers: parsed without surprises, and the types and ranges of its values."""

import json
import reprlib
from typing import Any

from .files.file_access import is_unicode

MAX_TEXT, MAX_SHOWN = 1000, 200  # characters of a value, and of one in a message


def parse_json(content: str | bytes) -> Any:
    """Return the value of JSON text.

    Raises:
        ValueError: it is no JSON, or nested too deeply to be read.
    """
    try:
        return json.loads(content)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def integer(value: object, name: str, minimum: int, maximum: int) -> int:
    """Return `value` if it is an integer within both limits. Raises ValueError, which begins with `name`."""
    if not isinstance(value, int) or isinstance(value, bool) or not minimum <= value <= maximum:
        raise _refusal(value, name)
    return value


def number(value: object, name: str, minimum: float, maximum: float) -> float:
    """Return `value` as a float if it is a number within both limits. Raises ValueError, which begins with `name`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not minimum <= value <= maximum:  # NaN is not within
        raise _refusal(value, name)
    return float(value)


def numbers(value: object, name: str, count: int, minimum: float, maximum: float) -> tuple[float, ...]:
    """Return `value` as a tuple of floats if it is a list of `count` numbers within both limits. Raises ValueError."""
    if not isinstance(value, list) or len(value) != count:
        raise _refusal(value, name)
    return tuple(number(part, name, minimum, maximum) for part in value)


def boolean(value: object, name: str) -> bool:
    """Return `value` if it is true or false. Raises ValueError, which begins with `name`."""
    if not isinstance(value, bool):
        raise _refusal(value, name)
    return value


def text(value: object, name: str) -> str:
    """Return `value` if it is text of at most MAX_TEXT characters that every program can encode. Raises ValueError."""
    if not isinstance(value, str) or len(value) > MAX_TEXT or not is_unicode(value):
        raise _refusal(value, name)
    return value


def _refusal(value: object, name: str) -> ValueError:
    shown = ascii(reprlib.repr(value)) if isinstance(value, str) else reprlib.repr(value)
    return ValueError(f"{name} is {shown if len(shown) <= MAX_SHOWN else shown[:MAX_SHOWN] + '...'}")
