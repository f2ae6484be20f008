import sys
from pathlib import Path

# as `python benchmarks/peers/<peer>.py` does: the runners import their neighbours by bare name
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks" / "peers"))
