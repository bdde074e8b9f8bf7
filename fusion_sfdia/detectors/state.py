"""The state of a detector between two readings, and nested named tuples of arrays in general.

The memory of a method is a NamedTuple of arrays with the batch as leading axes. A field may be such a tuple itself (an
`Exclusion`, a `Window`), or a plain tuple of arrays of the same kind. `leaves` and `rebuilt` take such tuples
apart and put them together; batches, resets of broken runs and saved states use them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from numpy.typing import NDArray

from fusion_sfdia.common.alike import chosen, joined

Array = NDArray[Any]


class State(NamedTuple):
    """A detector between two readings; take it from `init`, `step` or `load_state`.

    Attributes
    ----------
    seed : array ()
        Of the randomness of the method.
    steps : array ()
        Readings taken since `init`.
    t : array ()
        Time of the last reading, or of `init`, in s.
    diverged : array (*batch) of bool
        Runs in which the estimator has broken down.
    far : array (*batch) of int
        Samples in a row in which all readings were far from the model, -1 before any was near.
    memory : NamedTuple
        What the method keeps: arrays (*batch, ...) that the detector documents.

    Examples
    --------
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> state = CentralFilter(two_tanks()).init(batch=3, t=60.0)
    >>> float(state.t), int(state.steps), state.diverged.shape
    (60.0, 0, (3,))
    """

    seed: Array
    steps: Array
    t: Array
    diverged: Array
    far: Array
    memory: Any


def leaves(tree: Any) -> list[Any]:
    """The arrays of nested tuples, in the order of their fields."""
    found: list[Any] = []
    for value in tree:
        if isinstance(value, tuple):
            found += leaves(value)
        else:
            found.append(value)
    return found


def rebuilt(like: Any, arrays: Iterable[Any]) -> Any:
    """Tuples nested as `like`, of the arrays in the order of `leaves`."""
    remaining = iter(arrays)
    return _rebuilt(like, remaining)


def _rebuilt(like: Any, remaining: Iterator[Any]) -> Any:
    parts = [_rebuilt(value, remaining) if isinstance(value, tuple) else next(remaining) for value in like]
    return tuple.__new__(type(like), parts)


def mapped(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """Apply a function to each array, and to those at the same place in `others`; return tuples nested alike.

    ValueError where the others have fewer or more arrays.
    """
    if others:
        return rebuilt(tree, [function(*each) for each in zip(leaves(tree), *map(leaves, others), strict=True)])
    return tuple.__new__(type(tree), [mapped(function, v) if isinstance(v, tuple) else function(v) for v in tree])


def as_batch(tree: Any) -> Any:
    """The arrays of a single run as those of a batch of one."""
    return tuple.__new__(type(tree), [as_batch(v) if isinstance(v, tuple) else v[None] for v in tree])


def as_single(tree: Any) -> Any:
    """The arrays of a batch of one as those of a single run, arrays even of a single number."""
    return tuple.__new__(type(tree), [as_single(v) if isinstance(v, tuple) else v[0, ...] for v in tree])


def names(tree: Any, prefix: str = "") -> list[str]:
    """The name of each array in the order of `leaves`: its field after those of the enclosing tuples ("exclusion.size")."""
    found: list[str] = []
    for name, value in zip(getattr(tree, "_fields", map(str, range(len(tree)))), tree, strict=True):
        found += names(value, f"{prefix}{name}.") if isinstance(value, tuple) else [prefix + name]
    return found


def with_runs(state: State, function: Callable[[Array], Array]) -> State:
    """The state with a function applied to each array of a batch, such as one that reshapes its leading axes."""
    diverged, far, memory = mapped(function, (state.diverged, state.far, state.memory))
    return state._replace(diverged=diverged, far=far, memory=memory)


def chosen_runs(state: State, runs: Array) -> State:
    """The state of some runs of a batch of one axis, by their indices."""
    return with_runs(state, lambda a: chosen(a, runs))


def joined_runs(state: State, other: State) -> State:
    """The runs of two states of one detector at the same time as one batch, along its first axis."""
    both = (state.diverged, state.far, state.memory), (other.diverged, other.far, other.memory)
    diverged, far, memory = mapped(joined, *both)
    return state._replace(diverged=diverged, far=far, memory=memory)
