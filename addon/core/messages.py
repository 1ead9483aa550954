"""Texts of messages.

Messages quote names of files and data-blocks, which may contain anything; `single_line` makes them fit to be shown.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

NOT_PRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # Control characters and line separators.
QUOTED_OR_NUMBER = re.compile(r'"([^"]*)"|\d[\d,.]*(?<=\d)')
SENTENCE_END = re.compile(r"[.!?](?= [\"A-Z0-9])")
NOT_UNICODE = re.compile("[\ud800-\udfff]")  # Python decodes bytes that are not UTF-8 to these code points.
PLURALS = {"mesh": "meshes", "vertex": "vertices", "patch": "patches", "box": "boxes"}  # that do not end in a mere s
MAX_NAMED = 3  # things of a kind that a message names


def format_count(number: int, noun: str) -> str:
    """Return `number` with its noun: "1 hole", "1,200 holes"."""
    return f"{number:,} {noun if number == 1 else PLURALS.get(noun, noun + 's')}"


def quote_names(names: Iterable[object]) -> str:
    """Return names in quotation marks, separated by commas."""
    return ", ".join(f'"{name}"' for name in names)


def list_first(texts: Iterable[str], max_count: int = MAX_NAMED) -> str:
    """Return the first texts, separated by commas, and the number of the others: "one, two, three and 4 more"."""
    texts = list(texts)
    return ", ".join(texts[:max_count]) + (f" and {len(texts) - max_count:,} more" if len(texts) > max_count else "")


def format_bytes(count: int) -> str:
    """Return a number of bytes in the unit that suits it: "12 bytes", "1.5 kB", "2.34 GB"."""
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:,.3g} {unit}" if count < 1e3 * size else f"{count / size:,.0f} {unit}"
    return format_count(count, "byte")


def join_sentences(sentences: Iterable[str | None]) -> str:
    """Return the sentences on one line, without those that are empty and further ones that are equal. Of three or more that differ only in
    quoted names and numbers, the first stands for all: "A" has no UV map (likewise "B" and 31 others)."""
    alike: dict[str, dict[str, None]] = {}
    for sentence in filter(None, sentences):
        alike.setdefault(QUOTED_OR_NUMBER.sub("#", sentence), {})[sentence] = None
    return " ".join(text for group in alike.values() for text in _merge_alike(list(group)))


def _merge_alike(sentences: Sequence[str]) -> Sequence[str]:
    """Return sentences that differ only in names and numbers as one, if there are three or more and each has a name of its own."""
    names = list(dict.fromkeys(next((match[1] for match in QUOTED_OR_NUMBER.finditer(text) if match[1]), "") for text in sentences))
    if len(sentences) < 3 or "" in names or len(names) < 3:
        return sentences
    return [f'{sentences[0].removesuffix(".")} (likewise "{names[1]}" and {format_count(len(names) - 2, "other")}).']


def split_sentences(message: str) -> list[str]:
    """Return the sentences of `message`; at least one, which may be empty."""
    ends = [*(match.start() + 1 for match in SENTENCE_END.finditer(message)), len(message)]
    ends = [end for end in ends if message.count('"', 0, end) % 2 == 0 or end == len(message)]  # names may have the signs of an end
    return [message[start:end].strip() for start, end in pairwise([0, *ends])]


def first_sentences(message: str, max_chars: int) -> str:
    """Return the sentences at the beginning of `message` that have up to `max_chars` characters together, but at least one sentence."""
    first, *others = split_sentences(message)
    for sentence in others:
        if len(first) + 1 + len(sentence) > max_chars:
            break
        first = f"{first} {sentence}"
    return first


def format_number(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, those before the point all the same, and never with an exponent: "0.00012", "45.3",
    "3,390"."""
    if not math.isfinite(value) or value == 0.0:
        return f"{value:g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    text = f"{value:,.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def describe_lacking(lacking: Mapping[str, Sequence[str]], place: str) -> list[str]:
    """Return sentences about what `place`, such as "The file", lacks of things, by their names."""
    by_content: dict[tuple[str, ...], list[str]] = {}
    for name, labels in lacking.items():
        by_content.setdefault(tuple(labels), []).append(name)
    return [f"{place} lacks {', '.join(labels)} of {quote_names(names)}." for labels, names in by_content.items() if labels]


def single_line(message: object) -> str:
    """Return the text of `message` on one line that can be encoded: control characters become spaces, bytes that are no text U+FFFD."""
    return NOT_UNICODE.sub("\ufffd", NOT_PRINTABLE.sub(" ", str(message)))
