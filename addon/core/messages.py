"""Texts of messages.

Messages quote names of files and data-blocks, which may contain anything; `single_line` makes them fit to be shown.
"""

import re

NOT_PRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # Control characters and line separators.
NOT_UNICODE = re.compile("[\ud800-\udfff]")  # Python decodes bytes that are not UTF-8 to these code points.


def format_count(number: int, noun: str) -> str:
    """Return `number` with its noun: "1 hole", "1,200 holes"."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def single_line(message: object) -> str:
    """Return the text of `message` on one line that can be encoded: control characters become spaces, bytes that are no text U+FFFD."""
    return NOT_UNICODE.sub("\ufffd", NOT_PRINTABLE.sub(" ", str(message)))
