"""The engine's whole benchmark: quality against time, throughput, memory, torch, peers; JSON and a picture.

python benchmarks/engine.py --out runs/engine --peer-python PEERS/bin/python

It is ``mulan evaluate engine`` with the peers' runner scripts that lie beside this file.
"""

import sys
from pathlib import Path

from mulan.cli.main import main

if __name__ == "__main__":
    runners = Path(__file__).resolve().parent / "peers"
    sys.argv[1:] = ["evaluate", "engine", "--peer-runners", str(runners), *sys.argv[1:]]
    main()
