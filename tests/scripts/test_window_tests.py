"""Which runs of scripts/test.py include the tests in a Blender window."""

import pytest

from lib import environment
from lib.window_tests import FOLDER, WindowTests

TESTS = str(FOLDER.parent)


@pytest.mark.parametrize(
    ("arguments", "are_left_out"),
    [
        ([], True),
        (["-q", "-k", "levels"], True),
        ([TESTS], True),
        (["--window"], False),
        (["-q", "--window", TESTS], False),
        ([str(FOLDER)], False),
        ([f"{FOLDER / 'test_headless.py'}::test_name"], False),
        ([TESTS, str(FOLDER)], False),
        ([str(FOLDER.parent / "bdam")], False),
    ],
)
def test_the_window_is_opened_where_it_is_asked_for(arguments, are_left_out):
    tests = WindowTests(arguments)
    assert tests.are_left_out == are_left_out
    rest = [argument for argument in arguments if argument != "--window"]
    assert tests.arguments == ([f"--ignore={FOLDER}", *rest] if are_left_out else rest)


def test_the_folder_has_the_tests_in_a_window():
    assert FOLDER.is_relative_to(environment.ROOT) and list(FOLDER.glob("test_*_window.py"))
