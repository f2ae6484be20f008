import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.evaluation.view_selection.fields import FieldsConfig, judged_fields, planning_fields
from mulan.evaluation.view_selection.judgement import judge, rank_correlation
from mulan.evaluation.view_selection.policies import POLICIES
from mulan.evaluation.view_selection.pools import PoolKind, PoolSource
from mulan.evaluation.view_selection.protocol import ViewSelectionConfig, view_selection
from mulan.evaluation.view_selection.trial import TrialConfig
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.radiance.config import FieldConfig
from mulan.reconstruction.dataset import ImageTensors

from ...reconstruction.cube_scene import cube_images

FIELD = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=32, width=16)
FIELDS = FieldsConfig(24, 30, 15, 1024, FIELD, judged_field=FIELD)
TRIAL = TrialConfig((3, 4), 2, 2, FIELDS, 2)


def compare(images, folder, kind=PoolKind.STANDARD, policies=("random", "ours"), seeds=1):
    said = []
    config = ViewSelectionConfig(kind, seeds, 100, policies, TRIAL)
    metrics = view_selection(images, config, RunFolder(folder), lambda _: lambda *_: None, said.append)
    return metrics, said


def test_every_policy_runs_on_a_pool_it_is_made_for(tmp_path):
    images = cube_images(tmp_path, train=6, test=1)
    noisy = ("farthest-certain", "ours-blind", "ours")
    for kind, policies in ((PoolKind.NARROW, ()), (PoolKind.GRADED, noisy)):
        metrics, _ = compare(images, tmp_path / kind.value, kind, policies)
        expected = policies or tuple(p.name for p in POLICIES if kind in p.pools)
        assert tuple(metrics["policies"]) == expected
        for policy in metrics["policies"].values():
            assert set(policy["views"]) == {"3", "4"}
            assert 5 < policy["views"]["4"]["psnr_db"]["mean"] < 60
        assert metrics["policies"]["ours"]["plan_ms"] > 0
        assert set(metrics["policies"]["ours"]["views"]["4"]["ause"]) == {"ensemble", "learned", "chance"}
        assert metrics == json.loads((tmp_path / kind.value / "metrics.json").read_text())
        assert (tmp_path / kind.value / "view_selection.png").stat().st_size > 10_000


def test_policies_of_a_seed_start_from_the_same_views_and_choose_each_view_once(tmp_path):
    compare(cube_images(tmp_path, train=6, test=1), tmp_path / "out", policies=("random", "farthest-point"))
    chosen = {
        name: json.loads((tmp_path / "out" / "seed_100" / f"{name}.json").read_text())["observations"]
        for name in ("random", "farthest-point")
    }
    for observations in chosen.values():
        assert len(set(observations["4"]["chosen"])) == 4
        assert set(observations["3"]["chosen"]) < set(observations["4"]["chosen"])
    assert len(set(chosen["random"]["3"]["chosen"]) & set(chosen["farthest-point"]["3"]["chosen"])) >= 2


def test_finished_trials_are_kept_and_others_join_them(tmp_path):
    images = cube_images(tmp_path, train=7, test=1)
    first, said = compare(images, tmp_path / "out", policies=("random",))
    assert len(said) == 1
    both, said = compare(images, tmp_path / "out", policies=("farthest-point",))
    assert len(said) == 1
    assert list(both["policies"]) == ["random", "farthest-point"]
    assert (
        both["policies"]["random"]["views"]["3"]["psnr_db"]
        == first["policies"]["random"]["views"]["3"]["psnr_db"]
    )
    _, said = compare(images, tmp_path / "out", policies=("random", "farthest-point"), seeds=2)
    assert len(said) == 2
    moved = replace(images, train=images.train[1:])
    assert len(compare(moved, tmp_path / "out", policies=("random",))[1]) == 1


def test_the_same_choice_gives_the_same_field_bit_for_bit(tmp_path):
    pool = PoolSource(cube_images(tmp_path, train=6, test=1), PoolKind.NOISY, 24).pool(0)
    a, b = (judge(judged_fields(pool, chosen, 2, 7, FIELDS), pool.test) for chosen in ((0, 2, 4), (4, 0, 2)))
    assert a == b
    assert a["ensemble_psnr_db"] != a["psnr_db"]


def test_a_distortion_weight_draws_the_light_of_each_ray_together(tmp_path):
    pool = PoolSource(cube_images(tmp_path, train=6, test=1), PoolKind.NARROW, 24).pool(0)
    rays = ImageTensors(pool.test).image_rays(0)

    def scatter_m(fields):
        seen = fields[0].sample(rays.origins, rays.directions)
        depth_m = torch.zeros(len(rays.origins)).index_add(0, seen.ray_index, seen.blend * seen.distance_m)
        light = torch.zeros(len(rays.origins)).index_add(0, seen.ray_index, seen.blend)
        mean_m = (depth_m / light.clamp_min(1e-6))[seen.ray_index]
        return float((seen.blend * (seen.distance_m - mean_m).abs()).sum() / light.sum())

    costly = replace(FIELDS, steps=120, distortion_weight=0.1)
    free = replace(costly, distortion_weight=0.0)
    for learn in (judged_fields, planning_fields):
        longer = {"planning_steps": 120}
        costs, leaves = (learn(pool, (0, 1, 2), 1, 7, replace(c, **longer)) for c in (costly, free))
        assert scatter_m(costs) < 0.8 * scatter_m(leaves)


def test_rank_correlation_of_a_constant_is_none():
    x = np.arange(5.0)
    assert rank_correlation(x, x**3) == pytest.approx(1)
    assert rank_correlation(np.ones(5), x) == 0


def test_what_cannot_be_asked_is_one_sentence(tmp_path):
    images = cube_images(tmp_path, train=6, test=1)
    with pytest.raises(InputError, match=r"policy 'best'.*choose from random"):
        compare(images, tmp_path / "out", policies=("best",))
    with pytest.raises(InputError, match="--seeds"):
        compare(images, tmp_path / "out", seeds=0)
    config = ViewSelectionConfig(trial=replace(TRIAL, views=(3, 50)))
    with pytest.raises(InputError, match="6 are too few for 50 views"):
        view_selection(images, config, RunFolder(tmp_path), lambda _: lambda *_: None, print)
    with pytest.raises(InputError, match="--first-views"):
        view_selection(
            images,
            replace(config, trial=replace(TRIAL, first_views=4)),
            RunFolder(tmp_path),
            lambda _: lambda *_: None,
            print,
        )


def test_the_command_compares_on_any_posed_image_set(tmp_path, capsys):
    images = cube_images(tmp_path, train=5, test=1)
    write_transforms(images, tmp_path / "transforms.json")
    out = tmp_path / "out"
    arguments = ["evaluate", "view-selection", "--data", str(tmp_path), "--out", str(out), "--seeds", "1"]
    more = [
        "--image-size",
        "24",
        "--steps",
        "4",
        "--planning-steps",
        "2",
        "--views",
        "3",
        "--first-views",
        "2",
    ]
    assert run_command([*arguments, *more, "--pool", "graded", "--policies", "random,ours"]) == 0
    assert set(json.loads((out / "metrics.json").read_text())["policies"]) == {"random", "ours"}
    assert "AUSE" in capsys.readouterr().out
    with pytest.raises(InputError, match="--views: 'many'"):
        run_command([*arguments, "--views", "many"])
    with pytest.raises(InputError, match=r"--distortion-weight.*zero or more"):
        run_command([*arguments, "--distortion-weight", "nan"])
