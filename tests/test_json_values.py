"""Values of JSON from files of strangers: whatever the text is, a value of the right type and range, or one ValueError."""

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.json_values import boolean, integer, number, numbers, parse_json, text
from farfield.addon.core.texmesh.figures import read_figures
from farfield.addon.core.texmesh.perception.recorded_answers import read_answers

NESTED = "[" * 200_000
JUNK = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(), lambda part: st.lists(part, max_size=3))


@pytest.mark.parametrize("content", [NESTED, '{"a":' * 200_000, "", "[1", b"\xff", "9" * 10_000])
def test_text_that_is_no_json_or_too_deep_is_a_value_error(content):
    with pytest.raises(ValueError):
        parse_json(content)


@given(JUNK)
@example([["long text" * 20] * 6] * 6)
def test_values_are_of_the_type_and_within_the_range(value):
    checks = {
        "integer": (lambda: integer(value, "x", -5, 5), lambda found: type(found) is int and -5 <= found <= 5),
        "number": (lambda: number(value, "x", -5, 5), lambda found: type(found) is float and -5 <= found <= 5),
        "numbers": (lambda: numbers(value, "x", 2, -5, 5), lambda found: len(found) == 2 and all(-5 <= part <= 5 for part in found)),
        "boolean": (lambda: boolean(value, "x"), lambda found: type(found) is bool),
        "text": (lambda: text(value, "x"), lambda found: found.encode() is not None and len(found) <= 1000),
    }
    for check, is_right in checks.values():
        try:
            found = check()
        except ValueError as error:
            assert str(error).startswith("x is ") and len(str(error)) < 300
        else:
            assert is_right(found) and found == (tuple(value) if isinstance(value, list) else value)


@pytest.mark.parametrize("content", [NESTED, "null", '"', "[1]", "{}", "5", 5, b"x"])
def test_damaged_custom_properties_are_a_sentence(content):
    for read in (read_figures, read_answers):
        with pytest.raises(SettingsError):
            read(content)


def test_huge_numbers_are_out_of_range():
    assert json.loads("1e400") == float("inf")
    for value in (10**400, float("inf"), -float("inf"), float("nan")):
        with pytest.raises(ValueError):
            number(value, "x", -1e300, 1e300)
    assert number(1, "x", 1, 1) == 1.0
