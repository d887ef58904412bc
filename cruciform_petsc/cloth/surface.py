# SPDX-License-Identifier: MIT
"""From measured tensions at pairs of strains to the nearest cloth that stores energy.

Boisse and his co-workers (Boisse, Borr, Buet and Cherouat 1997; Buet-Gautier and Boisse 2001, Exp.
Mech. 41:260) describe a cloth by two surfaces, T_w(e_w, e_e) and T_e(e_w, e_e). Only if

    dT_w/de_e = dT_e/de_w        (tensions as force per width; per yarn each is times its count)

are they the derivatives of an energy w(e_w, e_e); measured ones never are exactly. So what is
sought is w itself: a tensor product of cubic B-splines that minimises

    mean of |grad w - T|^2  +  smoothing^2 x mean of |second derivatives of grad w|^2

over the points, at rest free of tension, and convex: least eigenvalue of w'' at sixteen places of
each patch not below a floor, so that each tension rises with its own strain and a cloth under given
loads has one state. How smooth is found by generalised cross-validation (Craven and Wahba 1979,
Numer. Math. 31:377): points of one potential are met closely, what scatters is smoothed. Convexity
is a least distance under linear inequalities (Lawson and Hanson 1974, chapter 23), one for each
place and its softest direction, with directions added until none is too soft.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..tension import SURFACE, BiaxialLaw

# Of the size of the tensions, per unit square of the range of strains.
SMOOTHINGS = 10.0 ** np.arange(-5.0, 0.1, 0.25)
# The splines go on beyond the points by this much of their range, convex there, too, where a
# solver may come on its way.
MARGIN = 0.25
FLOOR = 2e-3  # least stiffness, of the size of the tensions over the range of strains
_REFINED, _MOST = 6, 12  # patches along a strain: two between values if those are few; at most
_ROUNDS = 60
_MOST_SETTLED = 2.0 / 3.0
_HARD = 1e3  # weight of no tension at rest, against the points
_ONE_LINE = 1e-3  # least over largest extent of the cloud of strains
_FAR = 0.25  # of the range of strains: a place this far from every point is none that was measured


@dataclass(frozen=True)
class Surface:
    """A law through points, and how well it goes through them."""

    law: BiaxialLaw
    points: np.ndarray
    """Strains and tensions [N/m] of warp and weft, (n, 4)."""
    fitted: np.ndarray
    """Tensions of the law there, (n, 2)."""
    no_potential: float
    """RMS by which the points miss any potential of these splines, over their RMS."""
    unmeasured: float
    """Share of the rectangle of strains that is far from all points."""

    @property
    def misfit(self) -> float:
        """RMS of the law's tensions less the points', over the RMS of the points'."""
        t = self.points[:, 2:]
        return float(np.sqrt(np.mean((self.fitted - t) ** 2) / np.mean(t**2)))

    @property
    def worst(self) -> tuple[int, float]:
        """Number of the point, from 1, of the largest misfit, and this over the largest tension."""
        off = np.abs(self.fitted - self.points[:, 2:]).max(axis=1)
        return int(off.argmax()) + 1, float(off.max() / np.abs(self.points[:, 2:]).max())


def fit_surface(points: np.ndarray) -> Surface:
    """Find the nearest convex potential to points.

    Parameters
    ----------
    points : float (n, 4)
        Strains of warp and weft, tensions of warp and weft per width of the cloth at rest, N/m.

    Raises
    ------
    InputError
        Fewer than 6 points, a number that is not finite, no tension at all, strains on one line
        through rest, a tension that falls while its own strain grows and the other one stays.
    """
    points = np.asarray(points, float)
    check_points(points)
    strain, tension = points[:, :2], points[:, 2:]
    low, high = np.minimum(strain.min(axis=0), 0.0), np.maximum(strain.max(axis=0), 0.0)
    span = high - low
    at, rest = (strain - low) / span, (-low / span)[None]
    splines = [_Splines(at[:, k]) for k in (0, 1)]
    size = float(np.sqrt(np.mean(tension**2)))
    # Unknown are coefficients of w on the unit square, so that tensions there are of the size 1.
    scale = span.max() / span
    unit = size * float(span.max())

    def rows(place: np.ndarray, a: int, b: int) -> np.ndarray:
        warp, weft = (spline.rows(place[:, k], (a, b)[k]) for k, spline in enumerate(splines))
        values = np.einsum("ni,nj->nij", warp, weft).reshape(len(place), -1)
        return values * (scale[0] ** a * scale[1] ** b)

    data = np.concatenate([rows(at, 1, 0), rows(at, 0, 1)])
    wanted = tension.T.ravel() / size
    held = np.concatenate([rows(rest, 1, 0), rows(rest, 0, 1), rows(rest, 0, 0)])
    inside = _grid(*(spline.inner for spline in splines))
    rough = np.concatenate(
        [
            np.sqrt(weight) * rows(inside, *order)
            for order, weight in (((3, 0), 1.0), ((2, 1), 3.0), ((1, 2), 3.0), ((0, 3), 1.0))
        ]
    )
    gram = data.T @ data / len(data)
    right = data.T @ wanted / len(data)
    penalty = rough.T @ rough / len(inside)
    fixed = _HARD**2 * held.T @ held
    fixed[np.diag_indices(len(fixed))] += 1e-12 * gram.trace() / len(gram)

    def scatter(smoothing: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Cross-validated mean square, the matrix, and the values that are nearest."""
        matrix = gram + fixed + smoothing**2 * penalty
        inverse = np.linalg.inv(matrix)
        values = inverse @ right
        settled = float(np.einsum("ij,ji->", inverse, gram))  # as many values as the points settle
        share = settled / len(data)
        error = float(np.mean((data @ values - wanted) ** 2)) / (1.0 - share) ** 2
        # Where it goes through nearly all points, cross-validation has nothing left to judge by.
        return np.inf if share > _MOST_SETTLED else error, matrix, values

    # Of several alike, as where all are infinite, the smoothest.
    _, matrix, free = min((scatter(s) for s in SMOOTHINGS[::-1]), key=lambda found: found[0])
    off = float(np.sqrt(np.mean((data @ free - wanted) ** 2)))
    where = _grid(*(spline.everywhere for spline in splines))
    second = [rows(where, *order) for order in ((2, 0), (1, 1), (0, 2))]
    parts = [np.arange(len(spline.everywhere)) // 4 for spline in splines]
    patch = (parts[0][:, None] * len(splines[1]) + parts[1]).ravel()
    law = _law(splines, unit * _convex(matrix, free, second, patch), low, span)
    fitted = law.evaluate(strain[:, 0], strain[:, 1])[1]
    return Surface(replace(law, points=points), points, fitted, off, _unmeasured(at))


def check_points(points: np.ndarray) -> None:
    """Raise the InputErrors of fit_surface."""
    if points.ndim != 2 or points.shape[1] != 4 or len(points) < 6:
        raise InputError(
            "a surface of tension needs at least 6 points of four numbers: strain of the warp, of "
            "the weft, tension of the warp, of the weft"
        )
    if not np.isfinite(points).all():
        row = 1 + int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InputError(f"a surface of tension needs finite numbers, those of point {row} are not")
    strain, tension = points[:, :2], points[:, 2:]
    for k, name in enumerate(("warp", "weft")):
        if not np.ptp(strain[:, k]) > 0.0:
            raise InputError(
                f"a surface of tension needs several strains of the {name}, all points have "
                f"{100.0 * strain[0, k]:.4g} %"
            )
        if not (tension[:, k] > 0.0).any():
            raise InputError(f"a surface of tension needs points at which the {name} pulls")
    sizes = np.linalg.svd(strain / np.abs(strain).max(axis=0), compute_uv=False)
    if sizes[1] < _ONE_LINE * sizes[0]:
        warp, weft = strain[np.abs(strain).sum(axis=1).argmax()]
        raise InputError(
            "a surface of tension needs at least two ratios of the strains, all points have weft "
            f"strain = {weft / warp:.4g} warp strain"
        )
    for k, name in enumerate(("warp", "weft")):
        own, other = strain[:, k], strain[:, 1 - k]
        order = np.lexsort((own, np.round(other / np.ptp(other), 6)))
        same = np.abs(np.diff(other[order])) < 1e-6 * np.ptp(other)
        falls = np.diff(tension[order, k]) < -0.01 * np.abs(tension[:, k]).max()
        found = np.flatnonzero(same & falls & (np.diff(own[order]) > 0.0))
        if len(found):
            first, second = order[found[0]] + 1, order[found[0] + 1] + 1
            raise InputError(
                f"the tension of the {name} must rise with its own strain, and falls from point "
                f"{first} to point {second} while the other strain stays"
            )


class _Splines:
    """Cubic B-splines on [-MARGIN, 1 + MARGIN] for values of one strain in [0, 1]."""

    def __init__(self, values: np.ndarray):
        distinct = np.unique(np.round(np.concatenate([[0.0, 1.0], values]), 3))
        if len(distinct) > _MOST + 1:  # where the values are
            distinct = np.quantile(distinct, np.linspace(0.0, 1.0, _MOST + 1))
        if len(distinct) <= _REFINED + 1:
            distinct = np.unique([*distinct, *(0.5 * (distinct[1:] + distinct[:-1]))])
        distinct = np.array([-MARGIN, *distinct, 1.0 + MARGIN])
        self.ends = distinct
        self.knots = np.concatenate([[distinct[0]] * 3, distinct, [distinct[-1]] * 3])
        step = np.diff(distinct)[:, None]
        self.inner = (distinct[:-1, None] + step * (0.5 + np.array([-0.5, 0.5]) / 3**0.5)).ravel()
        quarters = distinct[:-1, None] + step * [0.0, 0.25, 0.5, 0.75]
        self.everywhere = np.append(quarters.ravel(), distinct[-1])

    def __len__(self) -> int:
        return len(self.knots) - 4

    def spline(self) -> object:
        """All of them, as one vector."""
        from scipy.interpolate import BSpline

        return BSpline(self.knots, np.eye(len(self)), 3)

    def rows(self, x: np.ndarray, order: int) -> np.ndarray:
        """Derivatives of an order at x (n,): (n, len)."""
        # The third derivative jumps at knots, where it is not asked for.
        return self.spline()(np.clip(x, self.ends[0], self.ends[-1]), nu=order)  # type: ignore[operator]

    def cubics(self) -> np.ndarray:
        """Coefficients, highest power first, from each knot on: (patches, 4, len)."""
        from scipy.special import factorial

        return np.stack([self.rows(self.ends[:-1], k) / factorial(k) for k in (3, 2, 1, 0)], axis=1)


def _grid(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def _convex(
    matrix: np.ndarray, free: np.ndarray, second: list[np.ndarray], patch: np.ndarray
) -> np.ndarray:
    """The values nearest to the free ones, by the matrix, with no stiffness below the floor.

    ``second``: rows that give w's second derivatives at places, (3, m, n); ``patch``: their
    patches, (m,).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    lower = np.linalg.cholesky(matrix)
    values, bounds, lack = free, np.zeros((0, len(free))), np.zeros(0)
    for _ in range(_ROUNDS):
        a, b, c = (rows @ values for rows in second)
        least = 0.5 * (a + c) - np.hypot(0.5 * (a - c), b)
        # The softest place of each patch.
        order = np.lexsort((least, patch))
        soft = order[np.flatnonzero(np.diff(patch[order], prepend=-1))]
        soft = soft[least[soft] < 0.5 * FLOOR]
        if not len(soft):
            break
        angle = 0.5 * np.arctan2(2.0 * b, a - c)[soft] + 0.5 * np.pi  # of the softest direction
        x, y = np.cos(angle)[:, None], np.sin(angle)[:, None]
        new = x * x * second[0][soft] + 2 * x * y * second[1][soft] + y * y * second[2][soft]
        bounds = np.concatenate([bounds, solve_triangular(lower, new.T, lower=True).T])
        lack = np.concatenate([lack, FLOOR - new @ free])
        # Least |z| with bounds z >= lack, z = lower^T (values - free).
        system = np.vstack([bounds.T, lack])
        dual, _ = nnls(system, np.append(np.zeros(len(free)), 1.0), maxiter=30 * len(lack))
        left = system @ dual
        left[-1] -= 1.0
        values = free + solve_triangular(lower.T, -left[:-1] / left[-1], lower=False)
        bounds, lack = bounds[dual > 0.0], lack[dual > 0.0]  # those that others imply are left out
    return values


def _law(
    splines: list[_Splines], values: np.ndarray, low: np.ndarray, span: np.ndarray
) -> BiaxialLaw:
    """The splines as cubics in the strains, without energy and tension at rest."""
    warp, weft = (spline.cubics() for spline in splines)
    powers = 3.0 - np.arange(4)
    c = np.einsum("iak,jbl,kl->ijab", warp, weft, values.reshape(len(splines[0]), len(splines[1])))
    c /= (span[0] ** powers)[:, None] * span[1] ** powers
    knots = [low[k] + span[k] * spline.ends for k, spline in enumerate(splines)]

    def made() -> BiaxialLaw:
        sizes = [float(len(k) - 1) for k in knots]
        ends = np.stack([low, low + span], axis=1).ravel()
        return BiaxialLaw(
            tuple(np.concatenate([[SURFACE], sizes, ends, *knots, c.ravel()]).tolist())
        )

    for _ in range(2):  # the second time takes off what rounding has left
        w, t, _ = made().evaluate(0.0, 0.0)
        c[..., 3, 3] -= w + t[0] * knots[0][:-1, None] + t[1] * knots[1][None, :-1]
        c[..., 2, 3] -= t[0]
        c[..., 3, 2] -= t[1]
    return made()


def _unmeasured(at: np.ndarray) -> float:
    """Share of the unit square that is far from all points and from rest."""
    place = _grid(*[(np.arange(20) + 0.5) / 20] * 2)
    distance = np.linalg.norm(place[:, None] - at[None], axis=2).min(axis=1)
    return float(np.mean(distance > _FAR))
