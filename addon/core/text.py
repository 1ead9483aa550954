"""Words of messages."""


def format_count(number: int, noun: str) -> str:
    """Return `number` with its noun: "1 hole", "1,200 holes"."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
