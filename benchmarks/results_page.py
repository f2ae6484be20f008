"""Write docs/results.md from the records in benchmarks/results: ``python benchmarks/results_page.py``.

A table is there only if its record is; every figure is the record's own.
"""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "results.md"

HEAD = """# Results

`python benchmarks/results_page.py` wrote this from the records in [its folder](../benchmarks/results):
nothing is typed by hand, and what was not measured is not here. `$MULAN_DATA` is the data sets' folder.
"""


@dataclass(frozen=True)
class Learning:
    """How a record is shown."""

    title: str
    table: Callable[[dict[str, Any]], list[str]]
    note: str


def main() -> None:
    PAGE.write_text(page())


def page() -> str:
    made_by = commands()
    first = [folder for folder in LEARNING if (RECORDS / folder / "metrics.json").is_file()]
    rest = [folder for folder in made_by if folder not in LEARNING]
    return "\n".join([HEAD, *(section(folder, made_by[folder]) for folder in (*first, *rest))])


def commands() -> dict[str, str]:
    """The command behind each record, as their README names it."""
    rows = re.findall(r"^\| `(\w+)` \| (.+) \|$", (RECORDS / "README.md").read_text(), re.MULTILINE)
    return dict(rows)


def section(folder: str, command: str) -> str:
    metrics, shown = json.loads((RECORDS / folder / "metrics.json").read_text()), LEARNING.get(folder)
    lines = [f"## {shown.title if shown else folder.replace('_', ' ').capitalize()}", "", command, ""]
    lines += [made(metrics), *([shown.note, "", *shown.table(metrics)] if shown else []), ""]
    files = sorted(path.name for path in (RECORDS / folder).iterdir())
    links = [f"[{name}](../benchmarks/results/{folder}/{name})" for name in files]
    return "\n".join([*lines, "Figures and pictures: " + ", ".join(links) + ".", ""])


def made(metrics: dict[str, Any]) -> str:
    """Date, machine and seeds."""
    p = metrics.get("provenance", metrics)
    p = p if "date" in p else next(iter(p.values()))  # measured case by case
    seeds = p.get("seeds", [p["seed"]])
    return f"{p['date']}, {p['machine']}, seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}."


def setups_table(metrics: dict[str, Any], shares: tuple[tuple[str, str], ...]) -> list[str]:
    """A row a setup; shares are the keys of metrics and what stands above them."""
    heads = ["setup", "PSNR [dB]", "aligned [dB]", "SSIM", "FLIP", "camera RMS / median / most [cm]"]
    heads += ["NEES/dof", "time [s]"]
    heads += [head for _, head in shares]
    rows = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, setup in metrics["setups"].items():
        psnr = setup["psnr_db"]
        errors_cm = [100 * setup[f"camera_{what}_m"] for what in ("rms", "median", "max")]
        nees = setup["nees_per_dof"]
        cells = [f"`{name}`", f"{psnr['mean']:.2f}" + (f" ± {psnr['std']:.2f}" if psnr["std"] else "")]
        cells += [f"{setup['aligned_psnr_db']:.2f}", f"{setup['ssim']:.3f}", number(setup["flip"], ".3f")]
        cells += [" / ".join(f"{error:.1f}" for error in errors_cm), "–" if nees is None else f"{nees:.2f}"]
        cells.append(f"{setup['train_seconds']:.0f}")
        cells += [percent(metrics[key].get(name)) for key, _ in shares]
        rows.append("| " + " | ".join(cells) + " |")
    return rows


def table1(metrics: dict[str, Any]) -> list[str]:
    return setups_table(metrics, (("gap_recovered", "of A−B"), ("gap_recovered_vs_alone", "of A−alone")))


def table2(metrics: dict[str, Any]) -> list[str]:
    rows = setups_table(metrics, (("gap_recovered", "of A−C"),))
    told = [f"{pair}: {'holds' if holds else 'does not hold'}" for pair, holds in metrics["order"].items()]
    rows += ["", "; ".join(told) + "."]
    for seed, found in metrics["colmap"].items():
        said = found["why_not"] or f"{found['placed']} of {found['of']} photographs placed"
        rows.append(f"COLMAP, seed {seed}: {said}, {found['seconds']:.0f} s.")
    for name, reasons in metrics["failed"].items():
        rows += [f"`{name}`, seed {seed}: failed, {reason}." for seed, reason in reasons.items()]
    return rows


def ceiling(metrics: dict[str, Any]) -> list[str]:
    """What setup A would score where localization alone puts it."""
    rows = [
        "| seed | A [dB] | put by localization alone [dB] | size off / its sigma [%] |",
        "|---|---|---|---|",
    ]
    for name, seed in metrics["seeds"].items():
        size = f"{100 * seed['size_error']:+.2f} / {100 * seed['size_sigma']:.2f}"
        rows.append(f"| {name[5:]} | {seed['a_psnr_db']:.2f} | {seed['psnr_db']:.2f} | {size} |")
    shares = percent(metrics["gap_recovered"]), percent(metrics["gap_recovered_vs_alone"])
    mean = f"Mean {metrics['psnr_db']:.2f} dB of {metrics['a_psnr_db']:.2f}"
    return [*rows, "", f"{mean}: {shares[0]} of A−B, {shares[1]} of A−alone."]


def soak(metrics: dict[str, Any]) -> list[str]:
    """What became of the messages, the traffic of each pair, memory, and localization."""
    messages, config = metrics["messages"], metrics["config"]
    rows = [
        f"{len(metrics['robots'])} robots, loss {config['loss']:g} each way, jitter {config['jitter_s']:g} s;"
        f" ran {metrics['test_s'] / 60:.1f} minutes (asked for {config['minutes']:g})."
    ]
    rows += ["", "| messages | |", "|---|---|"]
    rows += [f"| {name.replace('_', ' ')} | {count} |" for name, count in messages.items()]
    for who, count in metrics["restarts_survived"].items():
        rows.append(f"| restarts survived, {who} | {count} |")
    for name, rate in metrics["messages_per_s"].items():
        rows.append(f"| received a second, {name.replace('_', ' ')} | {rate:.0f} |")
    for name, lag in metrics["lag_s"].items():
        late = " / ".join(f"{lag[which]:.1f}" for which in ("median", "p95", "largest"))
        rows.append(f"| recorded to received, {name}: median / 95 % / largest [s] | {late} |")
    pairs = metrics["coordination_bytes_per_mission_s_and_pair"]
    rows.append(f"| coordination of a pair, most [kB/s] | {max(pairs.values()) / 1e3:.2f} |")
    for who, megabytes in metrics["peak_memory_mb"].items():
        rows.append(f"| peak memory, {who} [MB] | {megabytes:.0f} |")
    for name, found in metrics.get("localization", {}).items():
        if isinstance(found, dict):
            errors = ", ".join(f"{robot} {100 * m:.1f}" for robot, m in found["position_rms_m"].items())
            rows.append(f"| position error from the {name} bag [cm] | {errors} |")
    rows += [
        f"| localized by minute {told['minutes']:.1f} of {told['messages']} messages [cm] | {_placed(told)} |"
        for told in metrics.get("as_it_arrived", [])
    ]
    return rows


def _placed(told: dict[str, Any]) -> str:
    errors = ", ".join(f"{robot} {100 * m:.0f}" for robot, m in told["position_rms_m"].items())
    return errors or "nobody"


def policies_table(metrics: dict[str, Any]) -> list[str]:
    """A row a policy and number of photographs; then how well variances rank the error, where judged."""
    references = ("random", "farthest-point", "farthest-certain", "ours-blind")
    policies = metrics["policies"]
    kind = "views" if "views" in next(iter(policies.values())) else "observations"
    shown = [name for name in references if name in policies]
    heads = ["policy", kind, "PSNR [dB]", *(f"less `{name}` [dB]" for name in shown), "seeds"]
    rows = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    ranked: list[str] = []
    for name, policy in policies.items():
        for count, at in policy[kind].items():
            psnr = at["psnr_db"]
            spread = f" ± {psnr['std']:.2f}" if psnr["std"] else ""
            less = [gain(at["minus"].get(reference)) for reference in shown]
            cells = [f"`{name}`", count, f"{psnr['mean']:.2f}{spread}", *less, str(policy["seeds"])]
            rows.append("| " + " | ".join(cells) + " |")
            if "ause" in at:
                ause, rank = at["ause"], at["spearman"]
                told = [f"{own} {ause[own]:.2f} and {rank[own]:.2f}" for own in rank]
                ranked.append(f"`{name}`, {count} {kind}: {'; '.join(told)}; by lot {ause['chance']:.2f}.")
    if ranked:
        rows += ["", "AUSE and Spearman on object pixels, by the variance of an ensemble and as learned:", ""]
        rows += [f"- {line}" for line in ranked]
    return rows


def gain(found: dict[str, Any] | None) -> str:
    """A paired difference with its interval."""
    if found is None:
        return "–"
    interval = "" if found["low"] is None else f" ({found['low']:+.2f} to {found['high']:+.2f})"
    return f"{found['mean']:+.2f}{interval}"


def planning_table(metrics: dict[str, Any]) -> list[str]:
    """One line: times, and what choosing together gains."""
    trials, threads = metrics["trials"], metrics["threads"]
    candidates = sorted({count for one in trials for count in one["candidates"]})
    return [
        f"{metrics['robots']} robots, {candidates[0]} to {candidates[-1]} candidates each,"
        f" {len(trials)} trials, {threads} thread{'s' * (threads > 1)}: median {metrics['wall_s']:.2f} s,"
        f" {metrics['cpu_s']:.2f} s of processor. The joint choice gains at least what robots by themselves"
        f" do in {100 * metrics['joint_at_least_alone']:.0f} % of the trials,"
        f" {100 * metrics['joint_gains']:.1f} % more on average."
    ]


def convergence(metrics: dict[str, Any]) -> list[str]:
    rows = [
        "| error | A [dB] | B [dB] | ours [dB] | of A−B | camera median [cm] | converged | told |",
        "|---" * 8 + "|",
    ]
    for error in metrics["errors"]:
        cells = [f"{error['displacement_m']:g} m, {error['turn_deg']:g}°"]
        cells += [f"{error['psnr_db'][name]:.2f}" for name in ("A", "B", "ours")]
        cells += [percent(error["gap_recovered"]), f"{100 * error['camera_median_m']:.1f}"]
        cells += [percent(error["converged"]), percent(error["told"])]
        rows.append("| " + " | ".join(cells) + " |")
    return rows


def gpu_table(metrics: dict[str, Any]) -> list[str]:
    """A row a training time."""
    rows = ["| training time [s] | PSNR [dB] | samples a second [M] |", "|---" * 3 + "|"]
    for seconds in sorted(metrics["psnr_db_at_s"], key=float):
        psnr_db, rate = metrics["psnr_db_at_s"][seconds], metrics["samples_per_s"][seconds]
        rows.append(f"| {seconds} | {psnr_db:.2f} | {rate / 1e6:.0f} |")
    size, samples = metrics["image_size"], metrics["batch_samples"]
    told = f"{metrics['gpu']}, {metrics['data']}, {size} pixels, {samples} samples a step,"
    return [*rows, "", f"{told} {metrics['memory_gib']:.2f} GiB of its memory at most."]


def number(value: float | None, form: str) -> str:
    return "not available" if value is None else format(value, form)


def percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


_SOAK = "Each program a process on loopback, on a machine that did other work as well."

_PAIRED = (
    """Paired differences with their 95 % interval by Student's t; all policies of a seed start alike."""
)
_POOL = "Choosing photographs of lego, 100 pixels"
_STEPS = """A look: 100 pixels, one seed, 2000 steps a setup whatever their time; the seconds are those of one
thread (`OMP_NUM_THREADS=1`) of a machine that did much other work."""
_CLOCK = (
    "lego at 200 x 200 on an otherwise idle machine, the budget in seconds. Training curves lie beside the "
    "metrics; that of `ours` begins after registration."
)
_FULL = """200 pixels, equal steps whatever their time; the seconds are those of one thread
(`OMP_NUM_THREADS=1`) of a machine that did other work as well."""
_CEILING = """Setup A moved and scaled as a whole to where localization's Gaussian finds the true poses most
probable: what correcting poses by photographs could reach at best, since these tell no size."""
_ON_A_GPU = "A look: 100 pixels, one seed, 1000 steps a setup, while other tests ran on the same GPU."
LEARNING = {
    "table3": Learning(
        "Active views in a closed loop, two robots in the furnished room", policies_table, _PAIRED
    ),
    "view_selection": Learning(f"{_POOL}", policies_table, _PAIRED),
    "view_selection_narrow": Learning(f"{_POOL}: half the field of view", policies_table, _PAIRED),
    "view_selection_narrow_distortion": Learning(
        f"{_POOL}: half the field of view, fields that pay for scattered light", policies_table, _PAIRED
    ),
    "view_selection_noisy": Learning(f"{_POOL}: half with a pose error of 0.15 m", policies_table, _PAIRED),
    "view_selection_graded": Learning(f"{_POOL}: pose errors of 0.02 m to 0.08 m", policies_table, _PAIRED),
    "planning": Learning("Planning for a team", planning_table, "The furnished room, small fields included."),
    "table1_paper_200": Learning("Wireless poses: the paper's noise, five seeds", table1, _FULL),
    "table1_loop_200": Learning("Wireless poses: the whole pipeline, five seeds", table1, _FULL),
    "loop_ceiling": Learning(
        "Wireless poses: the whole pipeline if its map had the perfect shape", ceiling, _CEILING
    ),
    "table1_fox": Learning("Wireless poses: the paper's noise on fox", table1, _FULL),
    "table1_fox_loop": Learning("Wireless poses: the whole pipeline on fox", table1, _FULL),
    "table1_time": Learning("Wireless poses: three minutes each on the clock", table1, _CLOCK),
    "table1_loop": Learning("Wireless poses: the whole pipeline, all setups", table1, _STEPS),
    "table1_paper": Learning("Wireless poses: the paper's noise", table1, _STEPS),
    "table1_paper_15": Learning("Wireless poses: the paper's noise, 15 photographs each", table1, _STEPS),
    "table1_paper_spread": Learning("Wireless poses: bearings of 1° to 15°", table1, _STEPS),
    "table1_paper_perfect": Learning("Poses without error of which nobody knows", table1, _STEPS),
    "table1_real_radio": Learning("Wireless poses: bearings of recorded links", table1, _STEPS),
    "convergence": Learning("A whole robot displaced and turned", convergence, _STEPS),
    "table2": Learning("The hardware experiment, simulated: lego, both robots drift", table2, _STEPS),
    "table2_second": Learning("The hardware experiment, simulated: lego, one drifts", table2, _STEPS),
    "table2_fox": Learning("The hardware experiment, simulated: fox, both robots drift", table2, _FULL),
    "gpu": Learning("Learning on a GPU", gpu_table, "Each time is a training of its own, from new."),
    "gpu_refinement": Learning("Wireless poses on a GPU: the paper's noise", table1, _ON_A_GPU),
    "fleet_soak": Learning("The fleet over a bad link, with kills", soak, _SOAK),
    "fleet_soak_first": Learning("The fleet over a bad link, an earlier run", soak, _SOAK),
    "fleet_one_percent": Learning("The fleet over a link that loses 99 of 100 messages", soak, _SOAK),
    "fleet_ten_robots": Learning("Ten robots on one base station", soak, _SOAK),
}
"""Records whose tables are shown; of the others there is a link."""


if __name__ == "__main__":
    main()
