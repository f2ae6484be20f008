"""What a UWB range says of a distance: bias, scatter, late arrivals and nonsense, each link its own."""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from mulan.errors import InputError
from mulan.mission.run_folder import read_json, write_json

_FORMAT = "mulan-range-model-1"
_GRID = 4000


@dataclass(frozen=True)
class LinkError:
    """Law of one link's error e = measured − true, metres.

    With probability 1 − late − gross: N(bias, σ²). With probability ``late``: the same plus an exponential
    detour of mean ``detour_m`` (exponentially modified Gaussian). With probability ``gross``: uniform.
    """

    bias_m: float
    """Mean of the core at the model's reference distance."""
    sigma_m: float
    """Standard deviation of the core."""
    late_mass: float
    """Probability of a detour."""
    detour_m: float
    """Mean length of a detour."""
    gross_mass: float
    """Probability that the range tells nothing."""

    @property
    def outlier_mass(self) -> float:
        """Prior probability of nonsense or of a detour beyond three core sigmas."""
        return self.gross_mass + self.late_mass * float(np.exp(-3 * self.sigma_m / self.detour_m))


@dataclass(frozen=True)
class RangeModel:
    """Calibrated error law of every link; a link never seen gets its devices' biases and the pooled rest.

    Methods take a link number a measurement (``link_number``; some also one law for all) and are vectorised.
    The law of the unseen link has its devices' biases only through ``law``.

    Attributes:
        links: (device, device) of each law; order within a pair does not matter.
        laws: As many; the last one more is that of an unseen link.
        device_bias_m: Antenna delay of each device, as a deviation: an unseen pair's bias is
            ``laws[-1].bias_m`` plus both.
        slope_per_m: Common growth of the bias with distance (Ledergerber, D'Andrea 2017).
        reference_m: Distance at which ``bias_m`` holds.
        span_m: A gross error lies within ± this.
        correlation_s: Measurements of a link closer than this share their error.
    """

    links: tuple[tuple[str, str], ...]
    laws: tuple[LinkError, ...]
    device_bias_m: dict[str, float]
    slope_per_m: float
    reference_m: float
    span_m: float
    correlation_s: float

    def link_number(self, a: str, b: str) -> int:
        """Index of the pair's law, in either order; that of unseen links if it is none of ours."""
        for pair in ((a, b), (b, a)):
            if pair in self.links:
                return self.links.index(pair)
        return len(self.links)

    def law(self, a: str, b: str) -> LinkError:
        """The pair's law."""
        number = self.link_number(a, b)
        law = self.laws[number]
        if number < len(self.links):
            return law
        device = sum(self.device_bias_m.get(name, 0.0) for name in (a, b))
        return LinkError(**{**asdict(law), "bias_m": law.bias_m + device})

    def _terms(self, link: Int[NDArray, "n"] | LinkError) -> dict[str, NDArray]:
        if isinstance(link, LinkError):
            return {f.name: np.array(getattr(link, f.name)) for f in fields(LinkError)}
        return {f.name: np.array([getattr(x, f.name) for x in self.laws])[link] for f in fields(LinkError)}

    def log_components(
        self,
        link: Int[NDArray, "n"] | LinkError,
        error_m: Float[NDArray, "n"],
        distance_sigma_m: float | NDArray = 0.0,
    ) -> Float[NDArray, "3 n"]:
        """Log of mass times density of core, detour and gross error; e about the reference distance."""
        t = self._terms(link)
        sigma = np.sqrt(t["sigma_m"] ** 2 + np.square(distance_sigma_m))
        u, tau = error_m - t["bias_m"], t["detour_m"]
        core = -0.5 * (u / sigma) ** 2 - np.log(sigma) - 0.5 * np.log(2 * np.pi)
        late = -np.log(tau) + sigma**2 / (2 * tau**2) - u / tau + log_ndtr(u / sigma - sigma / tau)
        gross = np.where(np.abs(error_m) <= self.span_m, -np.log(2 * self.span_m), -np.inf)
        with np.errstate(divide="ignore"):
            masses = np.log(np.stack([1 - t["late_mass"] - t["gross_mass"], t["late_mass"], t["gross_mass"]]))
        return masses.reshape(3, -1) + np.stack([core, late, gross])

    def _at_reference(self, error_m: NDArray, distance_m: NDArray) -> NDArray:
        return error_m - self.slope_per_m * (distance_m - self.reference_m)

    def log_density(
        self, link: Int[NDArray, "n"], range_m: Float[NDArray, "n"], distance_m: Float[NDArray, "n"]
    ) -> Float[NDArray, "n"]:
        """Log p(range | distance), per metre."""
        error = self._at_reference(range_m - distance_m, distance_m)
        return np.logaddexp.reduce(self.log_components(link, error), axis=0)

    def cdf(
        self, link: Int[NDArray, "n"], range_m: Float[NDArray, "n"], distance_m: Float[NDArray, "n"]
    ) -> Float[NDArray, "n"]:
        """P(a range at this distance is shorter)."""
        error = self._at_reference(range_m - distance_m, distance_m)
        t = self._terms(link)
        u, late = ndtr((error - t["bias_m"]) / t["sigma_m"]), self.log_components(link, error)[1]
        gross = np.clip((error + self.span_m) / (2 * self.span_m), 0, 1)
        return (1 - t["gross_mass"]) * u - t["detour_m"] * np.exp(late) + t["gross_mass"] * gross

    def hdr_level(
        self, link: Int[NDArray, "n"], range_m: Float[NDArray, "n"], distance_m: Float[NDArray, "n"]
    ) -> Float[NDArray, "n"]:
        """Mass of the smallest highest-density region that holds the range: uniform if the model is true."""
        error = self._at_reference(range_m - distance_m, distance_m)
        level = np.ones(len(error))
        for number in np.unique(link):
            law, rows = self.laws[number], link == number
            reach = np.geomspace(1e-6, 1, _GRID) * (2 * self.span_m + 20 * (law.sigma_m + law.detour_m))
            edges = law.bias_m + np.r_[-reach[::-1], 0, reach]
            middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
            of_link = np.full(len(middle), number)
            density = np.logaddexp.reduce(self.log_components(of_link, middle), axis=0)
            order = np.argsort(-density)
            mass = np.r_[0, np.cumsum(np.exp(density[order]) * width[order])]
            own = np.logaddexp.reduce(self.log_components(link[rows], error[rows]), axis=0)
            level[rows] = mass[np.searchsorted(-density[order], -own)]
        return np.minimum(level, 1.0)

    def outlier_probability(
        self,
        link: Int[NDArray, "n"] | LinkError,
        range_m: Float[NDArray, "n"],
        predicted_m: Float[NDArray, "n"],
        predicted_sigma_m: float | Float[NDArray, "n"] = 0.0,
        longest_detour_m: float | None = None,
    ) -> Float[NDArray, "n"]:
        """Probability that a range tells nothing or took a detour too long to be scatter.

        Args:
            link: Law of each.
            range_m: Measured.
            predicted_m: Distance known otherwise (a tracker, other antennas).
            predicted_sigma_m: Its standard deviation.
            longest_detour_m: Shorter detours are part of the scatter; None = three sigmas.
        """
        error = self._at_reference(range_m - predicted_m, predicted_m)
        parts = self.log_components(link, error, predicted_sigma_m)
        total = np.logaddexp.reduce(parts, axis=0)
        known = np.isfinite(total)
        share = np.exp(parts - np.where(known, total, 0.0))
        t = self._terms(link)
        sigma = np.sqrt(t["sigma_m"] ** 2 + np.square(predicted_sigma_m))
        centre = error - t["bias_m"] - sigma**2 / t["detour_m"]
        bound = 3 * sigma if longest_detour_m is None else longest_detour_m
        long = np.exp(log_ndtr((centre - bound) / sigma) - log_ndtr(centre / sigma))
        return np.where(known, np.clip(share[1] * long + share[2], 0, 1), 1.0)

    def distance_m(
        self, link: Int[NDArray, "n"] | LinkError, range_m: Float[NDArray, "n"]
    ) -> Float[NDArray, "n"]:
        """The range freed of its bias."""
        bias = self._terms(link)["bias_m"]
        return (range_m - bias + self.slope_per_m * self.reference_m) / (1 + self.slope_per_m)

    def effective_count(self, count: int, duration_s: float) -> float:
        """How many independent measurements ``count`` evenly spread over ``duration_s`` are worth."""
        if self.correlation_s <= 0 or count <= 1:
            return float(count)
        return float(np.clip(duration_s / self.correlation_s, 1.0, count))

    def save(self, path: Path) -> None:
        """Write as JSON.

        Raises:
            InputError: The folder cannot be written.
        """
        write_json(path, {"format": _FORMAT, **asdict(self)})


def load_range_model(path: Path) -> RangeModel:
    """Read what ``RangeModel.save`` wrote.

    Raises:
        InputError: The file is missing, no JSON, of another format, or holds a value no law can have.
    """
    made_by = "mulan evaluate uwb"
    record = read_json(path, made_by)
    remedy = f"make it again with '{made_by}'"
    if not isinstance(record, dict) or record.pop("format", None) != _FORMAT:
        raise InputError(path, "format", f"is not {_FORMAT}", remedy)
    try:
        links = tuple((str(a), str(b)) for a, b in record["links"])
        laws = tuple(LinkError(**{k: float(v) for k, v in law.items()}) for law in record["laws"])
        device = {str(name): float(bias) for name, bias in record["device_bias_m"].items()}
        rest = [float(record[k]) for k in ("slope_per_m", "reference_m", "span_m", "correlation_s")]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(path, "content", f"is no range model ({error!r})", remedy) from error
    numbers = [value for law in laws for value in asdict(law).values()] + rest + list(device.values())
    bad = len(laws) != len(links) + 1 or not np.isfinite(numbers).all() or rest[2] <= 0 or rest[3] < 0
    bad = bad or rest[0] <= -1 or any(law.sigma_m <= 0 or law.detour_m <= 0 for law in laws)
    if bad or any(min(x.late_mass, x.gross_mass, 1 - x.late_mass - x.gross_mass) < 0 for x in laws):
        raise InputError(path, "laws", "hold values no error law can have", remedy)
    return RangeModel(links, laws, device, *rest)
