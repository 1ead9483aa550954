"""A session in a Blender window: finds and starts operators by *Menu Search*."""

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, current_job, results, save_screenshot, start_session, wait_for_job

SEARCHES = {
    "clip": "Create Clip-Box Terrain",
    "perceptual levels": "Make Perceptual Levels",
    "billboard": "Build Billboard Cloud",
    "farfield clip": "Create Clip-Box Terrain",
}


def search(user: UserInput, text: str) -> Iterator[float]:
    """Search the menus in the 3D Viewport and choose the first result."""
    viewport = user.region("WINDOW")
    center = viewport.x + viewport.width // 2, viewport.y + viewport.height // 2
    user.move(*center)
    yield 0.5
    user.press("F3", *center)
    yield 1.0
    for character in text:
        key = "SPACE" if character == " " else "MINUS" if character == "-" else character.upper()
        user.window.event_simulate(type=key, value="PRESS", unicode=character, x=center[0], y=center[1])
        user.window.event_simulate(type=key, value="RELEASE", x=center[0], y=center[1])
        yield 0.1
    yield 1.5
    save_screenshot(f"search-{text.replace(' ', '-')}")
    user.press("RET", *center)


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user, started = UserInput(), {}
    for text in SEARCHES:
        yield from search(user, text)
        for _ in range(100):
            if current_job() is not None:
                break
            yield 0.02
        started[text] = None if current_job() is None else current_job().title
        viewport = user.region("WINDOW")
        user.press("ESC", viewport.x + viewport.width // 2, viewport.y + viewport.height // 2)
        yield from wait_for_job()
        yield 0.5
    results["started"] = started
    results["wanted"] = SEARCHES


if __name__ == "__main__":
    start_session(session)
