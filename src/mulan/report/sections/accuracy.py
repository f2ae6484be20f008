"""How far the estimated poses are from the truth, robot by robot."""

from mulan.report.markup import Section, caption, table
from mulan.report.run_contents import RunContents


def section(contents: RunContents) -> Section | None:
    """A row a robot: errors, and whether the stated covariance explains them; None before localization."""
    if contents.localization is None:
        return None
    accuracy = contents.localization.get("accuracy")
    if not accuracy:
        text = "This mission carries no ground truth, so the error of its poses is unknown."
        return Section("accuracy", "Pose accuracy", f'<p class="plain">{text}</p>')
    anchor = contents.localization["anchor"]
    rows = [
        [
            f"{name} (anchor)" if name == anchor else name,
            f"{a['position_rms_m'] * 100:.1f}",
            f"{a['rotation_rms_deg']:.2f}",
            f"{a['yaw_rms_deg']:.2f}",
            f"{a['nees_per_dof']:.2f}",
        ]
        for name, a in accuracy.items()
    ]
    header = ["Robot", "Position RMS [cm]", "Rotation RMS [°]", "Heading RMS [°]", "NEES per freedom"]
    note = (
        "NEES is the squared error in units of its stated covariance: 1 is honest, more is overconfident, "
        "less is cautious."
    )
    return Section("accuracy", "Pose accuracy", table(header, rows) + caption(note))
