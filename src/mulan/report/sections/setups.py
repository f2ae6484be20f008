"""Two-robot evaluation: the same photographs learned with true, radio and weighted radio poses."""

from typing import Any

from mulan.report.markup import Section, caption, table
from mulan.report.run_contents import RunContents, setup_metrics, setup_title

_COLUMNS = {
    "psnr_db": ("PSNR [dB]", "{:.2f}", max),
    "ssim": ("SSIM", "{:.3f}", max),
    "lpips": ("LPIPS", "{:.3f}", min),
    "position_rms_m": ("Position RMS [m]", "{:.3f}", min),
    "train_seconds": ("Training [s]", "{:.0f}", None),
    "steps": ("Steps", "{:,.0f}", None),
    "paper_psnr_db": ("Paper’s PSNR [dB]", "{:.2f}", None),
}


def section(contents: RunContents) -> Section | None:
    """A row a setup; None for a run that is no evaluation."""
    if not contents.setups:
        return None
    rows = {name: setup_metrics(contents, name) for name in contents.setups}
    keys = [k for k in _COLUMNS if any(_is_number(r.get(k)) for r in rows.values())]
    body = table(
        ["Setup", *(_COLUMNS[k][0] for k in keys)],
        [
            [setup_title(name), *(_COLUMNS[k][1].format(r[k]) if _is_number(r.get(k)) else "–" for k in keys)]
            for name, r in rows.items()
        ],
        best=_best_radio_cells(rows, keys),
    )
    note = "All setups learn from the same photographs; the best setup with radio poses stands out."
    return Section("setups", "Setups compared", body + caption(note))


def _best_radio_cells(rows: dict[str, dict[str, Any]], keys: list[str]) -> list[tuple[int, int]]:
    """Best cells among the setups a robot team could really run; true poses are a reference, not a rival."""
    names = list(rows)
    cells = []
    for column, key in enumerate(keys, start=1):
        better = _COLUMNS[key][2]
        rivals = {n: rows[n][key] for n in names if n != "oracle" and _is_number(rows[n].get(key))}
        if better is not None and len(rivals) > 1:
            cells.append((names.index(better(rivals, key=rivals.__getitem__)), column))
    return cells


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
