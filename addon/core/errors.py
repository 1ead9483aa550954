"""Errors that Farfield raises on purpose.

The message of each is one sentence: the problem, the input that has it, and how to fix it. Operators show it as a report; scripts print it
to stderr and exit with code 2.
"""


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
