"""Which runs of `scripts/test.py` include the tests that open a Blender window: those with `--window`, and those that name them.

They take minutes and need a Blender program on a virtual screen, see `blender_window`.
"""

from pathlib import Path

import pytest

from . import environment

OPTION = "--window"
FOLDER = environment.ROOT / "tests" / "gui"


class WindowTests:
    """Leaves the tests of FOLDER out of a run, and says so.

    Args:
        arguments: the arguments of the command.
    """

    def __init__(self, arguments: list[str]) -> None:
        rest = [argument for argument in arguments if argument != OPTION]
        named = [Path(argument.partition("::")[0]).resolve() for argument in rest if not argument.startswith("-")]
        named = [path for path in named if path.exists()]
        is_asked = OPTION in arguments or any(path.is_relative_to(FOLDER) for path in named)
        are_named = not named or any(path.is_relative_to(FOLDER) or FOLDER.is_relative_to(path) for path in named)
        self.are_included, self.are_left_out = are_named and is_asked, are_named and not is_asked
        self.arguments = [f"--ignore={FOLDER}", *rest] if self.are_left_out else rest  # for pytest

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Say above the last line that the folder was left out."""
        if self.are_left_out:
            line = f"THE BLENDER WINDOW WAS NOT TESTED; `python3 scripts/test.py {OPTION}` also runs tests/gui"
            terminalreporter.write_line(line, yellow=True, bold=True)
