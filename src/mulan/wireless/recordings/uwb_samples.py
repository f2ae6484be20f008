"""Ranges of one recording beside the true distances, and the strict reading the UWB readers share."""

import gzip
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError

LONGEST_RANGE_M = 1000.0


@dataclass(frozen=True)
class RangeSamples:
    """Measured ranges with truth, one row a measurement.

    Attributes:
        name: Of the recording.
        links: The (device, device) of each link, antennas told apart.
        link: Row's index into ``links``.
        time_s: On the recording's clock.
        range_m: Measured.
        true_range_m: From motion capture or a survey.
        reported_sigma_m: What the radio said of itself; None where it says nothing.
    """

    name: str
    links: tuple[tuple[str, str], ...]
    link: Int[NDArray, "n"]
    time_s: Float[NDArray, "n"]
    range_m: Float[NDArray, "n"]
    true_range_m: Float[NDArray, "n"]
    reported_sigma_m: Float[NDArray, "n"] | None = None

    @property
    def error_m(self) -> Float[NDArray, "n"]:
        """Measured minus true."""
        return self.range_m - self.true_range_m

    def where(self, keep: Bool[NDArray, "n"]) -> "RangeSamples":
        """The rows asked for."""
        sigma = self.reported_sigma_m
        return replace(
            self,
            link=self.link[keep],
            time_s=self.time_s[keep],
            range_m=self.range_m[keep],
            true_range_m=self.true_range_m[keep],
            reported_sigma_m=None if sigma is None else sigma[keep],
        )


def concatenate(name: str, parts: Sequence[RangeSamples]) -> RangeSamples:
    """Recordings as one; each keeps its own clock, set a day after the one before."""
    links = tuple(dict.fromkeys(link for part in parts for link in part.links))
    index = {link: i for i, link in enumerate(links)}
    sigmas = [part.reported_sigma_m for part in parts]
    return RangeSamples(
        name,
        links,
        np.concatenate([np.array([index[a] for a in part.links])[part.link] for part in parts]),
        np.concatenate([part.time_s - part.time_s.min() + 86400.0 * i for i, part in enumerate(parts)]),
        np.concatenate([part.range_m for part in parts]),
        np.concatenate([part.true_range_m for part in parts]),
        np.concatenate([s for s in sigmas if s is not None]) if all(s is not None for s in sigmas) else None,
    )


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, unpacked where its name ends in ``.gz``.

    Raises:
        InputError: It is missing, no valid gzip, or not text.
    """
    try:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        return [line for line in data.decode().splitlines() if line.strip()]
    except FileNotFoundError:
        raise InputError(path, "file", "does not exist", "check the path to the recording") from None
    except (OSError, EOFError, UnicodeDecodeError, ValueError) as error:
        raise InputError(path, "file", f"cannot be read as text ({error})", "fetch it again") from error
    except Exception as error:  # zlib.error derives from Exception alone
        raise InputError(path, "file", f"is damaged ({error})", "fetch it again") from error


def finite_numbers(path: Path, line_number: int, words: Sequence[str]) -> list[float]:
    """The words of one line as numbers.

    Raises:
        InputError: One of them is no finite number.
    """
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(
            path, f"line {line_number}", f"holds something that is no number ({error})", _REMEDY
        ) from None
    if not np.isfinite(numbers).all():
        raise InputError(path, f"line {line_number}", "holds a number that is not finite", _REMEDY)
    return numbers


def check_ranges(path: Path, range_m: Float[NDArray, "..."]) -> None:
    """Refuse what no range can be.

    Raises:
        InputError: A range is not within 0 and 1000 m.
    """
    if range_m.size == 0:
        raise InputError(path, "ranges", "there are none", "give a recording that holds ranges")
    if range_m.min() < 0 or range_m.max() > LONGEST_RANGE_M:
        worst = range_m.min() if range_m.min() < 0 else range_m.max()
        raise InputError(
            path, "ranges", f"{worst:g} m is no range", "check the column order and the unit (metres)"
        )


_REMEDY = "fetch the recording again or remove the line"
