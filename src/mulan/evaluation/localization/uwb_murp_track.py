"""MURP's agents 2 and 3 tracked in agent 1's axes by 36 antenna pairs a pair of agents, without odometry."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mulan.errors import InputError
from mulan.evaluation.localization.site_tracking import (
    SITE,
    Antenna,
    placed,
    planar,
    site_keyframes,
    solved,
    tracking_graph,
    wandering_keyframes,
)
from mulan.evaluation.localization.track_score import TrackErrors, track_errors, track_figures
from mulan.evaluation.localization.uwb_planar_track import SiteTrackConfig
from mulan.geometry import se3, so3
from mulan.wireless.range_fit import fit_range_model
from mulan.wireless.range_model import RangeModel
from mulan.wireless.recordings.uwb_murp import ANTENNAS, murp_files, read_murp_pair, trial_of
from mulan.wireless.recordings.uwb_samples import RangeSamples, concatenate, finite_numbers, read_lines
from mulan.wireless.types import Range

_EVERY_S = 8.0  # one epoch in so many seconds: 108 links each
_FITTED_ROWS = 8  # of each file, for the antennas' places
_PLACE_SIGMA_M = 0.5
_UNCALIBRATED_SIGMA_M = 0.1
_POSE = ("x", "y", "z", "roll", "pitch", "yaw")
_TURN_RAD_PER_SQRT_S = 2.0  # the agents spin on the spot


@dataclass(frozen=True)
class MurpPair:
    """Ranges of two agents and their true poses at each row."""

    trial: str
    first: int
    second: int
    samples: RangeSamples
    time_s: Float[NDArray, "n"]
    T_world_first: Float[NDArray, "n 4 4"]
    T_world_second: Float[NDArray, "n 4 4"]

    @property
    def T_first_second(self) -> Float[NDArray, "n 4 4"]:
        """The second agent in the first's axes."""
        return se3.inverse(self.T_world_first) @ self.T_world_second


def read_pair(path: Path) -> MurpPair:
    """One file; the truth is from the two agents' own motion capture, ``A_*`` and ``B_*`` [m, degrees].

    The relative columns ``x, y, z, roll, pitch, yaw`` are of no use where agents spin: they are one-second
    means of coordinates in a turning frame and lie up to half a metre off. With the two agents' own poses a
    hexagon of antennas explains every true distance within 7 mm.

    Raises:
        InputError: As ``read_murp_pair``.
    """
    samples = read_murp_pair(path)
    trial, first, second = trial_of(path)
    lines = read_lines(path)
    column = {name: i for i, name in enumerate(lines[0].split(","))}
    for name in (f"{agent}_{what}" for agent in "AB" for what in _POSE):
        if name not in column:
            raise InputError(path, f"column {name}", "is missing", "give the data set's parsed csv files")
    table = np.array(
        [finite_numbers(path, number, line.split(",")) for number, line in enumerate(lines[1:], start=2)]
    )
    T = [_poses(table[:, [column[f"{agent}_{what}"] for what in _POSE]]) for agent in "AB"]
    return MurpPair(trial, first, second, samples, table[:, column["t"]], T[0], T[1])


def _poses(columns: Float[NDArray, "n 6"]) -> Float[NDArray, "n 4 4"]:
    roll, pitch, yaw = np.radians(columns[:, 3:]).T
    zero = np.zeros(len(roll))
    about_y, about_x = so3.exp(np.stack([zero, pitch, zero], 1)), so3.exp(np.stack([roll, zero, zero], 1))
    return se3.from_parts(so3.about_z(yaw) @ about_y @ about_x, columns[:, :3])


def antenna_places(pairs: list[MurpPair]) -> tuple[dict[str, Float[NDArray, "3"]], float]:
    """Each antenna in its agent's axes, and the RMS misfit [m], from true distances of training trials.

    The parsed files do not hold the arrays' geometry, but their true distances were computed from it.
    """
    agents = sorted({a for pair in pairs for a in (pair.first, pair.second)})
    T, which, true = [], [], []
    for pair in pairs:
        distance = pair.samples.true_range_m.reshape(len(pair.time_s), ANTENNAS, ANTENNAS)
        for k in np.unique(np.linspace(0, len(distance) - 1, _FITTED_ROWS).astype(int)):
            T.append([pair.T_world_first[k], pair.T_world_second[k]])
            which.append([agents.index(pair.first), agents.index(pair.second)])
            true.append(distance[k])
    T_ends, ends, true_m = np.array(T), np.array(which), np.array(true)

    def misfit(x: Float[NDArray, "p"]) -> Float[NDArray, "n"]:
        at = x.reshape(len(agents), ANTENNAS, 3)[ends]
        at = at @ np.swapaxes(T_ends[..., :3, :3], -1, -2) + T_ends[..., None, :3, 3]
        apart = np.linalg.norm(at[:, 0, :, None] - at[:, 1, None], axis=-1)
        return np.concatenate([(apart - true_m).ravel(), 1e-3 * x / _PLACE_SIGMA_M])

    angle = 2 * np.pi * np.arange(ANTENNAS) / ANTENNAS
    ring = 0.3 * np.stack([np.cos(angle), np.sin(angle), np.zeros(ANTENNAS)], 1)
    fit = least_squares(misfit, np.tile(ring, (len(agents), 1)).ravel(), max_nfev=40)
    places = fit.x.reshape(len(agents), ANTENNAS, 3)
    named = {f"{agent}.{i + 1}": places[a, i] for a, agent in enumerate(agents) for i in range(ANTENNAS)}
    return named, float(np.sqrt(np.mean(misfit(fit.x)[: true_m.size] ** 2)))


def _ranges(pair: MurpPair, model: RangeModel | None) -> list[Range]:
    """Every ``_EVERY_S`` seconds all links of one instant, freed of their bias where a model is given."""
    samples, kept = pair.samples, []
    begin = float(samples.time_s.min())
    for row in np.flatnonzero(np.isclose((samples.time_s - begin) % _EVERY_S, 0.0, atol=0.3)):
        link = samples.links[samples.link[row]]
        t, measured = float(np.round(samples.time_s[row])), samples.range_m[row : row + 1]
        if model is None:
            kept.append(Range(link[0], link[1], t, float(measured[0]), _UNCALIBRATED_SIGMA_M))
            continue
        law = model.law(*link)
        distance = max(float(model.distance_m(law, measured)[0]), 0.01)
        kept.append(Range(link[0], link[1], t, distance, law.sigma_m, law.outlier_mass, model.correlation_s))
    return kept


def track_trial(
    pairs: list[MurpPair],
    places: dict[str, Float[NDArray, "3"]],
    height_m: float,
    model: RangeModel | None,
    config: SiteTrackConfig,
) -> list[TrackErrors]:
    """Agents that measured to agent 1, in its axes; their height below it is a given of the robots."""
    up = np.array([0.0, 0.0, 1.0])
    antennas = {
        name: Antenna(SITE if name.startswith("1.") else name.split(".")[0], at - height_m * up)
        if name.startswith("1.")
        else Antenna(name.split(".")[0], at)
        for name, at in places.items()
    }
    ranges = [r for pair in pairs for r in _ranges(pair, model)]
    bodies, guesses, truth = {SITE: site_keyframes()}, {}, {}
    for pair in pairs:
        if pair.first != 1:
            continue
        name = str(pair.second)
        own = [r for r in ranges if antennas[r.observer].body == SITE and antennas[r.peer].body == name]
        times = np.unique([r.time_s for r in own])
        bodies[name] = wandering_keyframes(name, times, config.walk_m_per_sqrt_s, _TURN_RAD_PER_SQRT_S)
        near: Float[NDArray, "3"] | None = None
        poses = []
        for t in times:
            part = [r for r in own if r.time_s == t]
            near = placed(antennas, part, {float(t): np.eye(4)}, near)
            poses.append(planar(*near))
        guesses[name] = np.array(poses)
        truth[name] = (pair, times)
    known = [r for r in ranges if all(antennas[end].body in bodies for end in (r.observer, r.peer))]
    tracked = solved(tracking_graph(bodies, antennas, known, config.localization), guesses)
    errors = []
    for name, (pair, times) in truth.items():
        true = se3.interpolate(pair.time_s, pair.T_first_second, times)
        yaw = np.arctan2(true[:, 1, 0], true[:, 0, 0])
        errors.append(track_errors(f"{pair.trial}, agent {name}", tracked[name], true[:, :2, 3], yaw))
    return errors


def murp_tracks(
    data: Path, config: SiteTrackConfig
) -> tuple[dict[str, list[TrackErrors]], dict[str, list[TrackErrors]], float]:
    """Each trial with laws, antenna places and height from all other trials; and with uncalibrated ranges.

    Errors of the 36 links of two agents are not independent (an array shadows itself). How much that costs is
    told by the other trials' tracks: their mean NEES widens the trial's covariance.

    Returns:
        Tracks by trial, the same without calibration, and the largest misfit of the antennas' places [m].

    Raises:
        InputError: A file is missing or damaged.
    """
    files = murp_files(data / "uwb_murp")
    every = {trial: [read_pair(path) for path in paths] for trial, paths in files.items()}
    claimed: dict[str, list[TrackErrors]] = {}
    plain: dict[str, list[TrackErrors]] = {}
    misfits = []
    for trial, pairs in every.items():
        others = [pair for name, found in every.items() if name != trial for pair in found]
        model = fit_range_model(concatenate("others", [pair.samples for pair in others]), config.fit)
        places, misfit = antenna_places(others)
        misfits.append(misfit)
        below = [float(np.median(pair.T_first_second[:, 2, 3])) for pair in others if pair.first == 1]
        height_m = float(np.median(below))
        claimed[trial] = track_trial(pairs, places, height_m, model, config)
        plain[trial] = track_trial(pairs, places, height_m, None, config)
    nees = {trial: track_figures(tracks)["nees_per_dof"] for trial, tracks in claimed.items()}
    widened = {}
    for trial, tracks in claimed.items():
        widening = float(np.mean([value for name, value in nees.items() if name != trial]))
        widened[trial] = [replace(track, covariance=widening * track.covariance) for track in tracks]
    return widened, plain, max(misfits)
