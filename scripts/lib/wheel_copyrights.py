"""The copyright holders of wheels, for the manifest of the extension, read from the license files in them."""

import re
import zipfile
from collections.abc import Iterable
from pathlib import Path

LICENSE_FILE = re.compile(r"[^/]+\.dist-info/(?:.*/)?[^/]*(?:licen[cs]e|copying|notice)[^/]*", re.IGNORECASE)
YEARS = r"\d{4}(?:\s?[-\u2013]\s?(?:\d{4}|present))?"
NOTICE = re.compile(rf"copyright\s+(?:(?:\(c\)|\u00a9|&copy;)\s*)?({YEARS}(?:,?\s+{YEARS})*),?\s+(?:by\s+)?([^\W\d].*)", re.IGNORECASE)
END_OF_NAME = re.compile(r"\s*(?:[.,;]?\s+all(?: rights)?(?: reserved)?\W*|,\s+are\b.*|<.*|\(.*|\s[-\u2013]\s.*|\*/.*)$", re.IGNORECASE)
# Authors of sources that wheels were compiled from, whom the license files in the wheels do not name.
UNNAMED = ("2018-2020 Jonathan Young (xatlas)", "2014 Sven Forstmann (Fast Quadric Mesh Simplification)")


def read_copyrights(wheels: Iterable[Path]) -> list[str]:
    """Return "YEARS HOLDER" of all notices in the license files of `wheels`, as Blender's manifest wants it, with one entry per holder."""
    years: dict[str, set[int]] = {}
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            for name in filter(LICENSE_FILE.fullmatch, archive.namelist()):
                for holder, found in find_notices(archive.read(name).decode("utf-8", errors="replace")):
                    years.setdefault(holder, set()).update(found)
    notices = [f"{format_years(years[holder])} {holder}" for holder in sorted(years, key=str.casefold)]
    return [*notices, *UNNAMED]


def find_notices(text: str) -> list[tuple[str, list[int]]]:
    """Return the holders of the copyright notices in a license, with their years."""
    found = []
    for match in NOTICE.finditer(text):
        holder = END_OF_NAME.sub("", match[2]).strip(" \t\r.,;")
        if holder:
            found.append((holder, [int(year) for year in re.findall(r"\d{4}", match[1])]))
    return found


def format_years(years: set[int]) -> str:
    """Return the first and the last year, as in 2001-2026."""
    return f"{min(years)}-{max(years)}" if len(years) > 1 else str(*years)
