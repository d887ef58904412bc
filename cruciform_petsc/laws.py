# SPDX-License-Identifier: MIT
"""Scalar laws as energy densities w(x): what shear and tension follow at finite deformation.

A law is a few numbers, of which the first names its kind, so that compiled kernels can take any of
them. `evaluate_law` is the one place where laws are worked out; `Potential` is its NumPy face.
`effective_strain` makes of a stretch what a law of tension takes: which strain, and how yarns
soften in compression; `effective_strains` does it for arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from .errors import InputError

LINEAR, POLYNOMIAL, SIN_POWERS, TABLE = 0.0, 1.0, 2.0, 3.0
SLOWEST = 1e-6  # rad/s; rates of shear that no thinning is told apart at
_NAMES = ("linear", "polynomial", "sin-potential", "table")  # as in case files


@numba.njit(cache=True)
def evaluate_law(data: np.ndarray, x: float) -> tuple[float, float, float]:
    """Energy density, its first and its second derivative at x.

    ``data`` is Potential.packed:

    - 0, k:                       w = k x^2/2
    - 1, n, k_1 ... k_n:          w' = k_1 x + k_2 x^3 + ... + k_n x^(2n - 1)
    - 2, n, k_1 ... k_n:          w = k_1 sin^2 x + ... + k_n sin^(2n) x
    - 3, n, then n + 1 knots x_0 = 0 ... x_n, n + 1 energies, and (c_0, c_1, c_2, c_3) of each of
      the n pieces of w' = c_0 + c_1 t + c_2 t^2 + c_3 t^3, t = |x| - x_i; odd in x, and beyond the
      last knot straight on with the slope there.
    """
    kind = data[0]
    if kind == 0.0:
        k = data[1]
        return 0.5 * k * x * x, k * x, k
    n = int(data[1])
    w, d, dd = 0.0, 0.0, 0.0
    if kind == 1.0:
        power = 1.0  # x^(2i)
        for i in range(n):
            k = data[2 + i]
            w += k * power * x * x / (2 * i + 2)
            d += k * power * x
            dd += k * power * (2 * i + 1)
            power *= x * x
        return w, d, dd
    if kind == 2.0:
        s, c = np.sin(x), np.cos(x)
        power = 1.0  # s^(2i)
        for i in range(n):
            m, k = 2 * i + 2, data[2 + i]
            w += k * power * s * s
            d += k * m * power * s * c
            dd += k * m * power * ((m - 1) * c * c - s * s)
            power *= s * s
        return w, d, dd
    size = abs(x)
    low, high = 0, n  # the piece: knot[low] <= |x| < knot[low + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if data[2 + middle] <= size:
            low = middle
        else:
            high = middle
    t = size - data[2 + low]
    last = data[2 + n] - data[2 + low]
    at = 2 + 2 * (n + 1) + 4 * low
    over = 0.0
    if t > last:
        over, t = t - last, last
    c0, c1, c2, c3 = data[at], data[at + 1], data[at + 2], data[at + 3]
    d = c0 + t * (c1 + t * (c2 + t * c3))
    dd = c1 + t * (2 * c2 + 3 * t * c3)
    w = data[3 + n + low] + t * (c0 + t * (c1 / 2 + t * (c2 / 3 + t * c3 / 4)))
    w += over * (d + 0.5 * over * dd)
    d += over * dd
    return w, d if x >= 0.0 else -d, dd


@numba.njit(cache=True, error_model="numpy")
def shear_resistance(
    angle: float, last: float, anchor: float, numbers: np.ndarray
) -> tuple[float, float, float]:
    """Viscosity and friction of shear as an incremental potential: its value and derivatives.

    ``numbers``: viscosity eta [N s/m], exponent n, seconds h since the angle was ``last``, torque
    of friction per area T [N/m], elastic slip s_0 [rad]. With the rate r = (angle - last)/h and
    s = (angle - anchor)/s_0

    - w = h eta/(n + 1) [(r^2 + e^2)^((n + 1)/2) - e^(n + 1)], so that w' = eta r^n, the torque of a
      power-law fluid (for n = 1 Newton's), but for rates of the size of e = SLOWEST or below;
    - w = T s_0 (s^2 - |s|^3/3) for |s| < 1, T s_0 (|s| - 1/3) beyond, as for friction on tools.
    """
    eta, n, h, torque, slip = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    w, d, dd = 0.0, 0.0, 0.0
    if eta > 0.0 and h > 0.0:
        r = (angle - last) / h
        if n == 1.0:
            w, d, dd = 0.5 * eta * r * r * h, eta * r, eta / h
        else:
            square = r * r + SLOWEST * SLOWEST
            power = square ** (0.5 * (n - 1.0))
            w = h * eta / (n + 1.0) * (square * power - SLOWEST ** (n + 1.0))
            d = eta * power * r
            dd = eta / h * power * (1.0 + (n - 1.0) * r * r / square)
    if torque > 0.0:
        s = (angle - anchor) / slip
        size = abs(s)
        if size < 1.0:
            w += torque * slip * (size * size - size**3 / 3.0)
            d += torque * s * (2.0 - size)
            dd += torque * (2.0 - 2.0 * size) / slip
        else:
            w += torque * slip * (size - 1.0 / 3.0)
            d += torque if s > 0.0 else -torque
    return w, d, dd


@numba.njit(cache=True, error_model="numpy")
def softened_strain(s: float, compression: float, width: float) -> tuple[float, float, float]:
    """Effective strain e of a yarn that buckles, and its first and second derivative.

    e = s in tension. In compression e is minus the root of 2 g(s), where g is the energy of a unit
    modulus whose stiffness falls with the strain,

        g'' = c + (1 - c) exp(s/d),  g(0) = g'(0) = 0,  c = ``compression``, d = ``width``,

    so that k e^2/2 has the stiffness k in tension, falls smoothly to c k in compression and is
    nowhere negative. (A smooth e(s) with slopes 1 and sqrt(c), squared, would be: the force of a
    yarn would fall while it is pressed together, for c = 0.01 between strains of -0.6 d and
    -4.6 d.) Far in compression e has the slope sqrt(c).
    """
    if s >= 0.0 or compression == 1.0:
        return s, 1.0, 0.0
    z, q = s / width, 1.0 - compression
    if z > -1.0:
        # 2 g = s^2 u, u = c + q f, f = 2 (exp(z) - 1 - z)/z^2 by its series: no cancellation.
        f, f1, f2 = 0.0, 0.0, 0.0
        power, factorial = 1.0, 2.0  # z^k, (k + 2)!
        for k in range(16):
            f += 2.0 * power / factorial
            f1 += 2.0 * (k + 1) * power / (factorial * (k + 3))
            f2 += 2.0 * (k + 1) * (k + 2) * power / (factorial * (k + 3) * (k + 4))
            power *= z
            factorial *= k + 3
        u, u1, u2 = compression + q * f, q * f1, q * f2
        root = np.sqrt(u)
        first = root + z * u1 / (2.0 * root)
        second = (u1 + 0.5 * z * u2 - 0.25 * z * u1 * u1 / u) / root
        return s * root, first, second / width
    fall = np.exp(z)
    h2 = compression + q * fall
    h1 = compression * z + q * (fall - 1.0)
    twice = compression * z * z + 2.0 * q * (fall - 1.0 - z)
    root = np.sqrt(twice)
    return -width * root, -h1 / root, (h1 * h1 / twice - h2) / (root * width)


@numba.njit(cache=True, error_model="numpy")
def effective_strain(
    stretch: float, log_strain: bool, compression: float, width: float
) -> tuple[float, float, float]:
    """Strain that tension laws take, with its two derivatives with respect to the stretch.

    softened_strain of s = stretch - 1, or of s = ln(stretch).
    """
    if log_strain:
        s, s1, s2 = np.log(stretch), 1.0 / stretch, -1.0 / stretch**2
    else:
        s, s1, s2 = stretch - 1.0, 1.0, 0.0
    e, e1, e2 = softened_strain(s, compression, width)
    return e, e1 * s1, e2 * s1 * s1 + e1 * s2


@numba.njit(cache=True, error_model="numpy")
def _effective_strains(
    stretch: np.ndarray, log_strain: bool, compression: float, width: float
) -> np.ndarray:
    result = np.empty((3, len(stretch)))
    for i in range(len(stretch)):
        e, e1, e2 = effective_strain(stretch[i], log_strain, compression, width)
        result[0, i], result[1, i], result[2, i] = e, e1, e2
    return result


def effective_strains(
    stretch: Any, log_strain: bool = False, compression: float = 1.0, width: float = 1e-4
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """effective_strain of an array: e, de/dstretch and its second derivative, shaped like it."""
    stretch = np.asarray(stretch, float)
    result = _effective_strains(
        stretch.ravel(), bool(log_strain), float(compression), float(width)
    ).reshape(3, *stretch.shape)
    return result[0], result[1], result[2]


@numba.njit(cache=True)
def _resist_all(
    angle: np.ndarray, last: np.ndarray, anchor: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    result = np.empty((3, len(angle)))
    for i in range(len(angle)):
        result[0, i], result[1, i], result[2, i] = shear_resistance(
            angle[i], last[i], anchor[i], numbers
        )
    return result


def shear_resistances(
    angle: np.ndarray, last: np.ndarray, anchor: np.ndarray, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """shear_resistance of arrays of one shape: its value and derivatives, shaped like them."""
    shape = np.shape(angle)
    result = _resist_all(*(np.ravel(part) for part in (angle, last, anchor)), numbers)
    w, d, dd = result.reshape(3, *shape)
    return w, d, dd


@numba.njit(cache=True)
def _evaluate_all(data: np.ndarray, x: np.ndarray) -> np.ndarray:
    result = np.empty((3, len(x)))
    for i in range(len(x)):
        result[0, i], result[1, i], result[2, i] = evaluate_law(data, x[i])
    return result


@dataclass(frozen=True)
class Potential:
    """An energy density w(x) with w(0) = w'(0) = 0, even in x; made by the functions below."""

    data: tuple[float, ...]  # see evaluate_law

    @property
    def name(self) -> str:
        """What case files call such a law: "linear", "polynomial", "sin-potential" or "table"."""
        return _NAMES[int(self.data[0])]

    @property
    def packed(self) -> np.ndarray:
        """``data`` as an array, for kernels; float (n,)."""
        return np.array(self.data)

    def evaluate(self, x: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """w, w' and w'' at x, each an array of the shape of x."""
        x = np.asarray(x, float)
        result = _evaluate_all(self.packed, x.ravel()).reshape(3, *x.shape)
        return result[0], result[1], result[2]

    @property
    def stiffness0(self) -> float:
        """w''(0): the modulus of small deformations."""
        return float(self.evaluate(0.0)[2])

    @property
    def knots(self) -> np.ndarray:
        """Where a table has its points, from zero on, (n,); of formulas none."""
        return self.packed[2 : 3 + int(self.data[1])] if self.data[0] == TABLE else np.empty(0)

    def times(self, factor: float) -> Potential:
        """The law of so many times the force."""
        data = np.array(self.data)
        data[{LINEAR: 1, TABLE: 2 + len(self.knots)}.get(self.data[0], 2) :] *= factor
        return Potential(tuple(float(value) for value in data))

    @property
    def last_point(self) -> float:
        """Where a table ends and the law goes on straight; infinite for formulas."""
        return float(self.knots[-1]) if self.data[0] == TABLE else np.inf


def linear(stiffness: float) -> Potential:
    """The law w' = stiffness x."""
    return Potential((LINEAR, float(stiffness)))


def odd_polynomial(coefficients: Sequence[float]) -> Potential:
    """The law w' = k_1 x + k_2 x^3 + k_3 x^5 + ...

    >>> law = odd_polynomial([2.0, 1.0])
    >>> [float(value) for value in law.evaluate(3.0)]  # w, w', w''
    [29.25, 33.0, 29.0]
    """
    return _listed(POLYNOMIAL, coefficients)


def sin_powers(coefficients: Sequence[float]) -> Potential:
    """The law w = sum of k_i sin(x)^(2 i), as in the literature on pantographic lattices."""
    return _listed(SIN_POWERS, coefficients)


def _listed(kind: float, coefficients: Sequence[float]) -> Potential:
    try:
        numbers = [float(value) for value in coefficients]
    except OverflowError:  # a whole number of hundreds of digits
        numbers = []
    if not numbers or not np.isfinite(numbers).all():
        raise InputError("a law needs at least one coefficient, all of them finite")
    return Potential((kind, float(len(numbers)), *numbers))


def table(x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray) -> Potential:
    """Run w' through points and the origin, by monotone cubics (Fritsch and Carlson's PCHIP).

    Odd in x; beyond the last point it goes straight on with the slope there. x (n,) ascends from
    zero or above; y is nowhere below zero, and at x = 0, if given, it is 0. Raises InputError if
    that is not so, if a point is not finite, or if x and y differ in length.
    """
    from scipy.interpolate import PchipInterpolator

    if np.shape(x) != np.shape(y):
        raise InputError(
            f"a law's table has {len(x)} values in one column and {len(y)} in the other"
        )
    try:
        points = np.array([x, y], float)
    except OverflowError:  # a whole number of hundreds of digits
        points = np.array([[np.inf]])
    if points.ndim != 2 or points.shape[1] == 0 or not np.isfinite(points).all():
        raise InputError("a law's table needs points, all of them finite")
    if points[0, 0] != 0.0:
        points = np.concatenate([np.zeros((2, 1)), points], axis=1)
    if points[1, 0] != 0.0:
        raise InputError(f"a law's table must be zero at zero, got {points[1, 0]:g}")
    if points.shape[1] < 2 or not (np.diff(points[0]) > 0).all():
        raise InputError("a law's table needs ascending, positive values in its first column")
    if min(y) < 0.0:
        which = 1 + int(np.argmax(np.less(y, 0.0)))
        raise InputError(f"a law's table must not go below zero, as its point {which} does")
    with np.errstate(all="ignore"):  # looked at below
        if points.shape[1] == 2:  # a straight line
            slope = points[1, 1] / points[0, 1]
            cubic = np.array([[0.0], [0.0], [slope], [0.0]])
        else:
            # Odd: interpolated through the mirrored points, too, so that it is smooth at zero.
            mirrored = np.concatenate([-points[:, :0:-1], points], axis=1)
            try:
                cubic = PchipInterpolator(*mirrored).c[:, len(points[0]) - 1 :]
            except ValueError:  # a slope that is not finite
                cubic = np.full((4, len(points[0]) - 1), np.nan)
        c = cubic[::-1]  # ascending powers
        step = np.diff(points[0])
        piece = step * (c[0] + step * (c[1] / 2 + step * (c[2] / 3 + step * c[3] / 4)))
        energy = np.concatenate([[0.0], np.cumsum(piece)])
    data = np.concatenate([[TABLE, len(step)], points[0], energy, c.T.ravel()])
    if not np.isfinite(data).all():
        raise InputError("a law's table has points too close together, or numbers too large")
    return Potential(tuple(float(value) for value in data))
