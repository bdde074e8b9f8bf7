"""Prototype."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.core.covariance import diagonal
from fusion_sfdia.core.detector import Decision, ProcessHypothesis
from fusion_sfdia.core.exclusion import Exclusion, exclude, none_excluded, readmit
from fusion_sfdia.core.health import broken
from fusion_sfdia.core.redundancy import most_faults
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.kalman_banks import onset_window
from fusion_sfdia.kalman_banks.leave_one_out import (
    eliminate,
    normalised_innovation_squared,
    posterior,
    statistics,
)
from fusion_sfdia.kalman_banks.onset_window import Onsets

Array = NDArray[Any]


class RobustMemory(NamedTuple):
    estimate: GaussianState
    exclusion: Exclusion
    bias: Onsets
    ramp: Onsets
    jump: Onsets
    drift: Onsets
    rate: Onsets
    nis: Array  # (..., L2): sums of d'S^-1 d since the onsets of the long grid
    dof: Array
    mean: Array  # (...): recent mean of unexplained nis per dof
    extra: Array  # (..., n): variance added to Q, decaying
    process: Array  # (..., P)
    size: Array


@dataclass(frozen=True)
class RobustBank(BatchDetector):
    window: int = 32
    memory: int = 256
    false_alarm: float = 1e-3
    margin: float = 6.0
    process_margin: float = 10.0
    max_faults: int | None = None
    accommodate: bool = True
    sensor_size: float = 20.0
    parameter_size: float = 2.0
    equation_size: float = 10.0
    use_rates: bool = True
    use_kappa: bool = True
    estimator: Any = field(default_factory=Extended)

    @cached_property
    def model(self) -> Any:
        return augment(self.plant)

    @cached_property
    def most_faults(self) -> int:
        return self.max_faults or most_faults(self.plant)

    @cached_property
    def n(self) -> int:
        return len(self.plant.states)

    @cached_property
    def phi(self) -> Array:
        """phi_1 of the transition matrix at x0, columns scaled to a unit diagonal (n, n)."""
        p = self.plant
        F = p.step_jacobian_at(0.0, p.x0, p.input_at(0.0), p.dt)
        nodes, weights = np.polynomial.legendre.leggauss(16)
        s, w = (nodes + 1) / 2, weights / 2
        eye = np.eye(len(F))
        inv = sum(wi * np.linalg.inv(eye + si * (F - eye)) for si, wi in zip(s, w))
        phi = np.linalg.inv(inv)
        d = np.diagonal(phi)
        return phi / np.where(np.abs(d) > 1e-9, d, 1.0)

    @cached_property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        m = self.model
        known = self.plant.uncertainty
        kinds = ["parameter"] * len(known.parameters) + ["input"] * len(known.inputs) + ["disturbance"] * len(known.disturbances)
        aug = [ProcessHypothesis(s.name, s.unit, k, s.nominal) for s, k in zip(m.states[self.n :], kinds, strict=True)]
        return (*aug, *(ProcessHypothesis(s.name, s.unit, "state", np.nan) for s in self.plant.states))

    @cached_property
    def prior_sd(self) -> Array:
        """Prior standard deviation of augmented states (p,)."""
        k = self.plant.uncertainty
        return np.array(
            [p.sd for p in k.parameters]
            + [k.inputs[s.name] for s in self.plant.inputs if s.name in k.inputs]
            + [d.sd for d in k.disturbances]
        )

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        z, count, p = len(self.model.states), len(self.plant.sensors), self.prior_sd.size
        W, Mm = self.window, self.memory
        est = self.estimator.start(self.model, batch, step_stream(seed, 0))
        L = onset_window.slots(Mm)
        return RobustMemory(
            est, none_excluded(batch, count),
            onset_window.empty(batch, W, z, count), onset_window.empty(batch, Mm, z, count),
            onset_window.empty(batch, W, z, p), onset_window.empty(batch, Mm, z, p),
            onset_window.empty(batch, W, z, self.n if self.use_rates else 0),
            np.zeros((*batch, L)), np.zeros((*batch, L)), np.zeros(batch), np.zeros((*batch, z)),
            np.zeros((*batch, p + self.n), bool), np.zeros((*batch, p + self.n)),
        )  # fmt: skip

    @property
    def limits(self) -> tuple[float, float, float]:
        count, scale = len(self.plant.sensors), self.threshold_scale
        half = self.false_alarm / 2 / count
        slots = onset_window.slots(self.window) + onset_window.slots(self.memory)
        hyp = max(1, len(self.process_hypotheses))
        return (
            float((scale * ndtri(half / 2)) ** 2),
            float((scale * ndtri(half / slots / 2)) ** 2),
            float(ndtri(self.false_alarm / 2 / hyp / slots / 2) ** 2),
        )

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        m, est, plant = memory, self.estimator, self.plant
        model, t, n = self.model, now.t, self.n
        one_limit, window_limit, process_limit = self.limits
        core = m.estimate
        prior = est.predict(model, core, now.t_start, u, now.dt, step_stream(0, 0))
        if np.any(m.extra):
            P = prior.core.P.copy()
            np.einsum("...ii->...i", P)[...] += m.extra
            prior = prior._replace(core=GaussianState(prior.core.x, P))
        joint = est.joint(model, prior, t, u)
        usable = np.isfinite(y) & ~m.exclusion.out
        everything = statistics(joint, y, usable)
        F = prior.tangent
        H = model.output_jacobian_at(t, prior.core.x, u)
        H = np.broadcast_to(H, (*y.shape[:-1], *H.shape[-2:]))
        R = plant.sensor_cov
        # --- windows
        S, d = everything.inverse, everything.whitened
        fam = {}
        for name, mem_len in (("bias", self.window), ("ramp", self.memory), ("jump", self.window), ("drift", self.memory), ("rate", self.window)):
            w = onset_window.aged(getattr(m, name), now.k, mem_len)
            eta = F[..., None, :, :] @ w.eta
            first = (w.age == 1)[..., None, None]
            if name == "jump":
                eta = eta - np.where(first, F[..., None, :, n:], 0.0)
            elif name == "drift":
                eta = eta - F[..., None, :, n:]
            elif name == "rate" and eta.shape[-1]:
                eta[..., :n, :] -= self.phi
            M = -(H[..., None, :, :] @ eta)
            if name == "bias":
                np.einsum("...ii->...i", M)[...] += 1.0
            elif name == "ramp":
                np.einsum("...ii->...i", M)[...] += w.age[..., None]
            a = w.a + (np.swapaxes(M, -1, -2) @ d[..., None, :, None])[..., 0]
            b = w.b + np.sum(M * (S[..., None, :, :] @ M), axis=-2)
            fam[name] = (w._replace(eta=eta, a=a, b=b), M)
        # unexplained scale
        nis_now = np.sum(np.where(everything.used, np.where(everything.used, y, joint.y) - joint.y, 0.0) * d, axis=-1)
        dof_now = everything.used.sum(axis=-1)
        places = onset_window.moves(now.k, self.memory)
        nis = np.concatenate([np.zeros_like(m.nis[..., :1]), m.nis[..., places]], -1) + nis_now[..., None]
        dof = np.concatenate([np.zeros_like(m.dof[..., :1]), m.dof[..., places]], -1) + dof_now[..., None]
        # --- best onset of each
        def best(name: str, size: Array, ok: Any = True) -> dict[str, Array]:
            w, _ = fam[name]
            s = size / (w.age[..., None] if name in ("ramp", "drift") else 1.0)
            known = ok & (w.b * s**2 > 1e-3)
            b = np.where(known, w.b, 1.0)
            a = np.where(known, w.a, 0.0)
            L = np.where(known, a**2 / (b + s**-2.0) - np.log1p(b * s**2), -np.inf)
            T = a**2 / b
            at = np.argmax(L, axis=-2)
            def g(v: Array) -> Array:
                return np.take_along_axis(v, at[..., None, :], -2)[..., 0, :]
            atT = np.argmax(T, axis=-2)
            def gT(v: Array) -> Array:
                return np.take_along_axis(v, atT[..., None, :], -2)[..., 0, :]
            return dict(L=g(L), T=gT(T), size=g(a / b), b=g(b), at=at, TL=g(T), sizeT=gT(a / b), bT=gT(b))
        sig = np.sqrt(R)
        B = best("bias", self.sensor_size * sig, usable[..., None, :])
        Rm = best("ramp", self.sensor_size * sig, usable[..., None, :])
        J = best("jump", self.parameter_size * self.prior_sd)
        D = best("drift", self.parameter_size * self.prior_sd)
        q = np.sqrt(np.broadcast_to(diagonal(plant.process_cov), (n,)))
        q = np.where(q > 0, q, 0.1 * plant.state_scale)
        E = best("rate", self.equation_size * q) if self.use_rates else None
        # kappa on the long grid for the overall best T
        allT = [B["T"], Rm["T"], J["T"], D["T"]] + ([E["T"]] if E is not None else [])
        bestT = np.max(np.concatenate(allT, -1), -1) if allT else 0.0
        # onset slot ~ window of W samples
        take = onset_window.slots(self.window) - 1
        nu = np.maximum(dof[..., take] - 1, 1)
        Jn = (nis[..., take] - bestT) / nu
        mean = m.mean + (np.where(dof_now > 0, np.maximum(nis_now - 0, 0) / np.maximum(dof_now, 1), 1.0) - m.mean) / 40 if False else m.mean
        kappa = np.maximum(1.0, Jn / (1 + 2 * np.sqrt(2 / nu))) if self.use_kappa else np.ones_like(Jn)
        k1 = kappa[..., None]
        def scaled(X: dict[str, Array]) -> Array:
            return X["TL"] / k1 - (X["TL"] - X["L"])  # a^2/(b+..) part approximated by T
        Ls_w = np.maximum(scaled(B), scaled(Rm))
        Ts = np.maximum(B["T"], Rm["T"]) / k1
        Lp_parts = [np.maximum(scaled(J), scaled(D))] + ([scaled(E)] if E is not None else [])
        Lp = np.concatenate(Lp_parts, -1)
        Tp = np.concatenate([np.maximum(J["T"], D["T"])] + ([E["T"]] if E is not None else []), -1) / k1
        best_p = np.max(Lp, -1, initial=-np.inf)
        one_L = everything.chi_square / k1 - np.log1p(everything.weight * (self.sensor_size * sig) ** 2)
        Ls = np.where(usable, np.maximum(Ls_w, one_L), -np.inf)
        best_s = np.max(Ls, -1)
        # --- one-sample elimination under competition
        found, isolated = everything, np.zeros(y.shape, bool)
        capped = np.zeros(y.shape[:-1], bool)
        ages1 = {name: (fam[name][1][..., 0, :, :]) for name in ("jump", "rate")}
        while True:
            chi = found.chi_square / k1
            worst = np.argmax(chi, axis=-1)
            above = np.max(chi, -1) > one_limit
            l_s = np.take_along_axis(np.where(np.any(isolated, -1, keepdims=True), chi - np.log1p(found.weight * (self.sensor_size * sig) ** 2), Ls), worst[..., None], -1)[..., 0]
            l_p = best_p
            if np.any(isolated):
                M1 = np.concatenate([ages1["jump"], ages1["rate"]], -1)
                a1 = (np.swapaxes(M1, -1, -2) @ found.whitened[..., None])[..., 0]
                b1 = np.sum(M1 * (found.inverse @ M1), -2)
                s1 = np.concatenate([self.parameter_size * self.prior_sd, self.equation_size * q if self.use_rates else np.zeros(0)])
                l1 = np.max((a1**2 / k1) / (b1 + s1**-2.0) - np.log1p(b1 * s1**2), -1, initial=-np.inf)
                l_p = np.where(np.any(isolated, -1), l1, best_p)
            room = np.sum(m.exclusion.out | isolated, -1) < self.most_faults
            where = above & room & (l_s - l_p > self.margin)
            if not np.any(where) or not self.accommodate:
                capped = above & ~room
                break
            isolated = isolated | (where[..., None] & (np.arange(y.shape[-1]) == worst[..., None]))
            found = eliminate(found, worst, where)
        # --- window sensor verdict
        worst = np.argmax(np.where(usable, Ls_w, -np.inf), -1)
        T_w = np.take_along_axis(Ts, worst[..., None], -1)[..., 0]
        L_w = np.take_along_axis(Ls_w, worst[..., None], -1)[..., 0]
        any_one = np.any(isolated, -1)
        room = np.sum(m.exclusion.out, -1) < self.most_faults
        sensor = ~any_one & (T_w > window_limit) & (L_w - best_p > self.margin)
        capped |= sensor & ~room
        # free what was absorbed before eliminating, if window hypothesis beats the one-sample one
        freed = any_one & (np.take_along_axis(isolated, worst[..., None], -1)[..., 0]) & (L_w > np.take_along_axis(one_L, worst[..., None], -1)[..., 0] + 2)
        chosen = (((sensor & room) | freed)[..., None]) & (np.arange(y.shape[-1]) == worst[..., None])
        # --- process verdict
        which = np.argmax(Lp, -1) if Lp.shape[-1] else np.zeros(y.shape[:-1], int)
        T_pb = np.take_along_axis(Tp, which[..., None], -1)[..., 0]
        proc = ~any_one & ~sensor & (T_pb > process_limit) & (best_p - best_s > self.process_margin)
        p = self.prior_sd.size
        x_shift = np.zeros_like(prior.core.x)
        P_add = None
        def effect(name: str, X: dict[str, Array], idx: Array) -> tuple[Array, Array, Array]:
            w, _ = fam[name]
            at = np.take_along_axis(X["at"], idx[..., None], -1)[..., 0]
            eta = np.take_along_axis(w.eta, at[..., None, None, None], -3)[..., 0, :, :]
            eta = np.take_along_axis(eta, idx[..., None, None], -1)[..., 0]
            size = np.take_along_axis(X["size"], idx[..., None], -1)[..., 0]
            b = np.take_along_axis(X["b"], idx[..., None], -1)[..., 0]
            return eta, size, b
        shift = np.zeros_like(prior.core.x)
        cov = np.zeros_like(prior.core.P)
        act = np.any(chosen, -1) & self.accommodate
        if np.any(act):
            eb, sb, bb = effect("bias", B, worst)
            er, sr, br = effect("ramp", Rm, worst)
            use_r = np.take_along_axis(scaled(Rm) > scaled(B), worst[..., None], -1)[..., 0]
            eta = np.where(use_r[..., None], er, eb)
            size, bb = np.where(use_r, sr, sb), np.where(use_r, br, bb)
            shift += np.where(act[..., None], eta * size[..., None], 0.0)
            cov += np.where(act[..., None, None], eta[..., :, None] * (eta * (kappa / bb)[..., None])[..., None, :], 0.0)
        pact = proc & self.accommodate
        extra = m.extra * 0.97
        psize = m.size.copy()
        process = m.process.copy()
        if np.any(pact):
            for name, X, lo, hi in (("jump", J, 0, p), ("drift", D, 0, p), ("rate", E, p, p + n)):
                if X is None:
                    continue
                inside = pact & (which >= lo) & (which < hi)
                if name in ("jump", "drift"):
                    other = D if name == "jump" else J
                    mine = np.take_along_axis(scaled(X), np.clip(which, 0, max(p - 1, 0))[..., None], -1)[..., 0] if p else np.zeros(y.shape[:-1])
                    its = np.take_along_axis(scaled(other), np.clip(which, 0, max(p - 1, 0))[..., None], -1)[..., 0] if p else np.zeros(y.shape[:-1])
                    inside = inside & ((mine >= its) if name == "jump" else (mine > its))
                if not np.any(inside):
                    continue
                idx = np.clip(which - lo, 0, hi - lo - 1)
                eta, size, b = effect(name, X, idx)
                shift += np.where(inside[..., None], eta * size[..., None], 0.0)
                v = kappa / b + 0.1 * size**2
                cov += np.where(inside[..., None, None], eta[..., :, None] * (eta * v[..., None])[..., None, :], 0.0)
                if name == "rate":
                    dirn = np.zeros_like(extra)
                    dirn[..., :n] = (size[..., None] * np.moveaxis(self.phi[:, idx], 0, -1)) ** 2
                    extra = extra + np.where(inside[..., None], dirn, 0.0)
                one = inside[..., None] & (np.arange(p + n) == which[..., None])
                process |= one
                psize = np.where(one, size[..., None], psize)
        restart = (any_one | np.any(chosen, -1) | proc) & self.accommodate
        if np.any(act | pact):
            prior = prior._replace(core=GaussianState(prior.core.x - shift, prior.core.P + cov))
            joint = est.joint(model, prior, t, u)
            again = statistics(joint, y, usable & ~chosen & ~isolated)
            found = again
        isolated = isolated | chosen
        if not self.accommodate:
            found = everything
        x, P = posterior(joint, found)
        K = joint.C @ found.inverse
        keep = ~restart
        windows = {}
        for name in fam:
            w, M = fam[name]
            eta = w.eta + K[..., None, :, :] @ M
            kk = keep[..., None]
            windows[name] = Onsets(eta * kk[..., None, None], w.a * kk[..., None], w.b * kk[..., None], w.age * kk)
        nis, dof = nis * keep[..., None], dof * keep[..., None]
        # --- conclude
        expected = model.output(t, x, u)
        h = model.output_jacobian_at(t, x, u)
        variance = np.sum((h @ P) * h, axis=-1) + R
        error = y - expected
        exclusion = m.exclusion
        if self.accommodate:
            exclusion = readmit(exclusion, error, variance, one_limit, -np.log(self.false_alarm / y.shape[-1]))
            exclusion = exclude(exclusion, isolated, error)
            if np.any(pact):  # readmit those excluded lately: left out
                pass
        held = exclusion.out if self.accommodate else isolated
        outside = np.isfinite(y) & ~usable
        stronger = Ts / window_limit > everything.chi_square / k1 / one_limit
        wsize = np.where(B["T"] >= Rm["T"], B["sizeT"], Rm["sizeT"])
        winf = np.where(B["T"] >= Rm["T"], B["bT"], Rm["bT"])
        residual = np.where(stronger, wsize, everything.innovation)
        threshold = np.where(stronger, np.sqrt(window_limit * k1 / winf), np.sqrt(one_limit * k1 * everything.variance))
        alarm = (np.max(Ts, -1) > window_limit) | (np.max(everything.chi_square, -1) / kappa > one_limit)
        undecided = alarm & ~np.any(isolated, -1) & ~proc
        top = np.maximum(best_s, best_p)[..., None]
        suspect = undecided[..., None] & (np.concatenate([Ls, Lp], -1) > top - self.margin)
        decision = Decision(
            estimate=x[..., :n],
            reconstruction=np.where(np.isfinite(y) & ~held, y, expected),
            residual=np.where(outside, error, np.where(usable, residual, np.nan)),
            threshold=np.where(outside, np.sqrt(one_limit * variance), threshold),
            isolated=held,
            fault_size=np.where(held, exclusion.size, np.nan),
            diverged=prior.lost | broken(x, P),
            guarded=prior.guarded,
            nis=normalised_innovation_squared(joint, found, y),
            covariance=P[..., :n, :n],
            capped=capped,
            process=process,
            process_size=np.where(process, psize, np.nan),
            suspect=suspect,
        )
        mem = RobustMemory(GaussianState(x, P), exclusion, *(windows[k] for k in ("bias", "ramp", "jump", "drift", "rate")), nis, dof, mean, extra, process, psize)
        return mem, decision
