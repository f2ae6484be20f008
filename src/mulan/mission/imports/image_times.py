"""When photographs were taken: from a list beside them, or from their names."""

import itertools
from pathlib import Path

from mulan.errors import InputError

_LISTS = ("rgb.txt", "images.txt", "data.csv", "times.txt")  # TUM RGB-D, others; EuRoC
_SUFFIXES = (".png", ".jpg", ".jpeg")
_NANOSECOND_DIGITS, _MICROSECOND_DIGITS = 18, 16  # of whole numbers since 1970 (and not long after power-on)


def image_times(folder: Path, listed: Path | None = None) -> list[tuple[float, Path]]:
    """Times [s] and files of a folder's photographs, in order of time.

    A list has one ``time file`` a line, separated by a blank or a comma; a file is sought beside the list and
    in the folder. Whole numbers of 18 digits or more are nanoseconds, of 16 or 17 microseconds, anything else
    seconds.

    Args:
        folder: Photographs.
        listed: The list; ``rgb.txt``, ``data.csv`` or such in the folder or the one above if not given, else
            the names themselves are times.

    Raises:
        InputError: There are no photographs, a line or a name is no time, or a listed file is missing.
    """
    if not folder.is_dir():
        raise InputError(folder, "folder", "does not exist", "name the photographs' folder with --images")
    if listed is None:
        candidates = [place / name for place in (folder, folder.parent) for name in _LISTS]
        listed = next((path for path in candidates if path.is_file()), None)
    found = _from_names(folder) if listed is None else _from_list(listed, folder)
    if not found:
        raise InputError(listed or folder, "photographs", "there are none", "name another folder or list")
    found.sort()
    for (before, _), (after, path) in itertools.pairwise(found):
        if after == before:
            raise InputError(path, "time", f"is {after:.6f} s, as another's", "give each photograph its own")
    return found


def _from_names(folder: Path) -> list[tuple[float, Path]]:
    found = []
    for path in folder.iterdir():
        if path.suffix.lower() in _SUFFIXES:
            time_s = _seconds(path.stem)
            if time_s is None:
                raise InputError(
                    path,
                    "name",
                    "is no time, and no list gives one",
                    "name a list of times and files with --times",
                )
            found.append((time_s, path))
    return found


def _from_list(listed: Path, folder: Path) -> list[tuple[float, Path]]:
    try:
        lines = listed.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            listed, "file", f"cannot be read as text ({error})", "name a list of times"
        ) from error
    found = []
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        time_s = _seconds(words[0])
        if time_s is None or len(words) < 2:
            raise InputError(listed, f"line {number}", "is not 'time file'", "write one photograph a line")
        name = words[1]
        places = [folder / name, folder / Path(name).name, listed.parent / name]
        path = next((place for place in places if place.is_file()), None)
        if path is None:
            raise InputError(
                listed, f"line {number}", f"names {name}, which is not there", "copy it beside the list"
            )
        found.append((time_s, path))
    return found


def _seconds(word: str) -> float | None:
    """A time in seconds, None if the word is none."""
    if word.isascii() and word.isdigit() and len(word) >= _MICROSECOND_DIGITS:
        if len(word) > 20:
            return None
        unit = 1_000_000_000 if len(word) >= _NANOSECOND_DIGITS else 1_000_000
        whole, rest = divmod(int(word), unit)
        return whole + rest / unit
    try:
        value = float(word)
    except ValueError:
        return None
    return value if abs(value) < 1e12 else None  # also refuses NaN
