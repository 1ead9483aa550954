"""File names made of arbitrary names."""

import os
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.files.filenames import MAX_FILENAME_BYTES, safe_filename, unique_filenames

NAMES = st.text(st.characters(exclude_categories=()), max_size=300)  # with separators, control characters and surrogates


@pytest.mark.parametrize(
    ("name", "filename"),
    [
        ("Tree", "Tree"),
        ("Bäume 木.001", "Bäume 木.001"),
        ("A/B", "A_B"),
        ("../../escaped", "_.._escaped"),
        ("/etc/passwd", "_etc_passwd"),
        ("C:\\x", "C__x"),
        ("line\nbreak\u2028", "line_break_"),
        (".hidden", "hidden"),
        ("..", "unnamed"),
        ("", "unnamed"),
        ("con", "_con"),
        ("Aux.txt", "_Aux.txt"),
        ("a\udcff", "a_"),
        ("end. ", "end"),
    ],
)
def test_known_names(name, filename):
    assert safe_filename(name) == filename


@given(NAMES)
def test_every_name_gives_one_file_in_its_folder(name):
    filename = safe_filename(name)
    assert 0 < len(filename.encode()) <= MAX_FILENAME_BYTES
    assert not set('<>:"/\\|?*\0\n\r\t') & set(filename) and filename == filename.strip(". ")
    assert os.path.basename(os.path.normpath(f"folder/{filename}")) == filename  # noqa: PTH119
    assert safe_filename(filename) == filename


def test_long_names_are_cut_at_a_character():
    assert safe_filename("木" * 200) == "木" * (MAX_FILENAME_BYTES // 3)
    assert safe_filename("a" * 400) == "a" * MAX_FILENAME_BYTES


@given(st.lists(st.sampled_from(["a", "A", "a_2", "A_2", "é", "e\u0301", "b" * 150, "b" * 151, "/", "\\", "con"]), max_size=12))
def test_unique_names_differ_on_every_file_system(names):
    filenames = unique_filenames(names)
    keys = {unicodedata.normalize("NFC", filename).casefold() for filename in filenames}
    assert len(keys) == len(filenames) == len(names)
    assert all(safe_filename(filename) == filename for filename in filenames)


def test_different_names_stay_as_they_are():
    assert unique_filenames(["Oak", "Pine", "oak", "Oak"]) == ["Oak", "Pine", "oak_2", "Oak_3"]
