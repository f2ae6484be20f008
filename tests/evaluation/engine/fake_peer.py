"""Runner scripts of peers that never existed, and the scene they are given."""

from pathlib import Path

CONTRACT = """
import argparse, json
options = argparse.ArgumentParser()
for name in ("data", "image-size", "budget-s", "eval-every-nth-view", "first-eval-s", "out"):
    options.add_argument("--" + name, required=True)
options.add_argument("--bonus-db", type=float, default=0.0)
given = options.parse_args()
curve = [[float(given.first_eval_s), 3.0 + given.bonus_db], [float(given.budget_s), 4.0 + given.bonus_db]]
notes = {"eval_every_nth_view": int(given.eval_every_nth_view), "seen": vars(given)}
result = {"name": "Fake", "version": "1", "psnr_curve": curve, "rays_per_s": 10.0, "samples_per_s": None}
open(given.out, "w").write(json.dumps(result | {"seconds_to_28_db": 1e-9, "notes": notes}))
"""


def write_runner(folder: Path, name: str, text: str = CONTRACT) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.py").write_text(text)
