from mulan.evaluation.localization.online import OnlineEvaluationConfig, draw_online, run_online
from mulan.evaluation.localization.online_team import OnlineTeamConfig


def test_a_short_mission_gives_every_figure_and_the_picture(tmp_path):
    config = OnlineEvaluationConfig(
        hours=0.025, large_team=4, large_hours=0.02, scheduling_hours=0.02, team=OnlineTeamConfig(robots=3)
    )
    metrics, times = run_online(config)
    for name in ("p50_update_ms", "p95_update_ms", "peak_memory_mb", "rms_m", "difference_to_batch_m"):
        assert metrics[name] > 0
    assert metrics["robots"] == 3
    assert metrics["rms_m"] < 1.0
    assert metrics["difference_to_batch_m"] < 0.1
    assert 0.3 < metrics["nees_per_dof"] < 4
    assert metrics["bytes_per_s_per_pair"] < 5000
    assert metrics["robots_4"]["robots"] == 4
    draw_online(times, tmp_path / "online.png")
    assert (tmp_path / "online.png").stat().st_size > 1000
