from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.table3.moves import MoveConfig
from mulan.evaluation.table3.protocol import PICTURE, Table3Config, table3
from mulan.evaluation.table3.trial import TrialConfig, first_cameras
from mulan.mission.run_folder import RunFolder, read_json
from mulan.planning.team_run import EnsembleConfig
from mulan.simulation.from_scene import SceneMissionConfig
from mulan.simulation.world import ROOM_COURSE

from ..exploration.test_explore import TEAM, XML


@pytest.fixture
def config(tmp_path: Path) -> Table3Config:
    scene = tmp_path / "block.xml"
    scene.write_text(XML)
    trial = TrialConfig(
        scene=SceneMissionConfig(robots=2, width=24, height=18, held_out=2, scene_file=scene),
        team=TEAM,
        moves=MoveConfig(ensemble=EnsembleConfig(members=2, steps=3, image_size=24)),
        steps=3,
        batch_samples=512,
    )
    return Table3Config(seeds=1, first_seed=1000, policies=("random", "ours-straight-on"), trial=trial)


def test_policies_start_alike_and_a_finished_seed_is_kept(config: Table3Config, tmp_path: Path):
    run, said = RunFolder(tmp_path / "table3"), []
    metrics = table3(config, run, lambda _: lambda *_: None, said.append)
    assert len(said) == 2
    written = read_json(run.metrics, "test")["policies"]
    assert list(written) == ["random", "ours-straight-on"]
    at = written["ours-straight-on"]["observations"]
    assert list(at) == ["1", "2", "3", "4"]
    assert at["4"]["psnr_db"]["std"] is None
    difference = at["4"]["psnr_db"]["mean"] - written["random"]["observations"]["4"]["psnr_db"]["mean"]
    assert at["4"]["minus"]["random"]["mean"] == pytest.approx(difference)
    assert (run.root / PICTURE).stat().st_size > 10_000
    folders = [run.root / "seed_1000" / name / "images" / "alpha" for name in ("random", "ours-straight-on")]
    first = [sorted(folder.iterdir())[:3] for folder in folders]
    assert [path.read_bytes() for path in first[0]] == [path.read_bytes() for path in first[1]]
    again = table3(config, run, lambda _: lambda *_: None, said.append)
    assert len(said) == 2, "nothing was done twice"
    assert again["policies"] == metrics["policies"]


def test_robots_start_apart_and_near_what_they_look_at():
    for seed in range(5):
        first = first_cameras(TrialConfig(), ROOM_COURSE, seed)
        alpha, beta = (T[:, :3, 3] for T in first.values())
        assert np.linalg.norm(alpha[-1] - beta[-1]) > 2
        step_m = np.linalg.norm(np.diff(alpha, axis=0), axis=1)
        assert ((step_m > 0.15) & (step_m < 0.5)).all()


def test_an_unknown_policy_is_named(config: Table3Config, tmp_path: Path):
    with pytest.raises(InputError, match="guess"):
        table3(replace(config, policies=("guess",)), RunFolder(tmp_path), lambda _: lambda *_: None, print)
