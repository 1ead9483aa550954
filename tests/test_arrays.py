"""Array helpers equal their definition."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.arrays import concatenate_ranges, find_last_positions, group_rows


@given(st.lists(st.tuples(st.integers(-50, 50), st.integers(0, 6))))
def test_concatenated_ranges_are_the_ranges_in_order(ranges):
    starts, counts = np.array([pair[0] for pair in ranges], int), np.array([pair[1] for pair in ranges], int)
    expected = [value for start, count in ranges for value in range(start, start + count)]
    assert concatenate_ranges(starts, counts).tolist() == expected
    assert concatenate_ranges(7, counts).tolist() == [7 + value for count in counts for value in range(count)]


@given(st.lists(st.integers(0, 9)))
def test_last_positions_are_those_of_the_last_equal_values(values):
    found = find_last_positions(np.array(values, int), 10)
    assert found.tolist() == [max((index for index, value in enumerate(values) if value == number), default=0) for number in range(10)]


@given(st.lists(st.tuples(st.integers(-2, 2), st.sampled_from([-1.5, -0.0, 0.0, 1e-9]))))
def test_groups_of_rows_are_in_lexicographic_order(rows):
    array = np.array(rows, float).reshape(-1, 2)
    distinct = sorted({(first, second + 0.0) for first, second in rows})
    assert group_rows(array).tolist() == [distinct.index((first, second + 0.0)) for first, second in rows]
