"""Builds the engine with sanitizers and runs things under them. By itself, as 'make sanitize': everything.

Each sanitizer's run-time must be in the process before python's own memory is allocated, hence a process of
its own with LD_PRELOAD.
"""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
FUZZ = Path(__file__).with_name("fuzz_under_sanitizers.py")
RACE = Path(__file__).with_name("planted_race.py")


def library_of_compiler(name: str) -> str | None:
    """Where the compiler would find a library, None if nowhere."""
    try:
        command = ["c++", f"-print-file-name={name}"]
        found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return found if Path(found).is_absolute() else None


@dataclass(frozen=True)
class Sanitizer:
    """One way to instrument the library.

    Attributes:
        flags: As ``-fsanitize`` takes them.
        runtime: Library that must be loaded first.
        options: Its environment variables.
    """

    flags: str
    runtime: str
    options: dict[str, str]

    def runtime_path(self) -> str | None:
        """The run-time library, None if the compiler has none."""
        return library_of_compiler(self.runtime)

    def run(self, *arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
        """Python with the run-time loaded, started in the repository."""
        # torch throws exceptions of C++, which the run-time does not find in python, a program in C
        libraries = (self.runtime_path(), library_of_compiler("libstdc++.so.6"))
        preload = {"LD_PRELOAD": " ".join(filter(None, libraries)), "PYTHONPATH": str(REPOSITORY)}
        return subprocess.run(
            [sys.executable, *arguments],
            env=os.environ | preload | self.options | environment,
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            check=False,
        )


MEMORY = Sanitizer(
    "address,undefined",
    "libasan.so",
    # leaks: python's own at exit
    {"ASAN_OPTIONS": "detect_leaks=0", "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1"},
)
THREADS = Sanitizer(
    "thread",
    "libtsan.so",
    # torch and its OpenMP are not instrumented: their barriers are unseen, all they share looks like a race
    {"TSAN_OPTIONS": "halt_on_error=1:ignore_noninstrumented_modules=1"},
)


def build(sanitizer: Sanitizer, *options: str) -> Path:
    """The instrumented library, in the repository's build folder so that a second time is quick.

    Raises:
        subprocess.CalledProcessError: It cannot be built.
    """
    folder = REPOSITORY / "build" / f"native-{sanitizer.flags.replace(',', '-')}{''.join(options)}"
    source = REPOSITORY / "src" / "mulan" / "radiance" / "native"
    for command in (
        ["cmake", "-S", str(source), "-B", str(folder), f"-DMULAN_SANITIZE={sanitizer.flags}", *options],
        ["cmake", "--build", str(folder), "--parallel", "2"],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    return next(folder.glob("libmulan_native.*"))


def main() -> int:
    """Every build of the kernels: long fuzzing, then the engine's other tests, under either sanitizer."""
    for sanitizer in (MEMORY, THREADS):
        if not sanitizer.runtime_path():
            print(
                f"{sanitizer.flags}: the compiler has no {sanitizer.runtime}; on Debian: apt-get install g++"
            )
            return 1
        library = str(build(sanitizer))
        # nothing captured, or a sanitizer's report would be lost with the process it ends
        tests = ["-m", "pytest", "-x", "-s", "tests/native", "-k", "not sanitizer and not arm64"]
        for title, arguments in (("fuzzing", [str(FUZZ), library, "400"]), ("tests", tests)):
            done = sanitizer.run(*arguments, MULAN_TEST_LIBRARY=library, OMP_WAIT_POLICY="passive")
            print(f"{sanitizer.flags}, {title}: {'clean' if done.returncode == 0 else 'FAILED'}", flush=True)
            if done.returncode:
                print(done.stdout[-4000:], done.stderr[-4000:])
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
