# SPDX-License-Identifier: MIT
"""Bars of a pin-jointed net: energy, force and exact stiffness.

A *cross* is a crossover with four stiff bars along the yarns and four soft ones between their ends
(Sharma and Sutcliffe 2004: a net of bars with soft diagonals). With A_q the area of the quadrant
between the bars i and j, A_i the sum over the two quadrants beside a bar:

    W = sum_i A_i Phi(|x_i - x_0|/L_i - 1) + sum_q A_q psi(gamma(d_ij)),  d_ij = |x_j - x_i|
    s sin(gamma) = (L_i^2 + L_j^2 - d^2)/(2 L_i L_j),  s = +1, -1, +1, -1 around the crossover

Where yarns keep their lengths gamma is the cloth's shear angle, so that diagonals have the energy
of the law at any angle. At small ones a diagonal of a cell a x b, which two quadrants of a b/4
share, is a spring of stiffness G d^2/(2 a b).
"""

from __future__ import annotations

import numpy as np

from ..laws import Potential
from ..net.lattice import QUADRANTS
from .level import FORCE, STIFFNESS, room

SIGN = (1.0, -1.0, 1.0, -1.0)
LAST = np.sin(np.deg2rad(85.0))  # sine up to which the law is followed; then its parabola there


def by_sine(law: Potential, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy per area of a shear law by the sine of the angle, and two derivatives by that."""
    inside = np.clip(sine, -LAST, LAST)
    angle = np.arcsin(inside)
    psi, psi1, psi2 = law.evaluate(angle)
    cosine = np.cos(angle)
    first = psi1 / cosine
    second = (psi2 + psi1 * inside / cosine) / cosine**2
    more = sine - inside
    return psi + first * more + 0.5 * second * more**2, first + second * more, second


def crosses(
    x,
    length,
    area,
    warp: Potential,
    weft: Potential,
    shear: Potential,
    strain,
    level: int = STIFFNESS,
):
    """Energy, force and stiffness of crosses.

    Parameters
    ----------
    x : float (n, 5, dim)
        Ends of the bars 1 to 4 and the crossover, m.
    length : float (n, 4)
        Of the bars at rest, m; 0 for a missing one (its end is not looked at).
    area : float (n, 4)
        Of the quadrants, in the order of lattice.QUADRANTS, m^2; 0 where a bar is missing.
    warp, weft, shear : Potential
        Energies per area over effective strain and angle.
    strain : callable
        Stretch -> effective strain, and its first and second derivatives.
    level : int
        As for cruciform.cruciforms.

    Returns
    -------
    energy : float (n, 2), J, of bars along the yarns and of diagonals
    force : float (n, 5, dim), N
    stiffness : float (n, 5, dim, 5, dim), N/m
    """
    n, _, dim = x.shape
    energy, force, stiffness = room(n, 2, 5, dim, level)
    energy[:], force[:], stiffness[:] = 0.0, 0.0, 0.0

    def add(p: int, q: int, mode: int, value, first, second) -> None:
        """A bar between two points: its energy, and derivatives by half the length squared."""
        energy[:, mode] += value
        if level < FORCE:
            return
        way = x[:, q] - x[:, p]
        pull = first[:, None] * way
        force[:, q] += pull
        force[:, p] -= pull
        if level < STIFFNESS:
            return
        block = second[:, None, None] * way[:, :, None] * way[:, None, :]
        block += first[:, None, None] * np.eye(dim)
        stiffness[:, p, :, p] += block
        stiffness[:, q, :, q] += block
        stiffness[:, p, :, q] -= block
        stiffness[:, q, :, p] -= block

    for arm in range(4):
        there = length[:, arm] > 0
        rest = np.where(there, length[:, arm], 1.0)
        at = np.flatnonzero(QUADRANTS[:, arm % 2] == arm)
        beside = area[:, at].sum(axis=1) * there
        size = np.where(there, np.linalg.norm(x[:, arm] - x[:, 4], axis=1), 1.0)
        e, e1, e2 = strain(size / rest)
        y, y1, y2 = (warp, weft)[arm % 2].evaluate(e)
        slope, curve = y1 * e1 / rest, (y2 * e1**2 + y1 * e2) / rest**2  # by the length
        add(4, arm, 0, beside * y, beside * slope / size,
            beside * (curve - slope / size) / size**2)  # fmt: skip
    for quadrant, (i, j) in enumerate(QUADRANTS):
        part = area[:, quadrant]
        product = np.where(part > 0, length[:, i] * length[:, j], 1.0)
        d2 = ((x[:, j] - x[:, i]) ** 2).sum(axis=1)
        s = SIGN[quadrant]
        sine = s * (length[:, i] ** 2 + length[:, j] ** 2 - d2) / (2.0 * product)
        y, y1, y2 = by_sine(shear, np.where(part > 0, sine, 0.0))
        slope = -s / product  # of the sine by half the length squared
        add(i, j, 1, part * y, part * y1 * slope, part * y2 * slope**2)
    return energy, force, stiffness
