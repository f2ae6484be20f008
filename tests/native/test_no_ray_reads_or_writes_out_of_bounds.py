import shutil

import pytest

from mulan.radiance.kernels.native_library import NativeLibrary
from tests.native.conftest import BUILDS
from tests.native.sanitizers import FUZZ, MEMORY, RACE, THREADS, Sanitizer, build


@pytest.mark.parametrize(("sanitizer", "cases"), [(MEMORY, 60), (THREADS, 25)], ids=["memory", "threads"])
def test_odd_rays_are_harmless_under_a_sanitizer(
    library: NativeLibrary, sanitizer: Sanitizer, cases: int
) -> None:
    """The widest build this processor runs: its vectors reach furthest past an array's end."""
    if not shutil.which("cmake") or not sanitizer.runtime_path():
        pytest.skip(f"no cmake, or the compiler has no {sanitizer.runtime}")
    widest = next(name for name in BUILDS if library.use_instruction_set(name))
    path = build(sanitizer, f"-DMULAN_ONLY={widest}")
    done = sanitizer.run(str(FUZZ), str(path), str(cases))
    assert done.returncode == 0, done.stderr[-4000:]
    assert "clean" in done.stdout


def test_the_thread_sanitizer_sees_a_planted_race(library: NativeLibrary) -> None:
    if not shutil.which("cmake") or not THREADS.runtime_path():
        pytest.skip(f"no cmake, or the compiler has no {THREADS.runtime}")
    widest = next(name for name in BUILDS if library.use_instruction_set(name))
    done = THREADS.run(str(RACE), str(build(THREADS, f"-DMULAN_ONLY={widest}")))
    assert done.returncode != 0
    assert "data race" in done.stderr
    assert "adam" in done.stderr
