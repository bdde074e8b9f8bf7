"""A plant from several healthy logs: kind and order of the model are those that predict left-out logs best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.learning.identification.healthy_runs import Runs, groups_of, runs_of
from fusion_sfdia.learning.identification.linear_gaussian import fitted, plant_of, smoothed
from fusion_sfdia.learning.identification.state_space import autoregression, factors, plant_of_model, terms
from fusion_sfdia.learning.innovations import LeftOut, left_out
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

MARGIN = 0.005  # of the log-likelihood of a reading, by which a later candidate must be better than an earlier one
RIDGE = 5.0  # samples' worth of a prior of zero, as of `identify`
ITERATIONS = 20  # of expectation maximisation
LONGEST = 2000  # samples for expectation maximisation, whose time grows with them; of more, the first part of each log


class Candidate(NamedTuple):
    """A kind of linear model that may be identified.

    Attributes
    ----------
    kind : str
        "autoregression", "factors" or "subspace" (by expectation maximisation).
    order : int
        Of an autoregression the samples of the past; of factors their number; of a subspace model the states.
    quadratic : bool
        Whether squares of the inputs are inputs, too, so that gains depend on the operation.

    Examples
    --------
    >>> from fusion_sfdia.learning import Candidate
    >>> Candidate("autoregression", 2)
    Candidate(kind='autoregression', order=2, quadratic=False)
    """

    kind: str
    order: int
    quadratic: bool = False

    def __str__(self) -> str:
        unit = {"autoregression": "lags", "factors": "factors", "subspace": "states"}[self.kind]
        return f"{self.kind}, {self.order} {unit}" + (", squares of inputs" if self.quadratic else "")


class Score(NamedTuple):
    """nis: normalised innovation squared of a left-out reading, 1 where the covariances are right. log_likelihood: mean of a
    left-out reading in units of its standard deviation, with the covariances times nis. failed: why there is none, else empty.
    """

    candidate: Candidate
    log_likelihood: float
    nis: float
    failed: str = ""


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """The plant identified from healthy logs, and why this one.

    Attributes
    ----------
    plant : Plant
        The identified one.
    chosen : Candidate
        The first one whose log-likelihood of what was left out is within MARGIN of the largest.
    scores : tuple of Score
        Of all, the largest first.
    by : str
        What was left out in turn, "logs" or "stretches".
    groups : int
        How many of them.
    samples : int
        Number of samples of the logs.
    still : tuple of str
        Sensors that never moved, which are not in the plant.

    Examples
    --------
    See `ModelChoice.of`.
    """

    plant: Plant
    chosen: Candidate
    scores: tuple[Score, ...]
    by: str
    groups: int
    samples: int
    still: tuple[str, ...]

    @property
    def nis(self) -> float:
        """The normalised innovation squared by which the covariances of the plant were scaled."""
        return next(s.nis for s in self.scores if s.candidate == self.chosen)

    def __str__(self) -> str:
        lines = [
            f"{self.plant.name}: {self.chosen}; chosen of {len(self.scores)} by the likelihood of {self.groups} groups of "
            f"{self.by} left out in turn, {self.samples} samples",
            f"{'model':<44}log-likelihood  squared error over stated",
        ]
        lines += [
            f"{s.candidate!s:<44}" + (s.failed if s.failed else f"{s.log_likelihood:>14.3f}  {s.nis:.3g}") for s in self.scores
        ]
        if self.still:
            lines.append(f"never moved, and not in the model: {', '.join(self.still)}")
        return "\n".join(lines)

    @classmethod
    def of(
        cls,
        name: str,
        sensors: Sequence[Signal],
        healthy: Sequence[Log],
        *,
        inputs: Sequence[Signal] = (),
        candidates: Sequence[Candidate] | None = None,
        folds: int = 4,
    ) -> ModelChoice:
        """Identify a linear plant from several healthy logs.

        A log may have gaps; a step that is uneven, or an input that is not known, begins a new run. Of three logs and more
        whole logs are left out, in `folds` groups, else stretches of them. Each candidate is identified from the rest and
        predicts what was left out one step ahead. The first whose likelihood is within MARGIN of the largest is identified from
        everything; Q and R are scaled so that the normalised innovation squared of what was left out is 1.

        Parameters
        ----------
        name : str
            Of the plant.
        sensors : sequence of Signal (N,)
            Name and unit of each column of y.
        healthy : sequence of Log
            t (K,), y (K, N) with NaN where missing, u (K, m).
        inputs : sequence of Signal (m,), default ()
            Name and unit of each column of u.
        candidates : sequence of Candidate, optional
            None for those of `candidates_for`.
        folds : int, default 4
            Groups that are left out in turn.

        Returns
        -------
        ModelChoice
            The plant, and why this one.

        Raises
        ------
        ValueError
            For logs that do not fit the names or are too short for every candidate.

        Examples
        --------
        >>> from fusion_sfdia import Log, Signal, simulate
        >>> from fusion_sfdia.learning import Candidate, ModelChoice
        >>> from fusion_sfdia.plants import two_tanks
        >>> plant = two_tanks(swing=0.2)
        >>> logs = [Log(r.t, r.y[:, 0], r.u) for r in (simulate(plant, 200, seeds=[seed]) for seed in (4, 5))]
        >>> choice: ModelChoice = ModelChoice.of(
        ...     "by data", plant.sensors, logs, inputs=[Signal("inflow", "m3/s")], candidates=[Candidate("autoregression", 1)]
        ... )
        >>> choice.chosen.kind, choice.by, choice.plant.sensor_names
        ('autoregression', 'stretches', ('l1', 'l2', 'q12', 'q2'))
        """
        whole("folds", folds, least=2)
        all_runs = runs_of(sensors, inputs, healthy)
        if not all_runs.moves.any():
            raise ValueError("no sensor ever moves in the healthy logs; nothing can be identified")
        still = tuple(s.name for s, moves in zip(sensors, all_runs.moves, strict=True) if not moves)
        moving = [s for s, moves in zip(sensors, all_runs.moves, strict=True) if moves]
        runs = all_runs if not still else runs_of(moving, inputs, [Log(t, y[:, all_runs.moves], u) for t, y, u in healthy])
        by, groups = groups_of(runs, folds)
        tried = candidates_for(len(moving), len(inputs)) if candidates is None else tuple(candidates)
        found = [_score(c, name, runs, groups, moving, inputs) for c in tried]
        scores = sorted(found, key=lambda s: -s.log_likelihood)
        if not scores or not np.isfinite(scores[0].log_likelihood):
            raise ValueError(
                f"no model can be identified from {runs.samples} samples of {len(moving)} sensors: "
                + "; ".join(dict.fromkeys(s.failed for s in scores))
            )
        best = next(s for s in found if s.log_likelihood >= scores[0].log_likelihood - MARGIN)
        plant = times(model_of(best.candidate, name, runs, runs.logs, moving, inputs), best.nis)
        return cls(plant, best.candidate, tuple(scores), by, len(groups), runs.samples, still)


def candidates_for(sensors: int, inputs: int) -> tuple[Candidate, ...]:
    """The models that are tried by default for so many moving sensors and inputs."""
    kinds = [("autoregression", (1, 2, 4)), ("factors", (1, 2, 4, 8)), ("subspace", (2, 4, 8, 16))]
    most = {"autoregression": np.inf, "factors": sensors, "subspace": 2 * sensors + 1}
    found = [Candidate(kind, n) for kind, orders in kinds for n in orders if n < most[kind]]
    if inputs:
        found += [c._replace(quadratic=True) for c in found if c.kind != "subspace"]
    return tuple(found)


def times(plant: Plant, factor: float) -> Plant:
    """The plant with the covariances of its process and its sensors times a factor."""
    sensors = tuple(replace(s, sigma=float(np.sqrt(factor) * s.noise_sigma)) for s in plant.sensors)
    return replace(plant, process_cov=factor * plant.process_cov, sensors=sensors)


def model_of(
    candidate: Candidate, name: str, runs: Runs, logs: Sequence[Log], sensors: Sequence[Signal], inputs: Sequence[Signal]
) -> Plant:
    """The plant of one candidate, identified from `logs`, scaled as `runs`."""
    kind, order, quadratic = candidate
    if kind == "subspace":
        recording = runs.joined(_at_most(logs, LONGEST))
        if len(recording.y) < 10 * order:
            raise ValueError(f"{len(recording.y)} samples for {order} states; expected at least 10 a state")
        model = fitted(recording.y, recording.u, order, RIDGE, ITERATIONS)
        states = smoothed(model, recording.y, recording.u)
        start = states.x[1:].T @ states.x[1:] / len(recording.y) + states.P[1:].mean(axis=0)
        return plant_of(name, model._replace(P0=start), recording, sensors, inputs)
    fit = {"autoregression": autoregression, "factors": factors}[kind]
    parts = [(y, terms(log.u, runs.u_mean, runs.u_sd, quadratic)) for (y, _), log in zip(runs.scaled(logs), logs, strict=True)]
    return plant_of_model(name, fit(parts, order, RIDGE, sensors), runs, sensors, inputs, quadratic)


def _score(
    candidate: Candidate,
    name: str,
    runs: Runs,
    groups: Sequence[Sequence[Log]],
    sensors: Sequence[Signal],
    inputs: Sequence[Signal],
) -> Score:
    total = LeftOut(0.0, 0.0, 0)
    try:
        for k, group in enumerate(groups):
            rest = [log for j, other in enumerate(groups) if j != k for log in other]
            found = left_out(model_of(candidate, name, runs, rest, sensors, inputs), group, runs.y_sd)
            total = total.plus(found)
    except (ValueError, np.linalg.LinAlgError) as error:
        return Score(candidate, -np.inf, np.nan, str(error))
    if not total.readings or not np.isfinite(total.log_likelihood):
        return Score(candidate, -np.inf, np.nan, "its predictions diverge" if total.readings else "nothing is left to judge it")
    nis = total.chi_square / total.readings
    return Score(candidate, total.log_likelihood / total.readings + (nis - 1 - np.log(nis)) / 2, nis)


def _at_most(logs: Sequence[Log], samples: int) -> list[Log]:
    """The first part of each log, all of the same share, with so many samples together."""
    share = min(1.0, samples / sum(len(log.t) for log in logs))
    return [log.rows(slice(max(2, round(share * len(log.t))))) for log in logs]
