# SPDX-License-Identifier: MIT
"""Tension of both families by both strains: one energy per area w(e_w, e_e) of a cloth.

The tensions of warp and weft are its derivatives, force per width of the cloth at rest. There are
two kinds, a surface (cloth/surface.py) and a crimp model (cloth/crimp.py). As with laws.py, a law
is a few numbers, of which the first names its kind, and `evaluate_tension` is the one place where
they are worked out, for compiled kernels and for `BiaxialLaw` alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numba
import numpy as np

from . import laws
from .laws import Potential, evaluate_law, softened_strain

SURFACE, CRIMP = 1.0, 2.0
_NAMES = {SURFACE: "surface", CRIMP: "crimp model"}
Evaluated = tuple[float, float, float, float, float, float]

# See elements.cruciform.LAWS.
_LAWS = crc32(Path(laws.__file__).read_bytes())


@numba.njit(error_model="numpy")
def evaluate_tension(
    data: np.ndarray, warp: float, weft: float, compression: float, width: float
) -> Evaluated:
    """w(e_w, e_e) and its derivatives w_w, w_e, w_ww, w_we, w_ee at two strains.

    ``data`` is BiaxialLaw.packed. How yarns soften in compression (laws.softened_strain) is a
    matter of the kind: of a surface below the least strain of its table, of the yarns themselves in
    the crimp model, where cloth may contract while its yarns pull.
    """
    if data[0] == 1.0:
        return _surface(data, warp, weft, compression, width)
    return _crimp(data, warp, weft, compression, width)


@numba.njit(error_model="numpy")
def _surface(
    data: np.ndarray, warp: float, weft: float, compression: float, width: float
) -> Evaluated:
    """A patch of cubics in both strains, over a grid of knots.

    ``data``: 1, n, m, least and largest strain of the warp and of the weft that its points have,
    then n + 1 knots of e_w, m + 1 of e_e, and 16 coefficients of each of n x m patches, w = sum of
    c_ab s^(3 - a) t^(3 - b), s and t from the patch's lower knots. Below the least strain yarns
    soften. Beyond the last knots, and before the first, each cubic goes on as a parabola, so that
    stiffness stays what it is there.
    """
    n, m = int(data[1]), int(data[2])
    first, second = 7, 8 + n
    low_w, low_e = data[3], data[5]
    x, x1, x2 = softened_strain(warp - low_w, compression, width)
    y, y1, y2 = softened_strain(weft - low_e, compression, width)
    x += low_w
    y += low_e
    i, j = 0, 0
    while i < n - 1 and x >= data[first + i + 1]:
        i += 1
    while j < m - 1 and y >= data[second + j + 1]:
        j += 1
    s, t = x - data[first + i], y - data[second + j]
    s_in = min(max(s, 0.0), data[first + i + 1] - data[first + i])
    t_in = min(max(t, 0.0), data[second + j + 1] - data[second + j])
    s_over, t_over = s - s_in, t - t_in
    at = second + m + 1 + 16 * (i * m + j)
    # Horner in t for each power of s, and in s at the same time: f and its derivatives.
    f, fs, fss = 0.0, 0.0, 0.0  # w and by s
    ft, fst, fsst = 0.0, 0.0, 0.0  # w_t and by s
    ftt, fstt, fsstt = 0.0, 0.0, 0.0  # w_tt and by s
    for a in range(4):
        c = at + 4 * a
        g = data[c + 3] + t_in * (data[c + 2] + t_in * (data[c + 1] + t_in * data[c]))
        gt = data[c + 2] + t_in * (2.0 * data[c + 1] + 3.0 * t_in * data[c])
        gtt = 2.0 * data[c + 1] + 6.0 * t_in * data[c]
        g += t_over * (gt + 0.5 * t_over * gtt)
        gt += t_over * gtt
        fss = fss * s_in + 2.0 * fs
        fs = fs * s_in + f
        f = f * s_in + g
        fsst = fsst * s_in + 2.0 * fst
        fst = fst * s_in + ft
        ft = ft * s_in + gt
        fsstt = fsstt * s_in + 2.0 * fstt
        fstt = fstt * s_in + ftt
        ftt = ftt * s_in + gtt
    half = 0.5 * s_over * s_over
    w = f + s_over * fs + half * fss
    wx, wy = fs + s_over * fss, ft + s_over * fst + half * fsst
    wxx, wxy = fss, fst + s_over * fsst
    wyy = ftt + s_over * fstt + half * fsstt
    return (
        w, wx * x1, wy * y1, wxx * x1 * x1 + wx * x2, wxy * x1 * y1, wyy * y1 * y1 + wy * y2
    )  # fmt: skip


@numba.njit(error_model="numpy")
def _yarn(
    p: float, h: float, rest: float, stiffness: float, compression: float, width: float
) -> tuple[float, float, float, float]:
    """Energy of a straight piece of yarn over p and up h, its force, the slope, and its length."""
    length = np.sqrt(p * p + h * h)
    e, e1, e2 = softened_strain(length / rest - 1.0, compression, width)
    return (
        0.5 * stiffness * rest * e * e,
        stiffness * e * e1,
        stiffness * (e1 * e1 + e * e2) / rest,
        length,
    )


@numba.njit(error_model="numpy")
def _crimp(
    data: np.ndarray, warp: float, weft: float, compression: float, width: float
) -> Evaluated:
    """Sawtooth yarns that share the crimp height so that the energy of a crossover is least.

    ``data``: 2, then of warp and weft: length p of the cloth from crossover to crossover, crimp
    height h, yarn stiffness, stiffness against change of h; then the law of the force between the
    yarns at a crossover over their approach. cloth.crimp.Crimp has the equations. All NaN if the
    heights are not found, so that no equilibrium is found with them either.
    """
    p_w, p_e = data[1], data[2]
    rest_w, rest_e = data[3], data[4]
    total = rest_w + rest_e
    contact = data[9:]
    long_w, long_e = np.sqrt(p_w * p_w + rest_w * rest_w), np.sqrt(p_e * p_e + rest_e * rest_e)
    b_w, b_e = p_w * (1.0 + warp), p_e * (1.0 + weft)
    h_w, h_e, before = rest_w, rest_e, np.inf
    step_w, step_e = 0.0, 0.0
    done = False
    for _trial in range(80):
        u_w, f_w, k_w, l_w = _yarn(b_w, h_w, long_w, data[5], compression, width)
        u_e, f_e, k_e, l_e = _yarn(b_e, h_e, long_e, data[6], compression, width)
        # Half of what both rise less is how much closer their axes are where they cross.
        u, v, k = evaluate_law(contact, 0.5 * (total - h_w - h_e))
        v, k = 0.5 * v, 0.25 * k
        turn_w, turn_e = h_w - rest_w, h_e - rest_e
        energy = u_w + u_e + u + 0.5 * (data[7] * turn_w * turn_w + data[8] * turn_e * turn_e)
        if done:
            break
        if energy > before + 1e-12 * abs(before):  # too far: half the way back
            step_w, step_e = 0.5 * step_w, 0.5 * step_e
            h_w, h_e = h_w - step_w, h_e - step_e
            continue
        before = energy
        s_w, s_e, c_w, c_e = h_w / l_w, h_e / l_e, b_w / l_w, b_e / l_e
        g_w, g_e = f_w * s_w + data[7] * turn_w - v, f_e * s_e + data[8] * turn_e - v
        # Without what makes it indefinite where yarns are pressed.
        a_w = k_w * s_w * s_w + max(f_w, 0.0) * c_w * c_w / l_w + data[7]
        a_e = k_e * s_e * s_e + max(f_e, 0.0) * c_e * c_e / l_e + data[8]
        det = a_w * a_e + k * (a_w + a_e)
        step_w = -((a_e + k) * g_w - k * g_e) / det
        step_e = -((a_w + k) * g_e - k * g_w) / det
        h_w, h_e = h_w + step_w, h_e + step_e
        # The last step is below rounding; what is worked out once more is at its end.
        done = abs(step_w) + abs(step_e) <= 1e-14 * total
    if abs(step_w) + abs(step_e) > 1e-6 * total:  # where it is not found there is no number
        none = np.nan
        return none, none, none, none, none, none
    s_w, s_e, c_w, c_e = h_w / l_w, h_e / l_e, b_w / l_w, b_e / l_e
    # By the strain, by the height, and mixed.
    e_w = p_w * p_w * (k_w * c_w * c_w + f_w * s_w * s_w / l_w)
    e_e = p_e * p_e * (k_e * c_e * c_e + f_e * s_e * s_e / l_e)
    a_w = k_w * s_w * s_w + f_w * c_w * c_w / l_w + data[7]
    a_e = k_e * s_e * s_e + f_e * c_e * c_e / l_e + data[8]
    m_w = p_w * c_w * s_w * (k_w - f_w / l_w)
    m_e = p_e * c_e * s_e * (k_e - f_e / l_e)
    det = a_w * a_e + k * (a_w + a_e)
    area = p_w * p_e
    return (
        energy / area,
        f_w * c_w * p_w / area,
        f_e * c_e * p_e / area,
        (e_w - m_w * m_w * (a_e + k) / det) / area,
        m_w * m_e * k / det / area,
        (e_e - m_e * m_e * (a_w + k) / det) / area,
    )


@lru_cache(maxsize=1)
def _every() -> Callable[..., np.ndarray]:
    compiled_laws = _LAWS

    @numba.njit(cache=True, error_model="numpy")
    def kernel(data, warp, weft, compression, width):
        result = np.empty((6, len(warp) if compiled_laws >= 0 else 0))  # it never is below
        for n in range(len(warp)):
            result[:, n] = evaluate_tension(data, warp[n], weft[n], compression, width)
        return result

    return kernel


@dataclass(frozen=True)
class BiaxialLaw:
    """An energy per area w(e_w, e_e), N/m, with w = w_w = w_e = 0 at rest."""

    data: tuple[float, ...]  # see evaluate_tension
    points: np.ndarray | None = field(default=None, compare=False, repr=False)
    """Measured strains and tensions [N/m] that it was found from, (n, 4); for pictures."""

    @property
    def name(self) -> str:
        """What it is called: "surface" or "crimp model"."""
        return _NAMES[self.data[0]]

    @property
    def packed(self) -> np.ndarray:
        """``data`` as an array, for kernels; float (n,)."""
        return np.array(self.data)

    def times(self, factor: float) -> BiaxialLaw:
        """The law of so many times the tensions."""
        data = np.array(self.data)
        if self.data[0] == SURFACE:
            data[9 + int(data[1]) + int(data[2]) :] *= factor
        else:
            data[5:9] *= factor
            data[9:] = Potential(self.data[9:]).times(factor).data
        return BiaxialLaw(tuple(float(value) for value in data))

    @property
    def strains(self) -> np.ndarray:
        """Least and largest strain of warp and weft that its points have, (2, 2); or infinite."""
        if self.data[0] != SURFACE:
            return np.array([[-np.inf, np.inf]] * 2)
        return np.array(self.data[3:7]).reshape(2, 2)

    def evaluate(
        self, warp: Any, weft: Any, compression: float = 1.0, width: float = 1e-4
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energy, tensions and stiffness at strains of warp and weft of one shape (...).

        Returns
        -------
        w (...), tensions (..., 2) of warp and weft, stiffness (..., 3): w_ww, w_ee, w_we; N/m
        """
        warp, weft = np.broadcast_arrays(np.asarray(warp, float), np.asarray(weft, float))
        values = _every()(
            self.packed, warp.ravel(), weft.ravel(), float(compression), float(width)
        ).reshape(6, *warp.shape)
        return (
            values[0],
            np.stack([values[1], values[2]], axis=-1),
            np.stack([values[3], values[5], values[4]], axis=-1),
        )

    @property
    def stiffness0(self) -> np.ndarray:
        """C11, C22, C12 of small strains, N/m; (3,)."""
        return self.evaluate(0.0, 0.0)[2]

    def least_stiffness(self, warp: Any, weft: Any) -> np.ndarray:
        """Smaller eigenvalue of the stiffness at strains (...), N/m; below zero w is not convex."""
        a, b, c = np.moveaxis(self.evaluate(warp, weft)[2], -1, 0)
        return 0.5 * (a + b) - np.hypot(0.5 * (a - b), c)
