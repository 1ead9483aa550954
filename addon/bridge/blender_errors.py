"""Messages of the errors that Blender raises."""


def error_sentence(error: RuntimeError) -> str:
    """Return the message of an error that a function of Blender raised, on one line, without its final full stop."""
    return " ".join(str(error).removeprefix("Error: ").split()).rstrip(".")
