"""What readers leave out of a file with cameras, so that results can name it."""

from collections.abc import Iterator
from contextlib import contextmanager

from ...messages import list_first

UNUSED_MASKS = "The masks that the camera file names are not used; give the folder of the masks."


class UnusableCameraError(Exception):
    """One camera of a file cannot be used, others may be. The message is the reason, a part of a sentence."""


class CameraNotes:
    """Collects cameras that are skipped, with reasons, and remarks, which are sentences."""

    def __init__(self) -> None:
        """Nothing is left out yet."""
        self._skipped: dict[str, list[str]] = {}
        self._remarks: list[str] = []

    @contextmanager
    def skip_unusable(self, name: str) -> Iterator[None]:
        """Skip the camera of the photograph `name` if the block raises an UnusableCameraError."""
        try:
            yield
        except UnusableCameraError as error:
            self._skipped.setdefault(str(error), []).append(f'"{name}"')

    def remark(self, sentence: str) -> None:
        """Add a sentence, once."""
        if sentence not in self._remarks:
            self._remarks.append(sentence)

    @property
    def skipped(self) -> str:
        """The skipped photographs with the reasons, without a period; empty if there are none."""
        return "; ".join(f"{list_first(names)} ({reason})" for reason, names in self._skipped.items())

    @property
    def sentences(self) -> list[str]:
        """All notes."""
        return ([f"Skipped: {self.skipped}."] if self._skipped else []) + self._remarks
