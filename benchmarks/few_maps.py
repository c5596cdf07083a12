"""The flow over a step as a product of few Bäcklund maps, by Newton's method in doubles.

top       Lagrange top, n = 3 ... 6: maps with and without rotations about p that commute with the conserved block of m
clebsch   Clebsch's case, n = 3: how far one conjugate pair reaches, followed in h from Padé's zero

Residuals are the largest of any component of the state.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np
from cases import RESULTS, unit
from scipy.linalg import expm
from scipy.optimize import least_squares

import kreisel as kr
from kreisel import algebra
from kreisel.method import METHODS
from kreisel.method.baecklund import pade_zeros, stage_points

ROUND_OFF = 1e-11
Z = tuple[np.ndarray, np.ndarray]


def flat(z: Z) -> np.ndarray:
    return np.concatenate([algebra.coordinates(z[0]), z[1]])


def mapped(model: Any, z: Z, mu: complex | float) -> Z:
    """One real map, or a conjugate pair for a complex mu."""
    record = model.system.baecklund
    with np.errstate(all="ignore"):
        rho = model.call(record.point, *z, mu=np.asarray(mu)[()])
        e = model.call(record.vector, *z, mu=mu, rho=rho)
        return model.call(record.pair if isinstance(mu, complex) else record.step, *z, e, mu=mu, rho=rho)


def flowed(model: Any, z: Z, h: float) -> Z:
    """The flow over h, by order 24 in steps of a quarter."""
    parts = max(1, int(np.ceil(4 * h)))
    for mu in stage_points(METHODS["baecklund"].orders[-1], h / parts) * parts:
        z = mapped(model, z, mu)
    return z


def turns(m: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Generators of the rotations about p in the planes of the block of m that p does not touch."""
    block = algebra.project_out(m, p) / (p @ p)
    theta, U = np.linalg.eigh(1j * block)
    return [
        2 * np.real(1j * np.outer(U[:, k], U[:, k].conj())) for k in np.flatnonzero(theta > 1e-9 * abs(theta).max())
    ]


def residual_of(model: Any, z: Z, want: Z, maps: int, planes: list[np.ndarray]) -> Any:
    def residual(x: np.ndarray) -> np.ndarray:
        now = z
        for k in range(maps // 2):
            now = mapped(model, now, complex(x[2 * k], x[2 * k + 1]))
        if maps % 2:
            now = mapped(model, now, float(x[maps - 1]))
        R = expm(sum((a * K for a, K in zip(x[maps:], planes, strict=True)), np.zeros_like(z[0])))
        out = flat((R @ now[0] @ R.T, R @ now[1])) - flat(want)
        return np.where(np.isfinite(out), out, 1e3)

    return residual


def solved(model: Any, z: Z, h: float, maps: int, planes: list[np.ndarray]) -> float:
    """The residual that Newton's method leaves from Padé's zeros."""
    zeros = [complex(v) / h for v in pade_zeros(maps)]
    start = [x for v in zeros for x in ((v.real, v.imag) if v.imag else (v.real,))] + [0.0] * len(planes)
    residual = residual_of(model, z, flowed(model, z, h), maps, planes)
    found = least_squares(residual, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=300)
    return float(abs(found.fun).max())


def top(steps: tuple[float, ...], seeds: range) -> list[dict[str, Any]]:
    rows = []
    for n in (3, 4, 5, 6):
        for turned, enough in ((False, n - 1), (True, n // 2)):
            for maps in (enough - 1, enough) if enough > 1 else (enough,):
                worst: dict[str, float] = {}
                for h in steps:
                    found = []
                    for seed in seeds:
                        draw = np.random.default_rng([seed, n])
                        X, p = draw.standard_normal((n, n)), np.eye(n)[-1]
                        z = ((X - X.T) / np.sqrt(n), unit(draw.standard_normal(n)))
                        planes = turns(z[0], p) if turned else []
                        found.append(solved(kr.LagrangeTop(p=p), z, h, maps, planes))
                    worst[f"h = {h:g}"] = float(f"{max(found):.1g}")
                rows.append({"n": n, "maps": maps, "turns": (n - 1) // 2 if turned else 0} | worst)
                print(rows[-1], flush=True)
    return rows


def clebsch(seeds: range, longest: float = 12.0, factor: float = 1.1) -> list[dict[str, Any]]:
    """For each body: the last h at which the pair followed from small h solves to round-off, and its mu h."""
    rows = []
    for seed in seeds:
        draw = np.random.default_rng(seed)
        model, z = kr.Clebsch(b=np.sort(draw.normal(size=3))), (algebra.hat(draw.normal(size=3)), draw.normal(size=3))
        rate = max(algebra.magnitude(z[0]), np.sqrt(algebra.magnitude(model.flow(*z)[0])))
        h, last, x = 0.1, 0.0, np.array([0.0, 0.0])
        x = np.array([complex(pade_zeros(2)[0]).real, complex(pade_zeros(2)[0]).imag])
        history: list[tuple[float, np.ndarray]] = []
        while h < longest:
            residual = residual_of(model, z, flowed(model, z, h), 2, [])
            guess = x if len(history) < 2 else 2 * history[-1][1] - history[-2][1]
            fits = [
                least_squares(lambda y, h=h, f=residual: f(y / h), g, method="lm", xtol=1e-15, ftol=1e-15)
                for g in (guess, x)
            ]
            best = min(fits, key=lambda fit: abs(fit.fun).max())
            if abs(best.fun).max() > ROUND_OFF or best.x[0] <= 0:
                break
            x, last = best.x, h
            history.append((h, x))
            h *= factor
        rows.append(
            {
                "seed": seed,
                "h": float(f"{last:.3g}"),
                "h times rate": float(f"{last * rate:.3g}"),
                "mu h": [float(f"{v:.3g}") for v in x],
            }
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    asked = parser.parse_args()
    found = {"top": top((0.3, 1.0), range(asked.seeds)), "clebsch": clebsch(range(2 * asked.seeds))}
    (RESULTS / "few_maps.json").write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
