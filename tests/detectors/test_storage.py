"""Files that are complete or absent, and detector states that are matched with their detector."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.state import State, leaves, names
from fusion_sfdia.detectors.storage import fingerprint, load_state, read_arrays, save_state, write_arrays
from fusion_sfdia.filters.estimators import Ensemble, Extended, Unscented

DETECTORS: list[Detector] = [
    FusingBank(tanks(), Extended(), thresholds=(1.0,) * 4),
    FusingBank(tanks(), Extended(), beta=(0.4, 0.2, 0.2, 0.2), thresholds=(1.0,) * 4),
    FusingBank(tanks(), Ensemble(), thresholds=(1.0,) * 4),
    LeaveOneOutBank(tanks(), window=5),
    LeaveOneOutBank(tanks(), Unscented(), window=1),
    CentralFilter(tanks()),
    CentralFilter(tanks(), Ensemble()),
]
IDS = ["fusing", "fusing-literal", "fusing-ensemble", "loo-window", "loo-unscented", "central", "central-ensemble"]


def state_of(detector: Detector) -> State:
    t, _, y, u = readings(detector.plant, 6, 1, seed=0)
    return run(detector, detector.init(), t, y[:, 0], u[:, 0])[0]


@pytest.mark.parametrize("detector", DETECTORS, ids=IDS)
@pytest.mark.parametrize("batch", [(), (3,), (3, 1)], ids=str)
def test_a_state_comes_back_bit_by_bit_without_pickle(detector: Detector, batch: tuple[int, ...], tmp_path: Path) -> None:
    t, _, y, u = readings(detector.plant, 6, 3, seed=1)
    shape = {(): lambda a: a[:, 0], (3,): lambda a: a, (3, 1): lambda a: a[:, :, None]}[batch]
    y, u = shape(y), shape(u)
    middle, _ = run(detector, detector.init(batch, seed=2**63 + 5), t[:3], y[:3], u[:3])
    path = tmp_path / "new folder" / "state.npz"
    save_state(path, detector, middle)
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)
    loaded = load_state(path, detector)
    assert names(loaded) == names(middle)
    assert [(a.shape, a.dtype) for a in leaves(loaded)] == [(a.shape, a.dtype) for a in leaves(middle)]
    end, decisions = run(detector, middle, t[3:], y[3:], u[3:])
    resumed_end, resumed = run(detector, loaded, t[3:], y[3:], u[3:])
    np.testing.assert_array_equal(decisions.estimate, resumed.estimate)
    for a, b in zip(leaves(end), leaves(resumed_end), strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_detector_settings_or_plant_is_refused(tmp_path: Path) -> None:
    plant = tanks()
    detector = LeaveOneOutBank(plant, window=5)
    path = tmp_path / "state.npz"
    save_state(path, detector, state_of(detector))
    noisier = replace(plant, sensors=(replace(plant.sensors[0], sigma=0.02), *plant.sensors[1:]))
    for other in (
        replace(detector, window=6),
        replace(detector, false_alarm=1e-4),
        replace(detector, accommodate=False),
        replace(detector, estimator=Unscented()),
        replace(detector, plant=noisier),
        replace(detector, plant=replace(plant, name="other tanks")),
        replace(detector, plant=replace(plant, dt=6.0)),
        replace(detector, plant=replace(plant, x0=np.array([1.0, 1.5]))),
        replace(detector, plant=replace(plant, process_cov=2 * plant.process_cov)),
        LeaveOneOutBank(chain(4), window=5),
        CentralFilter(plant),
    ):
        with pytest.raises(ValueError, match="was saved by another detector, other settings or another plant"):
            load_state(path, other)
    assert fingerprint(LeaveOneOutBank(tanks(), window=5)) == fingerprint(detector)  # built again it is the same


def test_a_foreign_file_is_one_clear_error(tmp_path: Path) -> None:
    detector = CentralFilter(tanks())
    text, array, archive = tmp_path / "notes.txt", tmp_path / "array.npy", tmp_path / "other.npz"
    text.write_text("readings of 3 May")
    np.save(array, np.zeros(3))
    np.savez(archive, y=np.zeros(3))
    pickled, empty = tmp_path / "pickled.npz", tmp_path / "empty.npz"
    np.savez(pickled, fingerprint=np.array([{"a": 1}], dtype=object))
    empty.touch()
    for path in (text, array, archive, pickled, empty):
        with pytest.raises(
            ValueError, match=f"{path.name} is not a saved detector state .*; write one with detectors.save_state"
        ):
            load_state(path, detector)
    with pytest.raises(FileNotFoundError):
        load_state(tmp_path / "missing.npz", detector)


def test_a_file_has_the_fields_by_their_names(tmp_path: Path) -> None:
    detector, path = LeaveOneOutBank(tanks(), window=5), tmp_path / "state.npz"
    save_state(path, detector, state := state_of(detector))
    found = read_arrays(path)
    assert set(found) == {"fingerprint", *names(state)} and {"seed", "steps", "t", "diverged"} < set(found)
    np.testing.assert_array_equal(found["t"], 30.0)  # the time of the last of six readings, five seconds apart
    np.testing.assert_array_equal(found["memory.estimate.x"], state.memory.estimate.x)
    np.testing.assert_array_equal(found["memory.exclusion.out"], state.memory.exclusion.out)
    np.testing.assert_array_equal(found["memory.window.eta"], state.memory.window.eta)


def test_the_state_of_another_version_is_one_clear_error(tmp_path: Path) -> None:
    """As positions without names, which states were saved by once, and with a field more, less or of another name."""
    detector, path = LeaveOneOutBank(tanks(), window=5), tmp_path / "state.npz"
    state = state_of(detector)
    own, stated = dict(zip(names(state), leaves(state), strict=True)), {"fingerprint": np.array(fingerprint(detector))}
    positions = {f"state_{i:03d}": a for i, a in enumerate(own.values())}
    renamed = {name.replace("exclusion", "excluded"): a for name, a in own.items()}
    fewer = {name: a for name, a in own.items() if name != "memory.window.a"}
    for arrays in (positions, renamed, fewer, {**own, "memory.extra": np.zeros(1)}):
        write_arrays(path, {**stated, **arrays})
        with pytest.raises(
            ValueError, match=r"state\.npz has the state of another version, with other fields; continue"
        ) as error:
            load_state(path, detector)
        assert "\n" not in str(error.value)
    write_arrays(path, {**stated, **own})
    load_state(path, detector)


def test_the_state_of_a_detector_that_warns_of_its_settings_is_loaded_without_a_second_warning(tmp_path: Path) -> None:
    detector = FusingBank(tanks(), Extended())
    with pytest.warns(UserWarning, match="has no thresholds"):
        state = detector.init()
    save_state(tmp_path / "state.npz", detector, state)
    assert load_state(tmp_path / "state.npz", detector).t == 0.0


def test_every_flipped_bit_and_every_cut_of_a_state_is_one_clear_error(tmp_path: Path) -> None:
    detector = CentralFilter(tanks())
    whole, broken = tmp_path / "state.npz", tmp_path / "broken.npz"
    save_state(whole, detector, state_of(detector))
    content = whole.read_bytes()
    cure = r"broken\.npz is not a saved detector state .*damaged, cut or of another kind\); write one with detectors.save_state"
    flipped = np.random.default_rng(0).permutation(8 * len(content))[:2000]
    damaged = [content[:length] for length in range(len(content))] + [content + b"\0"]
    damaged += [content[: k // 8] + bytes([content[k // 8] ^ 1 << k % 8]) + content[k // 8 + 1 :] for k in flipped]
    for found in damaged:
        broken.write_bytes(found)
        with pytest.raises(ValueError, match=cure):
            load_state(broken, detector)
    broken.write_bytes(content)
    for a, b in zip(leaves(load_state(broken, detector)), leaves(state_of(detector)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_state_that_cannot_be_saved_leaves_the_old_file(tmp_path: Path) -> None:
    detector = CentralFilter(tanks())
    path = tmp_path / "state.npz"
    save_state(path, detector, state_of(detector))
    content = path.read_bytes()
    with pytest.raises(ValueError):
        save_state(path, detector, detector.init()._replace(memory=(np.array([object()]),)))
    assert path.read_bytes() == content and len(list(tmp_path.iterdir())) == 1


def test_a_state_of_a_plant_with_other_parameters_or_another_taper_is_refused(tmp_path: Path) -> None:
    from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
    from fusion_sfdia.filters.enkf import EnKFSettings, taper
    from fusion_sfdia.filters.estimators import Ensemble
    from fusion_sfdia.models.gas_pipeline.physics import pipeline_parameters
    from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline

    smooth = CentralFilter(gas_pipeline())
    save_state(tmp_path / "state.npz", smooth, smooth.init())
    rough = CentralFilter(gas_pipeline(parameters=pipeline_parameters(roughness=0.02e-3)))
    with pytest.raises(ValueError, match="another plant"):
        load_state(tmp_path / "state.npz", rough)
    at = np.arange(63.0)
    near, far = (CentralFilter(smooth.plant, Ensemble(EnKFSettings(localisation=taper(at, at, r)))) for r in (5.0, 5.5))
    save_state(tmp_path / "local.npz", near, near.init())
    with pytest.raises(ValueError, match="other settings"):
        load_state(tmp_path / "local.npz", far)
