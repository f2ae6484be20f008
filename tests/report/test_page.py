import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.report.page import write_report
from mulan.report.run_contents import read_run

from .synthetic_run import evaluation_run, full_run, write_localization, write_training

VOID = {"meta", "link", "img", "br", "input"}


class Outline(HTMLParser):
    """Collects headings and addresses, and checks that elements nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.headings: list[str] = []
        self.addresses: list[str] = []
        self.feed(text)
        assert self.stack == []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.stack.append(tag)
        self.addresses += [v for k, v in attrs if k in ("src", "href") and v]

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        if self.stack and self.stack[-1] == "h2":
            self.headings.append(data)


def page_of(run: RunFolder) -> str:
    return write_report(run).read_text()


def without_plotly(text: str) -> str:
    return text[: text.index("</main>")]


def test_a_full_run_shows_every_part_once(tmp_path):
    outline = Outline(without_plotly(page_of(full_run(tmp_path / "run"))) + "</main></body></html>")
    assert outline.headings == [
        "Held-out views",
        "Training",
        "Robot paths",
        "Pose accuracy",
        "Angle of arrival",
        "Bearing errors",
        "Next views",
        "Configuration",
        "Next",
    ]


def test_the_page_fetches_nothing_and_weighs_less_than_8_mb(tmp_path):
    page = write_report(full_run(tmp_path / "run"))
    assert page.stat().st_size < 8_000_000
    outline = Outline(without_plotly(page.read_text()) + "</main></body></html>")
    assert all(address.startswith(("data:", "#")) for address in outline.addresses)
    assert "default-src 'none'" in page.read_text()
    assert page.read_text().count("Plotly.react(") == 1


def test_an_evaluation_compares_its_setups_in_one_column_each(tmp_path):
    text = without_plotly(page_of(evaluation_run(tmp_path / "run")))
    for title in ("True poses", "Wireless poses", "Wireless poses, weighted"):
        assert f'<th scope="row">{title}</th>' in text
        assert f"<strong>{title}</strong>" in text
    assert text.count('class="best"') == 2  # PSNR and SSIM; true poses are no rival
    assert '<td class="best">28.40</td>' in text
    assert "--setups:3" in text


def test_what_is_missing_is_named_with_the_command_that_makes_it(tmp_path):
    run = RunFolder(tmp_path / "my run")
    run.record_config("simulate", {"seed": 0})
    text = page_of(run)
    for command in ("localize", "train", "plan"):
        assert f"mulan {command} &#x27;" in text
    assert "Nothing has been localized or trained" in text
    assert len(text) < 50_000  # no chart, no plotly


def test_a_folder_that_holds_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no run"):
        write_report(RunFolder(tmp_path))
    assert not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("part", ["localization", "training"])
def test_each_part_stands_alone(tmp_path, part):
    run = RunFolder(tmp_path)
    if part == "localization":
        write_localization(run, with_truth=False)
    else:
        write_training(run, 25.0)
    text = without_plotly(page_of(run))
    assert 'id="map"' in text
    assert 'id="training"' in text
    assert "Bearing errors" not in text
    assert ("no ground truth" in text) == (part == "localization")


def test_text_from_files_cannot_become_markup(tmp_path):
    evil = '</script><script>alert("x")</script><img src=x onerror=alert(1)>'
    run = full_run(tmp_path / "run")
    record = read_json(run.localization, "")
    record["robots"][evil] = record["robots"].pop("robot_3")
    record["accuracy"][evil] = record["accuracy"].pop("robot_3")
    record["profile"]["peer"] = evil
    record["bearings"][0]["peer"] = evil
    write_json(run.localization, record)
    run.record_config(evil, {evil: evil})
    text = without_plotly(page_of(run))
    assert "<script>" not in text
    assert "<img src=x" not in text
    Outline(text + "</main></body></html>")


def test_a_setup_name_cannot_lead_out_of_the_run(tmp_path):
    run = RunFolder(tmp_path / "run")
    write_training(RunFolder(tmp_path / "other"), 20.0)
    write_json(run.metrics, {"setups": {"../other": {"psnr_db": 1.0}, "..": {"psnr_db": 1.0}}})
    assert "data:image/" not in page_of(run)


def test_a_damaged_file_is_named_in_one_sentence(tmp_path):
    run = full_run(tmp_path / "run")
    run.plan.write_text('{"robots": {"a": {}}}')
    with pytest.raises(InputError, match=r"plan\.json: content: entry 'candidates' is missing"):
        write_report(run)
    run.plan.write_text("{")
    with pytest.raises(InputError, match=r"plan\.json: JSON"):
        write_report(run)
    run.plan.write_text("[]")
    with pytest.raises(InputError, match=r"plan\.json: JSON: holds a list"):
        write_report(run)
    run.plan.unlink()
    (run.renders / "000_true.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"000_true\.png: image"):
        write_report(run)


def test_an_absent_folder_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        write_report(RunFolder(tmp_path / "nowhere"))


def test_the_same_run_gives_the_same_page(tmp_path):
    run = full_run(tmp_path / "run")
    assert page_of(run) == page_of(run)


@pytest.mark.browser
@pytest.mark.parametrize("make", [full_run, evaluation_run])
def test_a_browser_draws_all_charts_without_a_complaint(tmp_path, browse, make):
    page = write_report(make(tmp_path / "run"))
    document, console = browse(page)
    assert 'data-charts="drawn"' in document
    charts = document.count('class="chart"')
    drawn = len(re.findall(r'class="plot js-plotly-plot"', document)) + document.count('class="no-webgl"')
    assert charts == drawn == 5
    assert document.count('class="main-svg"') >= 2 * (charts - 1)
    complaints = [line for line in console.splitlines() if re.search(r":(ERROR|WARNING):CONSOLE", line)]
    assert complaints == []
    assert not re.search(r"Error|Refused|violates", console)


def test_commands_for_an_evaluation_name_the_setup_that_holds_the_field(tmp_path: Path):
    contents = read_run(evaluation_run(tmp_path))
    assert contents.command("plan").endswith("/uncertainty")
    assert not contents.command("report").endswith("/uncertainty")
