"""A first plant of a log: a Python file with a sensor for each column of numbers, whose equations are still to be written."""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, StrictUndefined
from numpy.typing import NDArray

from fusion_sfdia.logs.draft import Draft
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

LONGEST = 64  # rows over which the movement of a quantity is looked at
ALIKE = 0.95  # correlation of two tags that may read one quantity
INPUT_NAME = re.compile(
    r"set|\bsp\b|_sp$|valve|cmd|command|output|\bop\b|_op$|load|speed|power|duty|feed|inflow|ambient|pump", re.I
)

TEMPLATE = '''\
"""{{ title }}: drafted from {{ source }}. The sensors are those of the log; the equations are still to be written."""

from fusion_sfdia import Plant, Sensor, Signal


def step(t_start, x, u, dt):
    """The state dt seconds later, x (..., {{ quantities|length }}), under the inputs u (..., 0).

    TODO: the balances of the plant, as in level + dt * (inflow - outflow) / area. Until then each quantity is expected to stay
    as it is, but for the process noise: only jumps, spikes and frozen or missing readings can be seen, and no sensor is
    checked by another.
    """
    return x


def output(t, x, u):
    """The readings (..., {{ quantities|length }}).

    TODO: where several sensors read one quantity, or what they read follows from several.
    """
    return x


def make():
    """The plant, with readings every {{ dt }} s."""
    return Plant(
        {{ name }},
        # of each quantity: unit, usual value, and how much it moves in one step (process_sigma), a first guess from the log
        states=(
{%- for q in quantities %}
            Signal({{ q.name }}, {{ q.unit }}, {{ q.nominal }}, initial_sigma={{ q.spread }}, process_sigma={{ q.moves }}),
{%- endfor %}
        ),
        # sigma, the noise of a reading: a first guess, from the differences between neighbouring readings; `tune` learns it
        sensors=(
{%- for q in quantities %}
            Sensor({{ q.name }}, {{ q.name }}, {{ q.unit }}, sigma={{ q.sigma }}),
{%- endfor %}
        ),
        step=step,
        output=output,
        dt={{ dt }},
{%- if inputs %}
        # inputs, by their names or since they seldom change: use them in step as u, state them as `input` in map.toml, and take
        # them out of states and sensors where they are there
        # inputs=(
{%- for q in inputs %}
        #     Signal({{ q.name }}, {{ q.unit }}, {{ q.nominal }}),
{%- endfor %}
        # ),
{%- endif %}
    )
{%- if alike %}


# These move together. If they read one quantity, give them one state (`measures`), so that they check each other:
{%- for pair in alike %}
# {{ pair }}
{%- endfor %}
{%- endif %}
'''


class Quantity(NamedTuple):
    """What a tag shows of its quantity: usual value, spread, movement in a step and noise of a reading, in its unit."""

    name: str
    unit: str
    nominal: float
    spread: float
    moves: float
    sigma: float
    is_input: bool


def quantities(draft: Draft) -> list[Quantity]:
    """The quantities of the tags of a draft.

    The noise is that of second differences, y[k-1] - 2 y[k] + y[k+1], whose variance is six times that of a reading where the
    quantity moves evenly; the movement in a step is the largest, over up to LONGEST steps, of the change's variance less that
    of the noise, over the steps.
    """
    found = []
    for tag in draft.tags:
        y = tag.values[np.isfinite(tag.values)]
        column = (draft.columns | draft.inputs)[tag.title]
        usual = float(np.median(y)) if y.size else 0.0
        least = 1e-3 * abs(usual) or 1e-3
        sigma = _robust_sigma(np.diff(y, n=2)) / np.sqrt(6.0) if y.size > 4 else 0.0
        sigma = sigma or _resolution(y) / np.sqrt(12.0) or least
        lags = [lag for lag in (1, 2, 4, 8, 16, 32, LONGEST) if y.size > 2 * lag]
        moved = [(float(np.mean((y[lag:] - y[:-lag]) ** 2)) - 2.0 * sigma**2) / lag for lag in lags]
        moves = float(np.sqrt(max([0.0, *moved]))) or 0.1 * sigma
        spread = max(float(np.std(y)) if y.size else 0.0, 2.0 * sigma)
        usual, spread, moves, sigma = (float(f"{v:.3g}") for v in (usual, spread, moves, sigma))
        found.append(Quantity(column.name, tag.unit or "1", usual, spread, moves, sigma, bool(column.input)))
    return found


def usual_step(draft: Draft) -> float:
    """The usual step between rows, s; of a single row, 1."""
    steps = np.diff(np.unique(draft.times.t)) if draft.times is not None else np.empty(0)
    return float(f"{np.median(steps):.6g}") if steps.size else 1.0


def skeleton(draft: Draft, name: str, source: str) -> str:
    """The text of a Python file whose `make` returns the plant of `skeleton_plant`."""
    found = quantities(draft)
    shown = [q._replace(name=_text(q.name), unit=_text(q.unit)) for q in found]
    template = Environment(undefined=StrictUndefined, autoescape=False).from_string(TEMPLATE)
    return (
        template.render(
            title=_plain(name),
            source=_plain(source),
            name=_text(name),
            quantities=[q for q in shown if not q.is_input],
            inputs=[q for q in shown if q.is_input or INPUT_NAME.search(q.name)],
            alike=_alike(draft, found),
            dt=repr(usual_step(draft)),
        )
        + "\n"
    )


def skeleton_plant(draft: Draft, name: str) -> Plant:
    """The plant of `skeleton`: each quantity stays as it is, but for its process noise."""
    found = [q for q in quantities(draft) if not q.is_input]
    one = np.eye(len(found))
    return linear_plant(
        name, one, one, [Sensor(q.name, q.name, q.unit, sigma=q.sigma) for q in found], dt=usual_step(draft),
        states=[Signal(q.name, q.unit, q.nominal, initial_sigma=q.spread, process_sigma=q.moves) for q in found],
    )  # fmt: skip


def _robust_sigma(values: Array) -> float:
    """The standard deviation of normal values by their median, or where most are 0, as they are."""
    return 1.4826 * float(np.median(np.abs(values))) or float(np.std(values))


def _resolution(y: Array) -> float:
    """The smallest step between values; 0 where they are all the same."""
    steps = np.diff(np.unique(y))
    return float(np.min(steps)) if steps.size else 0.0


def _alike(draft: Draft, found: list[Quantity]) -> list[str]:
    """The pairs of tags of one unit and about one value that move together."""
    pairs = []
    for i, one in enumerate(draft.tags):
        for j, other in enumerate(draft.tags[:i]):
            if len(one.values) != len(other.values) or one.unit != other.unit or found[i].is_input or found[j].is_input:
                continue
            known = np.isfinite(one.values) & np.isfinite(other.values)
            a, b = one.values[known], other.values[known]
            near = a.size > 10 and abs(np.median(a) - np.median(b)) <= 0.1 * abs(np.median(a))
            if near and np.std(a) > 0 and np.std(b) > 0 and np.corrcoef(a, b)[0, 1] > ALIKE:
                pairs.append(f"{found[j].name} and {found[i].name}, correlation {np.corrcoef(a, b)[0, 1]:.2f}")
    return pairs


def _text(text: str) -> str:
    """A text in Python."""
    return json.dumps(text, ensure_ascii=False)


def _plain(text: str) -> str:
    """A text within a docstring."""
    return repr(text)[1:-1].replace('"', "'")
