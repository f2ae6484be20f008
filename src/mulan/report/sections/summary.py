"""The head of the page: what the run is in one line, and its largest numbers."""

import math

from mulan.report.markup import escape
from mulan.report.run_contents import RunContents, setup_metrics, setup_title


def header(contents: RunContents) -> str:
    """Title, one sentence, and tiles."""
    name = contents.run.root.resolve().name
    return (
        f'<header><p class="eyebrow">MULAN run report</p><h1>{escape(name)}</h1>'
        f'<p class="lead">{escape(sentence(contents))}</p>{tiles(contents)}</header>'
    )


def sentence(contents: RunContents) -> str:
    """The run in one line of plain text."""
    parts = []
    if contents.localization is not None:
        robots = contents.localization["robots"]
        photos = sum(len(robot["time_s"]) for robot in robots.values())
        parts.append(f"{_count(len(robots), 'robot')} took {_count(photos, 'photograph')}")
        radio = _count(len(contents.localization["bearings"]), "radio bearing")
        parts.append(
            f"{radio} and {_count(contents.localization['ranges'], 'range')} placed them in one frame"
        )
    metrics = contents.headline_metrics
    if metrics.get("psnr_db") is not None:
        views = f" on {_count(len(metrics['views']), 'held-out view')}" if metrics.get("views") else ""
        parts.append(f"the radiance field reaches {metrics['psnr_db']:.2f} dB PSNR{views}")
    if not parts:
        return "Nothing has been localized or trained in this folder yet."
    text = "; ".join(parts) + "."
    return text[0].upper() + text[1:]


def tiles(contents: RunContents) -> str:
    """The numbers a reader looks for first, those the run has."""
    metrics = contents.headline_metrics
    headline = contents.headline_setup
    found: list[tuple[str, str, str, str]] = []
    # a run without held-out views has none
    if metrics.get("psnr_db") is not None:
        found.append(("PSNR", f"{metrics['psnr_db']:.2f}", "dB", _compared(contents, "psnr_db", "{:.2f}")))
    if metrics.get("ssim") is not None:
        found.append(("SSIM", f"{metrics['ssim']:.3f}", "", _compared(contents, "ssim", "{:.3f}")))
    found += _pose_tiles(contents)
    if "train_seconds" in metrics:
        steps = f"{metrics['steps']:,} steps" if "steps" in metrics else ""
        found.append(("Training time", *_duration(float(metrics["train_seconds"])), steps))
    if not found:
        return ""
    cells = "".join(
        f'<div class="tile"><dt>{escape(label)}</dt><dd><span class="value">{escape(value)}</span>'
        f'<span class="unit">{escape(unit)}</span></dd><p class="note">{escape(note)}</p></div>'
        for label, value, unit, note in found
    )
    whose = (
        f'<p class="caption">Image figures are of “{escape(setup_title(headline))}”.</p>' if headline else ""
    )
    return f'<dl class="tiles">{cells}</dl>{whose}'


def _pose_tiles(contents: RunContents) -> list[tuple[str, str, str, str]]:
    localization = contents.localization or {}
    accuracy = localization.get("accuracy")
    if not accuracy:
        return []
    placed = {name: a for name, a in accuracy.items() if name != localization["anchor"]} or accuracy
    position = math.sqrt(sum(a["position_rms_m"] ** 2 for a in placed.values()) / len(placed))
    yaw = math.sqrt(sum(a["yaw_rms_deg"] ** 2 for a in placed.values()) / len(placed))
    whose = "RMS over all robots" if placed is accuracy else "RMS, robots placed by radio"
    return [
        ("Position error", f"{position * 100:.1f}", "cm", whose),
        ("Heading error", f"{yaw:.2f}", "°", whose),
    ]


def _compared(contents: RunContents, key: str, form: str) -> str:
    others = []
    for name in contents.setups:
        value = setup_metrics(contents, name).get(key)
        if name != contents.headline_setup and value is not None:
            others.append(f"{setup_title(name).lower()} {form.format(value)}")
    if others:
        return " · ".join(others)
    views = contents.headline_metrics.get("views")
    return f"mean of {_count(len(views), 'held-out view')}" if views else ""


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _duration(seconds: float) -> tuple[str, str]:
    return (f"{seconds:.0f}", "s") if seconds < 600 else (f"{seconds / 60:.1f}", "min")
