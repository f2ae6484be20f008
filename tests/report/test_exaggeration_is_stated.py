import numpy as np

from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.report.page import write_report

from .synthetic_run import write_localization


def test_the_page_states_how_much_larger_ellipses_are_drawn(tmp_path):
    run = RunFolder(tmp_path)
    write_localization(run)
    assert "at true size" in write_report(run).read_text()
    record = read_json(run.localization, "")
    for robot in record["robots"].values():
        robot["covariance"] = (np.array(robot["covariance"]) / 200).tolist()
    write_json(run.localization, record)
    assert "times larger than they are" in write_report(run).read_text()
