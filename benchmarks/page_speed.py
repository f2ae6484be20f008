"""How soon the page shows a picture in Chromium, and how many a second while a training is paused.

mulan demo --out runs/demo
python benchmarks/page_speed.py --run runs/demo/oracle --out runs/page_speed

The page is served by a training of the run's photographs that was paused after some seconds, as ``mulan
train --view`` serves it; browser, page and training share the machine. The mouse drags the scene about
without rest; a window of 1280 x 720 gets moving pictures of 256 x 144.
"""

import io
import os
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tyro
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.viewer.chromium import Chromium, find_chromium

from mulan.evaluation.provenance import provenance
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingStatus, train
from mulan.reconstruction.weights import NoWeights
from mulan.viewer.engine_access import TrainingEngine
from mulan.viewer.goals import GoalFile
from mulan.viewer.page import ViewerPage
from mulan.viewer.viewer_config import ViewerConfig

WIDTH, HEIGHT = 1280, 720  # of the window; a moving picture is a fifth of it
_FEWEST_SHADES = 5.0  # standard deviation of a screenshot that shows a scene: a blank page has none


class EnoughError(Exception):
    """The training has served its purpose."""


@dataclass(frozen=True)
class Options:
    """Time the page."""

    run: Path
    """Run folder with photographs and poses."""
    out: Path
    """Folder for metrics.json and page.png."""
    image_size: int = 192
    """Of the training."""
    learn_s: float = 20.0
    """Seconds of learning before it is paused."""
    seconds: float = 10.0
    """How long pictures are counted."""
    openings: int = 3
    """How often the page is opened."""


def shown(browser: Chromium) -> bool:
    """Whether the middle of the window, clear of panel and notices, shows more than a plain colour."""
    with TemporaryDirectory() as folder:
        try:
            data = browser.screenshot(Path(folder) / "shot.png").read_bytes()
        except AssertionError:
            return False  # the browser is between two pages
    pixels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), float)
    height, width = pixels.shape[:2]
    return pixels[height // 3 :, width // 4 : 7 * width // 10].std() > _FEWEST_SHADES


def first_picture_s(program: str, url: str, page: ViewerPage, screenshot: Path | None) -> dict[str, float]:
    """Seconds from opening the address in a running browser to the picture on its screen."""
    with TemporaryDirectory() as profile:
        browser = Chromium(program, Path(profile), "about:blank", (WIDTH, HEIGHT))
        try:
            known = set(page.pictures)
            began = time.monotonic()
            browser.command("Page.navigate", url=url)
            sent_s = None
            while not shown(browser):
                new = [pictures for key, pictures in page.pictures.items() if key not in known]
                if sent_s is None and any(pictures.frames for pictures in new):
                    sent_s = time.monotonic() - began
                if time.monotonic() - began > 60:
                    raise SystemExit("the page showed nothing within a minute")
            shown_s = time.monotonic() - began
            if screenshot is not None:
                time.sleep(3)  # the fine picture, and the layers
                browser.screenshot(screenshot)
            return {"picture_sent_s": sent_s or shown_s, "picture_shown_s": shown_s}
        finally:
            browser.close()


def moving_pictures(program: str, page: ViewerPage, seconds: float) -> dict[str, Any]:
    """Pictures a second while the camera turns without rest."""
    with TemporaryDirectory() as profile:
        browser = Chromium(program, Path(profile), "about:blank", (WIDTH, HEIGHT))
        try:
            size = {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False}
            browser.command("Emulation.setDeviceMetricsOverride", **size)
            known = set(page.pictures)
            browser.command("Page.navigate", url=page.url)
            while not (new := [p for key, p in page.pictures.items() if key not in known and p.frames]):
                time.sleep(0.05)
            pictures = new[0]
            while pictures.frames < 2:  # the fine one: the page is complete
                time.sleep(0.05)
            mouse: dict[str, Any] = {"button": "left", "buttons": 1, "clickCount": 1}
            browser.command("Input.dispatchMouseEvent", type="mousePressed", x=400, y=400, **mouse)
            began, before, cpu_s = time.monotonic(), pictures.frames, time.process_time()
            took_s, sizes, seen = [], Counter[tuple[int, ...]](), before
            while (now_s := time.monotonic() - began) < seconds:
                x, y = 400 + 120 * np.sin(now_s), 400 + 40 * np.cos(1.7 * now_s)
                browser.command("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **mouse)
                if pictures.frames > seen and pictures.last is not None:
                    seen = pictures.frames
                    took_s.append(pictures.seconds_a_frame)
                    sizes[pictures.last.picture.shape[1::-1]] += 1
            elapsed_s, drawn = time.monotonic() - began, pictures.frames - before
            return {
                "pictures_per_s": drawn / elapsed_s,
                # of this process, the page's: what a busy machine does not change
                "cpu_ms_a_picture": 1e3 * (time.process_time() - cpu_s) / max(drawn, 1),
                "median_ms_a_picture": 1e3 * float(np.median(took_s)) if took_s else None,
                "sizes": {f"{width} x {height}": n for (width, height), n in sizes.items()},
            }
        finally:
            browser.close()


def main(options: Options) -> None:
    program = find_chromium()
    if program is None:
        raise SystemExit("no Chromium on the PATH; 'make browser' installs it on Debian")
    options.out.mkdir(parents=True, exist_ok=True)
    images = read_transforms(RunFolder(options.run).transforms)
    access, over = TrainingEngine(), threading.Event()

    def after_step(status: TrainingStatus) -> None:
        access.after_step(status)
        if over.is_set():
            raise EnoughError

    def learn(folder: str) -> None:
        config = TrainConfig(image_size=options.image_size, time_budget_s=1e6)
        with suppress(EnoughError):
            train(images, NoWeights(), config, RunFolder(Path(folder)), after_step)

    with TemporaryDirectory() as folder:
        thread = threading.Thread(target=learn, args=(folder,))
        thread.start()
        while access.status is None or access.status.seconds < options.learn_s:
            time.sleep(0.1)
        access.pause()
        goals = GoalFile(Path(folder) / "goals.json")
        page = ViewerPage(RunFolder(options.run), access, goals, ViewerConfig())
        openings = [
            first_picture_s(program, page.url, page, options.out / "page.png" if i == 0 else None)
            for i in range(options.openings)
        ]
        moving = moving_pictures(program, page, options.seconds)
        page.stop()
        over.set()
        access.go_on()
        thread.join()
    worst_s = max(opening["picture_shown_s"] for opening in openings)
    metrics = {
        "provenance": provenance(0),
        "learnt_s": options.learn_s,
        "openings": openings,
        "first_picture_s": {"worst": worst_s, "goal": 3.0},
        "moving": moving | {"goal_per_s": 5.0},
        "load_average": list(os.getloadavg()),
    }
    write_json(options.out / "metrics.json", metrics)
    print(f"first picture after {worst_s:.1f} s at worst; {moving['pictures_per_s']:.1f} pictures/s", moving)


if __name__ == "__main__":
    main(tyro.cli(Options))
