"""Which runs of scripts/test.py include the tests in a Blender window."""

import pytest

from lib import environment
from lib.window_tests import FOLDER, WindowTests

TESTS = str(FOLDER.parent)


@pytest.mark.parametrize(
    ("arguments", "are_included", "are_left_out"),
    [
        ([], False, True),
        (["-q", "-k", "levels"], False, True),
        ([TESTS], False, True),
        (["--window"], True, False),
        (["-q", "--window", TESTS], True, False),
        ([str(FOLDER)], True, False),
        ([f"{FOLDER / 'test_headless.py'}::test_name"], True, False),
        ([TESTS, str(FOLDER)], True, False),
        ([str(FOLDER.parent / "bdam")], False, False),
    ],
)
def test_the_window_is_opened_where_it_is_asked_for(arguments, are_included, are_left_out):
    tests = WindowTests(arguments)
    assert (tests.are_included, tests.are_left_out) == (are_included, are_left_out)
    rest = [argument for argument in arguments if argument != "--window"]
    assert tests.arguments == ([f"--ignore={FOLDER}", *rest] if are_left_out else rest)


def test_the_folder_has_the_tests_in_a_window():
    assert FOLDER.is_relative_to(environment.ROOT) and list(FOLDER.glob("test_*_window.py"))
