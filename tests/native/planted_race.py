"""Two threads write the same parameters through the C interface: what a thread sanitizer must report.

python tests/native/planted_race.py LIBRARY
"""

import sys
from pathlib import Path
from threading import Thread

import numpy as np

from mulan.radiance.kernels.native_library import NativeLibrary
from tests.native.odd_inputs import at

COUNT = 400_000


def main() -> None:
    """One step of Adam on the same arrays from either thread."""
    library = NativeLibrary(Path(sys.argv[1]))
    arrays = [np.ones(COUNT, np.float32) for _ in range(4)]

    def step() -> None:
        for _ in range(20):
            library.functions.mulan_adam(COUNT, *(at(x) for x in arrays), 1e-2, 0.9, 0.99, 1e-15, 1, 0)

    threads = [Thread(target=step) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    main()
