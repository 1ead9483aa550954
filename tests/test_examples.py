"""The number of random examples: all with --all, a tenth without it."""

import hypothesis
import pytest
from hypothesis import strategies as st

COUNTS = {"default": 100, "many": 40, "few": 7, "very_few": 3}
seen: dict[str, set[int]] = {name: set() for name in COUNTS}
integers = hypothesis.given(st.integers(0, 2**64))


@integers
def test_default(number):
    seen["default"].add(number)


@hypothesis.settings(max_examples=40)
@integers
def test_many(number):
    seen["many"].add(number)


@integers
@hypothesis.settings(max_examples=7)
def test_few(number):
    seen["few"].add(number)


class TestMethod:
    @hypothesis.settings(max_examples=3)
    @integers
    def test_very_few(self, number):
        seen["very_few"].add(number)


def test_a_tenth_is_taken_unless_all_are_wanted(request):
    """Hypothesis may draw a few values twice."""
    if not all(seen.values()):
        pytest.skip("the other tests of this file have not run")
    quick = {"default": 10, "many": 5, "few": 5, "very_few": 3}
    expected = COUNTS if request.config.option.exhaustive else quick
    assert {name: len(values) for name, values in seen.items()} == pytest.approx(expected, rel=0.25)
