from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from .chromium import Chromium, find_chromium


@pytest.fixture
def open_in_chromium(tmp_path: Path) -> Iterator[Callable[[str], Chromium]]:
    """Opens addresses in headless Chromium."""
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium on the PATH")
    opened: list[Chromium] = []

    def open_page(url: str) -> Chromium:
        opened.append(Chromium(program, tmp_path / f"profile_{len(opened)}", url))
        return opened[-1]

    yield open_page
    for browser in opened:
        browser.close()
