import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = runpy.run_path(str(ROOT / "benchmarks" / "results_page.py"), run_name="results_page")


def test_the_results_page_is_what_the_records_say():
    remedy = "write it anew with 'python benchmarks/results_page.py'"
    assert (ROOT / "docs" / "results.md").read_text() == SCRIPT["page"](), remedy


def test_every_record_has_its_command_and_every_command_its_record():
    folders = {path.name for path in (ROOT / "benchmarks" / "results").iterdir() if path.is_dir()}
    assert folders == set(SCRIPT["commands"]())
