"""Policies side by side in a terminal: PSNR as views are added, and what each gains over the references."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table


def paired_gains_table(policies: Mapping[str, Any], titles: Mapping[str, str], counted: str) -> Table:
    """A row for each policy and count, narrow enough for a terminal of 80 columns.

    Args:
        policies: As :func:`mulan.evaluation.view_selection.summary.summarise` gives them.
        titles: What a person reads for each.
        counted: Their key for what is counted, ``views`` or ``observations``.
    """
    at_each = [
        (name, count, at) for name, policy in policies.items() for count, at in policy[counted].items()
    ]
    references = [name for name in policies if any(name in at["minus"] for _, _, at in at_each)]
    timed = any(policy["plan_ms"] is not None for policy in policies.values())
    table = Table(box=None, header_style="dim", padding=(0, 1, 0, 0))
    table.add_column("policy")
    headings = [f"less {titles[name]}" for name in references] + ["ms"] * timed
    for heading in (counted, "PSNR", *headings):
        table.add_column(heading, justify="right")
    before = None
    for name, count, at in at_each:
        gains = [_gain(at["minus"].get(reference)) for reference in references]
        plan_ms = policies[name]["plan_ms"]
        ms = ["" if name == before else "–" if plan_ms is None else f"{plan_ms:.1f}"] * timed
        table.add_row("" if name == before else titles[name], count, _psnr(at["psnr_db"]), *gains, *ms)
        before = name
    return table


def _gain(paired: Mapping[str, Any] | None) -> str:
    """Mean with half of its 95 % interval, as far as there are seeds enough."""
    if paired is None:
        return "–"
    half = "" if paired["low"] is None else f"±{paired['mean'] - paired['low']:.2f}"
    return f"{paired['mean']:+.2f}{half}"


def _psnr(psnr_db: Mapping[str, Any]) -> str:
    return f"{psnr_db['mean']:.2f}" + ("" if psnr_db["std"] is None else f"±{psnr_db['std']:.2f}")
