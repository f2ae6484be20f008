"""Whom the pose graph did not believe, whom it could not place, and what it learned about odometry."""

import math

from mulan.report.markup import Section, caption, escape, table
from mulan.report.run_contents import RunContents


def section(contents: RunContents) -> Section | None:
    """Suspects, robots not placed yet, odometry scales; None where there is nothing to tell."""
    record = contents.localization or {}
    parts = [
        _suspects(record.get("suspects") or []),
        _undetermined(record.get("undetermined") or []),
        _odometry(record.get("odometry") or {}),
    ]
    body = "".join(part for part in parts if part)
    return Section("trust", "What was not believed or not known", body) if body else None


def _suspects(suspects: list[dict]) -> str:
    if not suspects:
        return ""
    rows = []
    for suspect in suspects:
        amount = suspect["amount"]
        turn = suspect["lie"].startswith("bearings")
        shown = "" if amount is None else f"{math.degrees(amount):.0f}°" if turn else f"{amount:.2f} m"
        name = " or ".join([suspect["robot"], *suspect["alternatives"]])
        rows.append(
            [name, suspect["lie"], shown, str(suspect["measurements"]), f"{suspect['evidence_nats']:.0f}"]
        )
    note = (
        "All measurements are so much likelier (logarithm of the ratio) if the robot is wrong; "
        "what it measured was set aside."
    )
    return table(["Robot", "Wrong", "By", "Set aside", "Evidence [nats]"], rows) + caption(note)


def _undetermined(robots: list[dict]) -> str:
    return "".join(
        f'<p class="plain">{escape(r["robot"])} is not placed yet: its {escape(" and ".join(r["freedoms"]))} '
        f"{'is' if len(r['freedoms']) == 1 else 'are'} open. Remedy: {escape(r['remedy'])}.</p>"
        for r in robots
    )


def _odometry(learned: dict[str, dict]) -> str:
    rows = [
        [
            name,
            f"{entry['scale']:.4f} ± {entry['scale_sigma']:.4f}",
            f"{entry['heading_noise']:.2f}",
            f"{entry['translation_noise']:.2f}",
        ]
        for name, entry in learned.items()
        if entry["scale_sigma"] > 0 or entry["heading_noise"] != 1 or entry["translation_noise"] != 1
    ]
    if not rows:
        return ""
    note = "Odometry without a covariance of its own: its scale and the factors on the assumed sigmas."
    return table(["Robot", "Odometry scale", "Heading noise ×", "Position noise ×"], rows) + caption(note)
