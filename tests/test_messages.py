"""Texts of messages."""

from farfield.addon.core.messages import first_sentences, join_sentences


def test_sentences_are_joined_once_without_empty_ones():
    assert join_sentences(["One.", "", None, "Two.", "One."]) == "One. Two."


def test_sentences_that_differ_only_in_names_and_numbers_become_one():
    sentences = [f'"Part {number}" has {1000 * number:,} faces.' for number in range(1, 6)]
    assert join_sentences(["Saved.", *sentences]) == 'Saved. "Part 1" has 1,000 faces (likewise "Part 2" and 3 others).'


def test_the_first_sentences_are_those_that_fit():
    message = '"Rock No. 5" has 1.5 m. 2 objects have levels. "Ball" has none.'
    assert first_sentences(message, 50) == '"Rock No. 5" has 1.5 m. 2 objects have levels.'
    assert first_sentences(message, 30) == '"Rock No. 5" has 1.5 m.'
    assert first_sentences(message, len(message)) == message
    assert first_sentences(message, 9) == '"Rock No. 5" has 1.5 m.'
    assert first_sentences("A long sentence. Another one.", 3) == "A long sentence."


def test_two_sentences_and_those_without_names_stay():
    for sentences in (
        ['"A" is flat.', '"B" is flat.'],
        ["1 is odd.", "3 is odd.", "5 is odd."],
        ['"A" has 1.', '"A" has 2.', '"A" has 3.'],
    ):
        assert join_sentences(sentences) == " ".join(sentences)
