import pytest

from mulan.cli import progress


def test_without_a_terminal_a_stage_is_one_plain_line(capsys: pytest.CaptureFixture[str]):
    with progress.progress_stages() as stage:
        report = stage("Counting")
        for i in range(100):
            report(i, 100, "")
    assert capsys.readouterr().out.splitlines() == ["Counting ..."]
