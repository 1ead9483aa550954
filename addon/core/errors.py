"""Errors that Farfield raises on purpose.

The message of each is one sentence: the problem, the input that has it, and how to fix it. Operators show it as a report; scripts print it
to stderr and exit with code 2. Messages quote names of files and data-blocks, which may contain anything; `single_line` makes them fit to
be shown.
"""

import re

NOT_PRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")  # control characters and separators of lines
NOT_UNICODE = re.compile("[\ud800-\udfff]")  # how Python decodes bytes that are not UTF-8


class FarfieldError(Exception):
    """Base class of all errors that a user can fix."""


class GeometryError(FarfieldError):
    """The mesh or point cloud is unusable: empty, not finite or without area."""


class ImageError(FarfieldError):
    """The pixels of an image or mask are unusable: too few, none or all masked, of different sizes, or not finite."""


class SettingsError(FarfieldError):
    """A setting is out of range or contradicts another one.

    The message names settings by their labels in the interface. `settings` holds the field names of the settings at fault; the command line
    adds their flags (`settings.with_flags`).
    """

    def __init__(self, message: str, settings: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.settings = settings


class FileError(FarfieldError):
    """A file or folder cannot be read or written."""


class Cancelled(FarfieldError):
    """The user cancelled the job; the scene is unchanged."""


def single_line(message: object) -> str:
    """Return the text of `message` on one line that can be encoded: control characters become spaces, bytes that are no text U+FFFD."""
    return NOT_UNICODE.sub("\ufffd", NOT_PRINTABLE.sub(" ", str(message)))
