"""How worker processes report errors: exit codes, and an error message as one line on stderr."""

import json

from ..errors import FarfieldError

EXIT_EXCEPTION, EXIT_ERROR = 1, 2  # exit codes of a worker after any exception, and after it has printed an error message
ERROR_KEY = "farfield_error"  # key of the JSON line on stderr with that message


def encode_error(error: FarfieldError) -> str:
    """Return the line that a worker prints before it exits with EXIT_ERROR. ASCII only: stderr may have any encoding."""
    return json.dumps({ERROR_KEY: str(error)})


def failure_message(code: int, error_output: str, items: str) -> str:
    """Return the error message that a worker has printed, or a description of its second crash.

    code: its exit code, negative for the signal that killed it. items: what it worked on, in plural: "views".
    """
    lines = _lines(error_output)
    if code == EXIT_ERROR:
        for line in reversed(lines):
            if line.startswith("{") and ERROR_KEY in line:
                return json.loads(line)[ERROR_KEY]
    reason = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last_output = f', last output: "{lines[-1]}"' if lines else ""
    return (
        f"A worker process crashed twice at the same {items} ({reason}{last_output}), perhaps because memory ran out. "
        f"Finished {items} are kept; resume with fewer processes."
    )


def worker_exception(error_output: str, items: str) -> Exception:
    """Return the exception with which a worker has failed; its traceback becomes a note for the log of defects."""
    lines = _lines(error_output)
    last_output = lines[-1] if lines else "no output"
    if last_output.partition(":")[0].endswith("MemoryError"):
        return FarfieldError(f"A worker process ran out of memory; finished {items} are kept, so resume with fewer processes.")
    error = RuntimeError(f"in a worker process, {last_output}")
    error.add_note(error_output)
    return error


def _lines(error_output: str) -> list[str]:
    return [line.strip() for line in error_output.splitlines() if line.strip()]
