"""One policy on one pool: chosen, learnt anew at the numbers reported, judged, kept."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mulan.evaluation.view_selection.fields import FieldsConfig, judged_fields, planning_fields
from mulan.evaluation.view_selection.judgement import judge
from mulan.evaluation.view_selection.policies import OURS, Policy
from mulan.evaluation.view_selection.pools import Pool
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.planning.knowledge import Knowledge
from mulan.planning.selection import choose_views
from mulan.radiance.engine import RadianceEngine

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


@dataclass(frozen=True)
class TrialConfig:
    """How views are chosen and judged."""

    views: tuple[int, ...] = (5, 10, 20)
    """Numbers of views at which a field is learnt from scratch and judged."""
    first_views: int = 4
    """Views every policy starts from."""
    round_views: int = 2
    """Views chosen between two looks at what was learnt."""
    fields: FieldsConfig = field(default_factory=FieldsConfig)
    """How fields are learnt."""
    members: int = 5
    """Fields of the ensemble whose variance is judged; policies plan with as many as their rule asks for."""
    variance_of: tuple[str, ...] = (OURS,)
    """Policies whose fields' variance is judged too, which takes further members."""


class FirstFields:
    """Planning fields of the views all policies of a seed start from, learnt once."""

    def __init__(self, pool: Pool, seed: int, config: TrialConfig) -> None:
        self.pool, self.seed, self.config = pool, seed, config
        self.chosen = pool.first_views(config.first_views, seed)
        self._fields: list[RadianceEngine] | None = None

    def of(self, chosen: Sequence[int], members: int) -> list[RadianceEngine]:
        """Planning fields of any chosen views; those of the first are kept."""
        if sorted(chosen) != self.chosen:
            return planning_fields(self.pool, chosen, members, self.seed, self.config.fields)
        if self._fields is None:
            self._fields = planning_fields(
                self.pool, chosen, self.config.members, self.seed, self.config.fields
            )
        return self._fields[:members]


def finished_trial(made_from: str, policy: Policy, run: RunFolder) -> dict[str, Any] | None:
    """Figures of a trial finished earlier from the same, or None."""
    path = run.root / f"{policy.name}.json"
    if not path.exists():
        return None
    figures = read_json(path, "mulan evaluate view-selection")
    return figures if figures.get("made_from") == made_from else None


def made_from(source: str, policy: Policy, first: FirstFields) -> str:
    """A digest of everything a trial's figures depend on.

    Args:
        source: Of the photographs and what was done to them.
        policy: The rule.
        first: Seed, first views and options.
    """
    score = policy.score(first.pool, first.seed)
    members = first.config.members if policy.name in first.config.variance_of else 1
    config = first.config
    options = (config.views, config.round_views, config.fields, config.members)
    text = f"{source} {score} {policy.blind} {first.seed} {first.chosen} {members} {options}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def run_trial(
    policy: Policy, first: FirstFields, digest: str, run: RunFolder, progress: Progress
) -> dict[str, Any]:
    """Choose views up to each number, learn from scratch there and judge.

    Returns:
        What it writes to ``<policy>.json`` in the seed's folder: ``observations`` (by number of views, see
        :func:`mulan.evaluation.view_selection.judgement.judge`, with ``chosen``), ``plan_ms`` a candidate
        (None if none was planned for; learning excluded), ``learn_seconds`` of the planning fields,
        ``made_from``.
    """
    config, pool, seed = first.config, first.pool, first.seed
    score = policy.score(pool, seed)
    views = [view.taken_as_exact() for view in pool.views] if policy.blind else pool.views
    chosen, observations = list(first.chosen), {}
    plan_s = learn_s = 0.0
    scored = 0
    for count in config.views:
        while len(chosen) < count:
            progress(len(chosen), config.views[-1], f"{len(chosen)} views")
            began = time.perf_counter()
            fields = first.of(chosen, score.fields_needed) if score.fields_needed else []
            learnt = time.perf_counter()
            left = [i for i in range(len(views)) if i not in chosen]
            wanted = min(config.round_views, count - len(chosen))
            knowledge = Knowledge(fields, pool.space, [views[i] for i in chosen])
            picked = choose_views(score, knowledge, [views[i] for i in left], wanted)
            learn_s, plan_s = learn_s + learnt - began, plan_s + time.perf_counter() - learnt
            scored += sum(len(left) - i for i in range(len(picked)))
            chosen += [left[i] for i in picked]
        members = config.members if policy.name in config.variance_of else 1
        judged = judge(judged_fields(pool, chosen, members, seed, config.fields), pool.test)
        observations[str(count)] = {**judged, "chosen": sorted(chosen)}
        progress(count, config.views[-1], f"{judged['psnr_db']:.2f} dB at {count} views")
    figures = {
        "observations": observations,
        "plan_ms": 1000 * plan_s / scored if scored else None,
        "learn_seconds": learn_s,
        "made_from": digest,
    }
    write_json(run.root / f"{policy.name}.json", figures)
    return figures
