"""Real processes under torchrun, as a user starts them."""

import os
import subprocess
import sys


def torchrun(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Two processes of a script, or of a module named after -m."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    return subprocess.run(
        [*command, *arguments],
        env={**os.environ, "OMP_WAIT_POLICY": "passive"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
