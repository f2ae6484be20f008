import io
import re

from rich.console import Console

from mulan.cli.paired_gains import paired_gains_table
from mulan.evaluation.view_selection.policies import POLICIES, TITLES
from mulan.evaluation.view_selection.summary import summarise


def figures(psnr_db: float) -> dict:
    observations = {count: {"psnr_db": psnr_db + int(count)} for count in ("5", "10", "20")}
    return {"observations": observations, "plan_ms": 12.5}


def printed(seeds: int) -> str:
    drawn = {
        seed: {policy.name: figures(10 + i * (1 + seed) / 10) for i, policy in enumerate(POLICIES)}
        for seed in range(seeds)
    }
    policies = summarise(drawn, tuple(TITLES), (5, 10, 20))["policies"]
    text = io.StringIO()
    Console(file=text, width=80).print(paired_gains_table(policies, TITLES, "views"))
    return text.getvalue()


def test_all_policies_and_references_are_whole_in_eighty_columns():
    text = printed(seeds=2)
    assert "…" not in text
    assert len(re.findall(r"\d\d\.\d\d±\d\.\d\d", text)) >= 3 * len(POLICIES)
    for title in TITLES.values():
        assert all(word in text for word in title.split())


def test_one_seed_has_no_interval():
    text = printed(seeds=1)
    assert "±" not in text
    assert re.search(r"\+0\.10", text)
