from mulan.evaluation.localization.online import OnlineEvaluationConfig, draw_online, run_online


def test_a_short_mission_gives_every_figure_and_the_picture(tmp_path):
    config = OnlineEvaluationConfig(hours=0.03, large_team=6, large_hours=0.02, scheduling_hours=0.02)
    metrics, times = run_online(config)
    for name in ("p50_update_ms", "p95_update_ms", "peak_memory_mb", "rms_m", "difference_to_batch_m"):
        assert metrics[name] > 0
    assert metrics["robots"] == 5
    assert metrics["rms_m"] < 1.0
    assert metrics["difference_to_batch_m"] < 0.1
    assert 0.3 < metrics["nees_per_dof"] < 2.5
    assert metrics["bytes_per_s_per_pair"] < 5000
    assert metrics["robots_6"]["robots"] == 6
    draw_online(times, tmp_path / "online.png")
    assert (tmp_path / "online.png").stat().st_size > 1000
