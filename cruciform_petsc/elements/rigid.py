# SPDX-License-Identifier: MIT
"""Points of cloth against a rigid surface: compaction and friction, and their derivatives.

Formulas: items.contact.
"""

from __future__ import annotations

import numba
import numpy as np

from .level import FORCE, FREE, STIFFNESS


@numba.njit(cache=True, error_model="numpy")
def nearby(x, nodes, turn, seen, room, y, near):
    """Places of nodes in a tool's frame, and which of them may touch it; returns their number.

    Parameters
    ----------
    x : float (n_local, 3)
    nodes : int32 (m, 2)
        The nodes, and the tool's.
    turn : float (3, 3)
        The tool's frame -> lab.
    seen : float (m, 3), m
        Where nodes were when they were looked at last.
    room : float (m,), m
        By less than this they may have moved without coming to touch.
    y : float (m, 3), near : int (m,)
        The places, and the first rows of those that have moved farther, or to nowhere; in place.
    """
    count = 0
    for m in range(len(nodes)):
        way = 0.0
        for i in range(3):
            y[m, i] = 0.0
            for j in range(3):
                y[m, i] += (x[nodes[m, 0], j] - x[nodes[m, 1], j]) * turn[j, i]
            way += (y[m, i] - seen[m, i]) ** 2
        if not way < room[m] * room[m]:
            near[count] = m
            count += 1
    return count


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _rub(gap, normal, limit, slip, level, force, stiffness):
    """Energy of friction of one point; force (3,) and stiffness (3, 3) in place."""
    across, square = 0.0, 0.0
    for i in range(3):
        across += gap[i] * normal[i]
    for i in range(3):
        force[i] = gap[i] - across * normal[i]
        square += force[i] ** 2
    s = np.sqrt(square)
    r = s / slip
    if r < 1.0:  # psi'/s, finite where s is zero
        energy, per_s, second = r * r - r**3 / 3.0, (2.0 - r) / slip, (2.0 - 2.0 * r) / slip
    else:
        energy, per_s, second = r - 1.0 / 3.0, 1.0 / s, 0.0
    if level >= STIFFNESS:
        turned = (second - per_s) / max(square, 1e-300)
        for i in range(3):
            for j in range(3):
                plane = (1.0 if i == j else 0.0) - normal[i] * normal[j]
                stiffness[i, j] = limit * (per_s * plane + turned * force[i] * force[j])
    for i in range(3):
        force[i] *= limit * per_s
    return limit * slip * energy


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _rub_all(gap, normal, limit, slip, level, energy, force, stiffness):
    f, h = np.zeros(3), np.zeros((3, 3))
    for m in range(len(gap)):
        energy[m] = _rub(gap[m], normal[m], limit[m], slip, level, f, h)
        if level >= FORCE:
            force[m] = f
        if level >= STIFFNESS:
            stiffness[m] = h


def rubbed(gap: np.ndarray, normal: np.ndarray, limit: np.ndarray, slip: float, level: int):
    """Friction's energy (m,), force (m, 3) and stiffness (m, 3, 3).

    Gaps (m, 3) to the anchors count across normals (m, 3); ``limit`` (m,) is mu N, ``slip`` s_0.
    """
    m = len(gap)
    out = (
        np.empty(m),
        np.empty((m if level >= FORCE else 0, 3)),
        np.empty((m if level >= STIFFNESS else 0, 3, 3)),
    )
    _rub_all(gap, normal, limit, slip, level, *out)
    return out


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def press(
    y, turn, near, distance, normal, curvature, area, offset, k, width,
    pressed, anchor, across, mu, slip, level, energy, force, stiffness,
):  # fmt: skip
    """Energy of compaction and of friction of nodes against a tool, and its derivatives, in place.

    Parameters
    ----------
    y : float (m, 3), m
        In the tool's frame.
    turn : float (3, 3)
        That frame -> lab.
    near : int (n,)
        Ascending, those that are near.
    distance : float (n,), normal : float (n, 3), curvature : float (n, 3, 3)
        Of these.
    area, offset : float (m,), m^2, m
    k, width : float, N/m^3, m
    pressed : float (m,), N; anchor, across : float (m, 3)
        Normal forces, anchors and normals of friction; no rows for none.
    mu, slip : float
    level : int
    energy : float (m, 2), force : float (m, 2, 3), stiffness : float (m, 2, 3, 2, 3)
        Of the nodes and the tool, lab frame.
    """
    f, h, half = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    gap, pull, plane = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    next_ = 0
    for m in range(len(y)):
        energy[m] = 0.0
        acts = False
        f[:] = 0.0
        if level >= STIFFNESS:
            h[:] = 0.0
        if next_ < len(near) and near[next_] == m:
            p = offset[m] - distance[next_]
            if not p <= 0.0:
                acts = True
                if p < width:
                    e, q, stiff = p**3 / (6.0 * width), p * p / (2.0 * width), p / width
                else:
                    over = p - width
                    e = width**2 / 6.0 + 0.5 * over * width + 0.5 * over**2
                    q, stiff = p - 0.5 * width, 1.0
                weight = area[m] * k
                energy[m, 0] = weight * e
                for i in range(3):
                    f[i] = -weight * q * normal[next_, i]
                    if level >= STIFFNESS:
                        for j in range(3):
                            h[i, j] = weight * (
                                stiff * normal[next_, i] * normal[next_, j]
                                - q * curvature[next_, i, j]
                            )
            next_ += 1
        if len(pressed) and pressed[m] > 0.0:
            acts = True
            for i in range(3):
                gap[i] = y[m, i] - anchor[m, i]
            energy[m, 1] = _rub(gap, across[m], mu * pressed[m], slip, level, pull, plane)
            for i in range(3):
                f[i] += pull[i]
                if level >= STIFFNESS:
                    for j in range(3):
                        h[i, j] += plane[i, j]
        if level >= FORCE:
            for i in range(3):
                total = 0.0
                for j in range(3):
                    total += turn[i, j] * f[j]
                force[m, 0, i], force[m, 1, i] = total, -total
        if level >= STIFFNESS:
            if not acts:
                stiffness[m] = 0.0
                continue
            for i in range(3):
                for j in range(3):
                    half[i, j] = 0.0
                    for o in range(3):
                        half[i, j] += turn[i, o] * h[o, j]
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for o in range(3):
                        total += half[i, o] * turn[j, o]
                    stiffness[m, 0, i, 0, j] = stiffness[m, 1, i, 1, j] = total
                    stiffness[m, 0, i, 1, j] = stiffness[m, 1, i, 0, j] = -total
