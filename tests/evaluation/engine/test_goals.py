from mulan.evaluation.engine.goals import check_goals


def goal(metrics, words):
    (found,) = [goal for goal in check_goals(metrics) if words in goal.name]
    return found


def test_nothing_measured_meets_no_goal():
    assert all(goal.met is None for goal in check_goals({}))


def test_a_goal_is_met_at_its_bound_and_missed_below():
    metrics = {"lego_100": {"psnr_db_at_s": {"5": 29.0, "60": 32.4}}, "lego_200": {"peak_memory_gb": 1.6}}
    assert goal(metrics, "lego_100, 5 s").met is True
    assert goal(metrics, "lego_100, 60 s").met is False
    assert goal(metrics, "peak memory").met is False


def peer(reached_s, last_s, ours_s=2.0):
    return {
        "psnr_curve": [[1.0, 20.0], [last_s, 27.0]],
        "seconds_to_28_db": reached_s,
        "ours_same_views": {"seconds_to_28_db": ours_s, "psnr_curves": {}},
    }


def test_a_peer_that_never_got_there_gives_a_lower_bound():
    metrics = {"peers": {"nerfacto": {"lego_100": peer(None, 300.0)}}}
    found = goal(metrics, "nerfacto")
    assert found.measured == 150.0
    assert found.met is True
    assert "at least" in found.note


def test_the_best_peer_is_the_fastest_foreign_one():
    peers = {"nerfacto": peer(300.0, 300.0), "tensorf": peer(30.0, 60.0), "torch_tuned": peer(10.0, 60.0)}
    metrics = {"peers": {name: {"lego_100": result} for name, result in peers.items()}}
    best = goal(metrics, "best peer")
    assert best.measured == 15.0
    assert best.met is True
    assert goal(metrics, "torch_tuned").goal is None


def test_the_lead_on_fox_is_the_least_at_any_of_their_times():
    ours = {"psnr_curves": {"15": [[1.0, 20.0], [15.0, 25.0]]}, "seconds_to_28_db": None}
    result = {"psnr_curve": [[2.0, 18.0], [15.0, 24.5]], "ours_same_views": ours}
    found = goal({"peers": {"nerfacto": {"fox_270x480": result}}}, "fox")
    assert found.measured == 0.5
    assert found.met is True
