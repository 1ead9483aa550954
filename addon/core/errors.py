"""Errors that Farfield raises on purpose.

Each carries one sentence that says what is wrong, with which input, and what to do about it. Operators turn it into a report, scripts
into exit code 2 and that sentence on stderr.
"""


class FarfieldError(Exception):
    """Base of every error that a user can mend."""


class GeometryError(FarfieldError):
    """The mesh or point cloud cannot be worked on: empty, not finite, without area."""


class SettingsError(FarfieldError):
    """A setting is out of its range or contradicts another one."""


class FileError(FarfieldError):
    """A file or folder cannot be read or written."""


class Stopped(FarfieldError):
    """The user stopped the work; nothing was changed."""
