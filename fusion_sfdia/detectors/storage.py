"""Arrays on disk with a digest of their content, and detector states without pickle."""

from __future__ import annotations

import hashlib
import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.detectors.detector import OWN_CLASS, Detector
from fusion_sfdia.detectors.state import State, leaves, names, rebuilt
from fusion_sfdia.plant.plant import Plant

SINGLE = 3  # the first fields of a State, which a batch has once
OTHER_FIELDS = (
    "has the state of another version, with other fields; continue with the version that saved it, or start from the "
    "detector's init"
)


def fingerprint(detector: Detector) -> str:
    """A digest by which a saved state is matched: a detector's class and settings, and of its plant the names, the noise,
    where one nominal step and its readings lead from x0 (to 9 digits), which any change of parameters moves, and its areas.
    """
    plant: Plant = detector.plant
    u = plant.input_at(0.0)
    ahead = plant.step(0.0, plant.x0, u, plant.dt)
    parts = [
        type(detector).__name__,
        _described(detector) if is_dataclass(detector) else "",
        plant.name,
        repr(plant.dt),
        *plant.sensor_names,
        *(s.name for s in plant.states),
        *(f"{v:.8e}" for v in (*ahead, *plant.output(plant.dt, ahead, u))),
        *(() if plant.structure.areas is None else (_described(plant.structure.areas),)),
    ]
    digest = hashlib.sha256("\n".join(parts).encode())
    for array in (plant.x0, plant.initial_cov, plant.process_cov, plant.sensor_cov):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _described(value: Any) -> str:
    """Settings in full but those that no comparison counts, arrays to the last bit; the plant is left to `fingerprint`."""
    if isinstance(value, Plant):
        return ""
    if is_dataclass(value) and not isinstance(value, type):
        settings = (f"{f.name}={_described(getattr(value, f.name))}" for f in fields(value) if f.compare)
        return f"{type(value).__name__}({', '.join(settings)})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_described, value))})"
    return repr(value)


def require_detector(detector: Any) -> None:
    """Raise ValueError for anything but a Detector object, such as its name or its class."""
    if isinstance(detector, type) or not isinstance(detector, Detector):
        raise ValueError(
            f"detector is {shown(detector)}; expected a Detector, such as fusion_sfdia.detector('kf-chi2', plant).detector; "
            f"{OWN_CLASS}"
        )


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> None:
    """Write arrays to a .npz file that ends with a digest of everything before it; ValueError for arrays of objects."""
    packed = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(packed, allow_pickle=False, **arrays)
    content = packed.getvalue()
    with atomic_write(path, "wb") as file:
        file.write(content + hashlib.sha256(content).digest())


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read what write_arrays wrote, to the bit; ValueError where the file is anything else, cut or damaged."""
    found = path.read_bytes()
    content, digest = found[:-32], found[-32:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("the digest at its end is not that of its content: it is damaged, cut or of another kind")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as error:  # zipfile, zlib and NumPy have many for what is none of theirs
        raise ValueError(f"its content is no set of arrays: {error}") from error


@dataclass
class SavedArrays:
    """Arrays of a file by name, each of which is taken once; ValueError for what is missing, too many or of another kind."""

    arrays: dict[str, NDArray[Any]]

    def take(self, name: str, kind: str, *shape: int | None) -> NDArray[Any]:
        """The array of that name; kind: of its dtype, "f", "i", "b" or "U"; in shape None is any length."""
        if name not in self.arrays:
            raise ValueError(f"{name!r} is missing")
        found = self.arrays.pop(name)
        fits = found.ndim == len(shape) and all(b is None or a == b for a, b in zip(found.shape, shape, strict=True))
        if found.dtype.kind != kind or not fits:
            expected = str(shape).replace("None", "any")
            raise ValueError(f"{name!r} has dtype {found.dtype} and shape {found.shape}; expected kind {kind!r} and {expected}")
        if kind in "fi" and found.dtype.itemsize != 8:
            raise ValueError(f"{name!r} has dtype {found.dtype}; expected 64 bits")
        return found

    def end(self) -> None:
        """Raise ValueError where arrays are left that nothing has taken."""
        if self.arrays:
            raise ValueError(f"{next(iter(self.arrays))!r} is not known")


def whole_numbers(name: str, values: NDArray[Any]) -> Any:
    """Numbers as Python integers, in nested lists as `tolist` gives them; ValueError unless all are whole and at least 0."""
    if not np.all(np.isfinite(values) & (values == np.round(values)) & (values >= 0) & (values < 2**53)):
        raise ValueError(f"{name!r} has {shown(values)}; expected whole numbers of at least 0")
    return values.astype(int).tolist()


def save_state(path: str | Path, detector: Detector, state: State) -> None:
    """Write a detector's state to a .npz file, an array for each field by its name ("memory.exclusion.size"), without pickle.

    On the same machine a run goes on from it with the same bits.

    Parameters
    ----------
    path : str or Path
        The file to write.
    detector : Detector
        That of the state.
    state : State
        To be written.

    Raises
    ------
    ValueError
        For arrays of objects.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fusion_sfdia.detectors import CentralFilter, load_state, save_state
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks())
    >>> with TemporaryDirectory() as folder:
    ...     save_state(Path(folder, "state.npz"), detector, detector.init(t=60.0))
    ...     state = load_state(Path(folder, "state.npz"), detector)
    >>> float(state.t)
    60.0
    """
    require_detector(detector)
    write_arrays(Path(path), state_arrays(state, fingerprint(detector)))


def load_state(path: str | Path, detector: Detector) -> State:
    """Read a state written by save_state.

    Parameters
    ----------
    path : str or Path
        The file.
    detector : Detector
        That of the state, with the same settings on the same plant.

    Returns
    -------
    State
        From which a run goes on.

    Raises
    ------
    ValueError
        Where the file is none, damaged, of another detector, settings or plant, or of a version whose states have other fields.

    Examples
    --------
    See `save_state`.
    """
    require_detector(detector)
    try:
        arrays = read_arrays(Path(path))
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is not a saved detector state ({error}); write one with detectors.save_state") from error
    return state_of(path, detector, arrays)


def state_arrays(state: State, mark: str) -> dict[str, NDArray[Any]]:
    """A detector's state as arrays by name, with the fingerprint of the detector, for files that hold more than a state."""
    arrays = dict(zip(names(state), map(np.asarray, leaves(state)), strict=True))
    return {"fingerprint": np.array(mark), **arrays}


def of_another_detector(path: str | Path, detector: Detector) -> str:
    """That a file was saved by another detector, and the cure."""
    return (
        f"{path} was saved by another detector, other settings or another plant than {type(detector).__name__} "
        f"on {detector.plant.name!r}; build the detector as it was then, on the command line with the same "
        "--plant, --detector and --tuned, or begin anew with another file"
    )


def state_of(path: str | Path, detector: Detector, arrays: Mapping[str, NDArray[Any]]) -> State:
    """The state of `state_arrays`, read from the file `path`; ValueError as for `load_state`."""
    if "fingerprint" not in arrays:
        raise ValueError(f"{path} is not a saved detector state ('fingerprint'); write one with detectors.save_state")
    if "detector" in arrays:
        raise ValueError(f"{path} is a saved detector, not a state; read it with load_detector(path, plant)")
    if "t" not in arrays:
        raise ValueError(f"{path} {OTHER_FIELDS}")
    if str(arrays["fingerprint"]) != fingerprint(detector):
        raise ValueError(of_another_detector(path, detector))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # init has warned before the state was saved
        layout = detector.init()
    expected = names(layout)
    if set(arrays) != {"fingerprint", *expected}:
        raise ValueError(f"{path} {OTHER_FIELDS}")
    batch = arrays["diverged"].shape
    alike = (np.asarray(a) for a in leaves(layout))
    for k, (name, like) in enumerate(zip(expected, alike, strict=True)):
        found, shape = arrays[name], like.shape if k < SINGLE else (*batch, *like.shape)
        if found.dtype != like.dtype or found.shape != shape:
            raise ValueError(
                f"{path} is not a saved state of {type(detector).__name__} on {detector.plant.name!r}: {name!r} has dtype "
                f"{found.dtype} and shape {found.shape}; expected {like.dtype} and {shape}; begin anew with another file"
            )
    for name in ("seed", "steps", "t"):
        if not np.isfinite(arrays[name]) or (name == "steps" and arrays[name] < 0):
            raise ValueError(f"{path} is not a saved state: {name} is {arrays[name]}; begin anew with another file")
    state: State = rebuilt(layout, [arrays[name] for name in expected])
    return state
