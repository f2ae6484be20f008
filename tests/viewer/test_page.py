import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.viewer.engine_access import FinishedEngine, TrainingEngine
from mulan.viewer.goals import GoalFile
from mulan.viewer.page import ViewerPage
from mulan.viewer.viewer_config import PictureConfig, ViewerConfig
from tests.planning.analytic_engine import BallEngine
from tests.reconstruction.cube_scene import cube_images
from tests.report.synthetic_run import full_run

from .test_engine_access import status_of

SMALL = ViewerConfig(port=18080, picture=PictureConfig(moving_side=64, still_side=128))


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    folder = full_run(tmp_path / "run")
    photos = tmp_path / "photos"
    photos.mkdir()
    write_transforms(cube_images(photos), folder.transforms)
    return folder


def wait(condition, timeout_s: float = 30.0) -> None:
    until = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.browser
def test_a_visitor_sees_the_field_and_the_robots_and_sends_one(run: RunFolder, open_in_chromium, tmp_path):
    page = ViewerPage(run, FinishedEngine(BallEngine()), GoalFile(run.root / "goals.json"), SMALL)
    try:
        browser = open_in_chromium(page.url)
        wait(lambda: any(p.frames >= 2 for p in page.pictures.values()))
        (pictures,) = page.pictures.values()
        colour = pictures.last
        assert colour is not None
        browser.click("Uncertainty")
        wait(lambda: pictures.last is not None and "unsure is bright" in pictures.last.legend)
        page.refresh()
        browser.wait_for("document.body.innerText.includes('unsure is bright')")
        browser.click("Take the view I see")
        wait((run.root / "goals.json").exists)
        goal = json.loads((run.root / "goals.json").read_text())["robot_1"]["T_world_camera"]
        assert np.linalg.det(np.array(goal)[:3, :3]) == pytest.approx(1, abs=1e-3)
        time.sleep(0.5)
        shot = np.asarray(Image.open(browser.screenshot(tmp_path / "page.png")).convert("RGB"), float)
        assert shot[:, : shot.shape[1] // 2].std() > 10
        assert not browser.console
    finally:
        page.stop()


@pytest.mark.browser
def test_the_layers_come_after_the_first_picture_and_go_with_the_last_visitor(run, open_in_chromium):
    page = ViewerPage(run, FinishedEngine(BallEngine()), GoalFile(run.root / "goals.json"), SMALL)
    try:
        assert not page._photographs._frusta
        browser = open_in_chromium(page.url)
        wait(lambda: len(page._photographs._frusta) == len(page._photographs.images))
        assert all(pictures.frames >= 2 for pictures in page.pictures.values())
        browser.close()
        wait(lambda: not page._photographs._frusta)
        assert not page.pictures
    finally:
        page.stop()


@pytest.mark.browser
def test_a_training_can_be_paused_from_the_page(run: RunFolder, open_in_chromium):
    access = TrainingEngine()
    engine, stop = BallEngine(), threading.Event()

    def train() -> None:
        step = 0
        while not stop.is_set():
            step += 1
            time.sleep(0.002)
            access.after_step(status_of(engine, step, 0.5))
        access.end()

    thread = threading.Thread(target=train, daemon=True)
    thread.start()
    page = ViewerPage(run, access, GoalFile(run.root / "goals.json"), SMALL)
    try:
        browser = open_in_chromium(page.url)
        wait(lambda: any(p.frames for p in page.pictures.values()))
        browser.click("Pause")
        wait(lambda: access.paused)
        page.refresh()
        browser.wait_for("document.body.innerText.includes('paused, 27.1 dB')")
        browser.click("Go on")
        wait(lambda: not access.paused)
    finally:
        stop.set()
        access.go_on()
        thread.join(timeout=10)
        page.training_ended()
        page.stop()


def test_a_run_without_a_field_is_told_what_to_do(run: RunFolder):
    with pytest.raises(InputError, match="mulan train"):
        run_command(["view", str(run.root), "--no-open-browser", "--seconds", "0"])


def test_a_training_is_served_while_it_runs(run: RunFolder, capsys: pytest.CaptureFixture[str]):
    options = ["--view", "--viewer.port", "18180", "--steps", "3", "--image-size", "16"]
    assert run_command(["train", str(run.root), *options]) == 0
    assert "Page: http://127.0.0.1:18" in capsys.readouterr().out


def test_a_page_follows_a_mission_that_goes_on(run: RunFolder, tmp_path: Path):
    page = ViewerPage(run, FinishedEngine(BallEngine()), GoalFile(run.root / "goals.json"), SMALL)
    try:
        before = len(page._photographs.images)
        localization = json.loads(run.localization.read_text())
        for robot in localization["robots"].values():
            robot["time_s"] = [2 * time_s for time_s in robot["time_s"]]
        run.localization.write_text(json.dumps(localization))
        more = tmp_path / "more"
        more.mkdir()
        write_transforms(cube_images(more, train=before + 5), run.transforms)
        page.show_mission()
        assert len(page._photographs.images) == before + 5
        assert page._layer_controls._slider is not None
        assert page._layer_controls._slider.value == page._layer_controls._slider.max == 120.0
        assert np.isinf(page._layer_controls.choice().until_s), "who looked at the end still does"
    finally:
        page.stop()
